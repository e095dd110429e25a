"""Meshes by longitude and latitude that cross the date line: some of their elements run round the whole earth in x.

179   180 | -180  -179        the triangle 179, 180, -179 has a width of 359 in x, and of 2 when 360 is added to
 o-----o  |   o-----o         negative longitudes
"""

import numpy as np

# A circle in degrees; an element is suspicious if it is wider than half of it.
_ROUND, _HALF = 360.0, 180.0

# Such elements cross the date line if adding 360 makes each no wider than so many times the others are on the whole,
# and if they are no larger part of all elements.
_WIDER, _PART = 10.0, 0.5


def crosses_the_date_line(points: np.ndarray, faces: np.ndarray) -> str:
    """What a warning says of triangles (T, 3) that cross the date line; empty where none does.

    points  (V, 2 or 3), x and y of which may be longitude and latitude in degrees
    """
    if not len(faces):
        return ""
    x, y = points[:, 0][faces], points[:, 1][faces]
    low, high = x.min(), x.max()
    if low < -_HALF or high > _ROUND or high - low <= _HALF or np.abs(y).max() > 90:
        return ""
    width = np.ptp(x, axis=1)
    across = width > _HALF
    if not across.any() or across.mean() > _PART:
        return ""
    # From -180 to 180, or from 0 to 360.
    turned = x[across] + np.where(x[across] < 0, _ROUND, 0.0) if low < 0 else x[across] - _ROUND * (x[across] > _HALF)
    if np.ptp(turned, axis=1).max() > min(_WIDER * np.median(width[~across]), _HALF):
        return ""
    where = "add 360 to longitudes below 0" if low < 0 else "take 360 from longitudes above 180"
    return (
        f"{int(across.sum())} elements are wider than 180 in x: if x is the longitude, the mesh crosses the date line; "
        f"{where} first"
    )
