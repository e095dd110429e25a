"""Outlines of domains: block letters, spirals, airfoils, rings and notches, as closed polylines."""

import numpy as np
import shapely

# Block letters on a grid of cells; a cell that touches another does so along an edge.
LETTERS = {
    "A": ("###", "#.#", "###", "#.#", "#.#"),
    "C": ("###", "#..", "#..", "#..", "###"),
    "E": ("###", "#..", "###", "#..", "###"),
    "F": ("###", "#..", "###", "#..", "#.."),
    "G": ("####", "#...", "#.##", "#..#", "####"),
    "H": ("#.#", "#.#", "###", "#.#", "#.#"),
    "L": ("#..", "#..", "#..", "#..", "###"),
    "O": ("###", "#.#", "#.#", "#.#", "###"),
    "P": ("###", "#.#", "###", "#..", "#.."),
    "S": ("###", "#..", "###", "..#", "###"),
    "T": ("###", ".#.", ".#.", ".#.", ".#."),
    "U": ("#.#", "#.#", "#.#", "#.#", "###"),
}


def letter_loops(name: str) -> tuple[np.ndarray, ...]:
    """The corners of a block letter about the origin, two units high: outer loop counter-clockwise, holes clockwise."""
    rows = LETTERS[name]
    cells = [shapely.box(x, -y, x + 1, 1 - y) for y, row in enumerate(rows) for x, c in enumerate(row) if c == "#"]
    polygon = shapely.orient_polygons(shapely.simplify(shapely.union_all(cells), 0.0))
    middle = np.array([len(rows[0]) / 2, 1 - len(rows) / 2])
    rings = [polygon.exterior, *polygon.interiors]
    return tuple((shapely.get_coordinates(ring)[:-1] - middle) * (2 / len(rows)) for ring in rings)


def spiral_loop(turns: float, fill: float, points: int = 96) -> np.ndarray:
    """(2 points, 2) the outline of an Archimedean spiral strip whose middle line ends at radius 1.

    fill  the part of the pitch that the strip's width takes
    """
    angle = np.linspace(0, 2 * np.pi * turns, points)
    pitch = 1 / (turns + 0.5)
    radius = pitch * (0.5 + angle / (2 * np.pi))
    ray = np.stack([np.cos(angle), np.sin(angle)], 1)
    half = 0.5 * fill * pitch
    return np.concatenate([(radius + half)[:, None] * ray, ((radius - half)[:, None] * ray)[::-1]])


def naca(camber: float, position: float, thickness: float, points: int = 60) -> np.ndarray:
    """(2 points - 2, 2) a NACA four-digit airfoil, counter-clockwise from its sharp trailing edge, chord [-0.5, 0.5].

    camber     the largest distance of the mean line from the chord
    position   where along the chord the camber is largest
    thickness  the largest thickness

    All three are parts of the chord.

    Jacobs, Ward & Pinkerton, NACA Report 460, 1933; the last coefficient -0.1036 closes the trailing edge.
    """
    x = 0.5 * (1 - np.cos(np.linspace(0, np.pi, points)))
    y = 5 * thickness * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    front = x < position
    line = np.where(front, camber / position**2 * (2 * position * x - x**2),
                    camber / (1 - position) ** 2 * (1 - 2 * position + 2 * position * x - x**2))  # fmt: skip
    slope = np.arctan(np.where(front, camber / position**2, camber / (1 - position) ** 2) * 2 * (position - x))
    upper = np.stack([x - y * np.sin(slope), line + y * np.cos(slope)], 1)
    lower = np.stack([x + y * np.sin(slope), line - y * np.cos(slope)], 1)
    return np.concatenate([upper[::-1], lower[1:-1]]) - [0.5, 0.0]


def laid_along(goal: np.ndarray, count: int) -> np.ndarray:
    """(count, 2) positions at equal steps along the closed polyline; the one nearest to a corner lies on the corner."""
    edge = np.roll(goal, -1, 0) - goal
    ends = np.concatenate([[0.0], np.hypot(*edge.T).cumsum()])
    s = np.arange(count) / count * ends[-1]
    positions = np.stack([np.interp(s, ends, np.append(c, c[0])) for c in goal.T], 1)
    before = np.roll(edge, 1, 0)
    turn = np.abs(np.arctan2(before[:, 0] * edge[:, 1] - before[:, 1] * edge[:, 0], (before * edge).sum(1)))
    corners = np.flatnonzero(turn > np.pi / 6)
    positions[np.round(ends[corners] / ends[-1] * count).astype(int) % count] = goal[corners]
    return positions


def notched(width: float, position: float, thick: float, depth: float) -> np.ndarray:
    """(6, 2) a floor from left to right, `width` long, with a notch of `thick` by `depth` about `position`."""
    left, right = position - thick / 2, position + thick / 2
    return np.array([[0.0, 0], [left, 0], [left, depth], [right, depth], [right, 0], [width, 0]])


def regular_polygon(count: int) -> np.ndarray:
    """(count, 2) equally spaced vertices of the unit circle, counter-clockwise."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], 1)


def bent_band(arms: int) -> np.ndarray:
    """(N, 2) the outline of a band that bends `arms` times: 1 an L, 2 a U, 4 a G, 6 and more a spiral."""
    corners, position, heading = [np.array([0.0, 0.0])], np.array([0.0, 0.0]), np.array([1.0, 0.0])
    for arm in range(arms + 1):
        position = position + heading * (1.0 + (arms - arm) // 2)
        corners.append(position)
        heading = np.array([-heading[1], heading[0]])
    line = np.array(corners)
    half = 0.2
    sides = []
    for sign in (-1, 1):
        side = []
        for i, p in enumerate(line):
            before, after = (line[i] - line[i - 1] if i else None), (line[i + 1] - p if i + 1 < len(line) else None)
            normals = [np.array([-d[1], d[0]]) / np.linalg.norm(d) for d in (before, after) if d is not None]
            side.append(p + sign * half * (normals[0] if len(normals) == 1 else normals[0] + normals[1]))
        sides.append(np.array(side))
    return np.concatenate([sides[0], sides[1][::-1]])
