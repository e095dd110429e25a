"""The stiffness matrix of linear elements, assembled in the plainest way."""

import numpy as np


def stiffness(mesh):
    """The P1 stiffness matrix, dense, from the gradients of the hat functions of each element."""
    points = mesh.points.numpy()
    k = np.zeros((len(points), len(points)))
    for row in mesh.triangles.tolist():
        # The hat functions are the columns of this inverse: 1, x, y coefficients.
        matrix = np.column_stack([np.ones(3), points[row]])
        gradient = np.linalg.inv(matrix)[1:]
        k[np.ix_(row, row)] += abs(np.linalg.det(matrix)) / 2 * gradient.T @ gradient
    return k
