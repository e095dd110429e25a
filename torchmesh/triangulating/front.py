"""Meshes of boundaries from nothing: an exact constrained Delaunay triangulation, and vertices on an advancing front.

    boundary, interfaces, held vertices --> triangulation --> + the other vertices --> background, which has the sizes
                                                 |                                        |
                                                 +------------- front <-------------------+

The front is that of Rebay (Efficient unstructured mesh generation by means of Delaunay triangulation and Bowyer-Watson
algorithm, Journal of Computational Physics 106, 1993):

         p         a triangle is done when its circle is small for the size wanted.  The largest of those that are
        / \\        not, but lie at the boundary, at an interface or at a triangle that is, gets a vertex p: on the
       /   \\       bisector of that edge u w, where a triangle of the size wanted has its tip, and not beyond the
      u-----w      centre of the circle.  p goes into the Delaunay triangulation, every sign of which is exact.
"""

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from ..kernels.library import library_for


@dataclass(frozen=True)
class FrontOptions:
    """How vertices are placed.

    done  a triangle is done when the radius of its circle is at most this many times the size wanted: 0.577 is that of
          an equilateral triangle.  With 0.7071 edges have 0.97 times their sizes on average, with 0.75 0.99, at means
          within 0.001 of each other; on stretched boundaries 0.7071 had the lowest maxima.  0.65 is worse
    room  a new vertex is at least so many times the size wanted away from those round it
    low   and at least so many times the length of an edge that must stay away from that edge.  Without this limit,
          vertices were put on boundary edges longer than the size wanted: the centre of a right triangle's circle is on
          its long side.  In a part that is narrower than its edges are long, a vertex at 0.1 was better than none
    """

    done: float = 0.7071
    room: float = 0.5
    low: float = 0.05

    @property
    def numbers(self) -> tuple[float, float, float]:
        """What a mesher is told."""
        return self.done, self.room, self.low


class Mesher(Protocol):
    """What the compiled mesher and its twin have in common.

    fault  0, or what stands in the way: 1 a vertex lies on another one, 2 an edge crosses another one or passes
           through a vertex, 3 the boundary bounds no domain
    """

    fault: int

    def background(self) -> Tensor:
        """(T, 3) int64 the triangles of all vertices that are in the domain; those of the others are in none."""

    def mesh(
        self, size: Tensor, done: float, room: float, low: float, filled: tuple[int, int] | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The mesh for sizes (V,), which are read at the vertices of the background.

        done, room, low  as `FrontOptions` has them
        filled  if the front places at least the first number of vertices, but fewer than the second one, further ones
                go to the centres of the circles that are largest for the size wanted, the largest first, up to that
                number as far as there is room

        Returns its triangles (T, 3) int64 and, of the new vertices, whose rows follow those of the outline, the
        positions (N, 2), the sizes wanted (N,), and the corners (N, 3) int64 and weights (N, 3) with which a linear
        function over the background is read there.
        """


def is_compiled(points: Tensor) -> bool:
    """Whether meshers for these points are compiled."""
    return library_for(points) is not None


def outline_mesher(points: Tensor, held: Tensor, boundary: Tensor, segments: Tensor) -> Mesher:
    """A mesher for one domain, on the processor.

    points    (V, 2) float64, in a unit of length near the size of the domain: products of coordinates must neither
              overflow nor underflow, and exact signs need several factors
    held      (V,) bool, the vertices that must be in the mesh; the ends of boundary and segments are among them
    boundary  (N, 2) int64 edges with the domain on their left
    segments  (M, 2) int64 edges inside that must be in the mesh
    """
    if is_compiled(points):
        from ..kernels.meshing import OutlineMesher

        return OutlineMesher(points, held, boundary, segments)
    from .front_twin import OutlineMesher as Twin

    return Twin(points, held, boundary, segments)
