"""Random domains and random motions of them, which `tm.domains` draws from.

A family draws a `Scene`: an outline to mesh, and a way to draw motions of it.  A motion takes the outline's vertices
along a path, from t = 0 (at rest) to t = 1.  Lengths are in the domain's own unit, about the height of its box.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..triangulating.mesher import Outline
from .outlines import LETTERS, laid_along, letter_loops, naca, notched, regular_polygon, spiral_loop

# From (Nb, 2) vertices on the outline at rest, (Nb,) the loop of each, and t to (Nb, 2) their positions at t.
Motion = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


# Holes keep this distance from one another and from the rectangle around them; each centre is drawn so often at most.
_GAP, _CENTRE_TRIES = 0.06, 100


@dataclass(frozen=True, eq=False)
class Scene:
    """A domain and how it moves.

    outline  what is meshed
    motion   draws a motion of its boundary
    jitter   None, or the range of how far interior vertices are thrown: the standard deviation of a
             normal deviate, in local edge lengths
    """

    outline: Outline
    motion: Callable[[np.random.Generator], Motion]
    jitter: tuple[float, float] | None = None


def circle(rng: np.random.Generator) -> Scene:
    """A small round hole in a long rectangle, moved anywhere in it."""
    return _with_bodies(rng, width=2.4, radii=[rng.uniform(0.05, 0.1)], shapes=[_round], turn=0.0)


def bar(rng: np.random.Generator) -> Scene:
    """A thin bar in a rectangle, moved and turned by up to 90 degrees."""
    return _with_bodies(rng, width=2.0, radii=[rng.uniform(0.15, 0.25)], shapes=[_thin], turn=np.pi / 2)


def holes(rng: np.random.Generator) -> Scene:
    """A rectangle with one to five round, oblong, angular or wavy holes, each moved and turned by up to 180 degrees."""
    count = int(rng.integers(1, 6))
    shapes = [(_round, _thin, _oblong, _angular, _wavy)[i] for i in rng.integers(0, 5, count)]
    return _with_bodies(rng, rng.uniform(1.2, 2.4), list(rng.uniform(0.06, 0.16, count)), shapes, np.pi)


def airfoil(rng: np.random.Generator) -> Scene:
    """A NACA airfoil of chord 1 in a round far field, finely meshed, turned by up to 150 degrees and moved."""
    reach = rng.uniform(3.0, 6.0)
    wing = naca(rng.uniform(0.0, 0.06), rng.uniform(0.25, 0.55), rng.uniform(0.08, 0.2))
    outline = Outline((reach * regular_polygon(96), wing[::-1]), (1.0, rng.uniform(0.08, 0.15)))

    def motion(rng: np.random.Generator) -> Motion:
        angle = rng.uniform(-150, 150) * np.pi / 180
        shift = rng.uniform(0, 0.4) * reach * _direction(rng)
        return lambda p, loop, t: np.where((loop == 1)[:, None], _turned(p, t * angle) + t * shift, p)

    return Scene(outline, motion)


def gate(rng: np.random.Generator) -> Scene:
    """A rectangle with one or two notches in its floor and ceiling, each pushed in or pulled out and bent aside."""
    width, thick = rng.uniform(1.4, 2.2), rng.uniform(0.08, 0.2, 2)
    depth = rng.uniform(0.15, 0.35, 2)
    middle = np.array([rng.uniform(0.25, 0.4), rng.uniform(0.6, 0.75)]) * width
    twice = bool(rng.integers(2))
    floor = notched(width, middle[0], thick[0], depth[0])
    ceiling = notched(width, width - middle[1], thick[1], depth[1]) if twice else np.array([[0.0, 0], [width, 0]])
    outline = Outline((np.concatenate([floor, [width, 1.0] - ceiling]),), (1.0,))

    def motion(rng: np.random.Generator) -> Motion:
        push = rng.uniform([-0.3, -0.1], [0.3, 0.45], (2, 2))

        def move(p: np.ndarray, loop: np.ndarray, t: float) -> np.ndarray:
            moved = p.copy()
            for i, height in enumerate((p[:, 1], 1 - p[:, 1])[: 1 + twice]):
                # The end of the notch goes all the way, its flanks in proportion to their depth.
                part = np.where(np.abs(p[:, 0] - middle[i]) < 0.51 * thick[i], np.clip(height / depth[i], 0, 1), 0)
                moved += t * part[:, None] * push[i] * (1, 1 - 2 * i)
            return moved

        return move

    return Scene(outline, motion)


def jitter(rng: np.random.Generator) -> Scene:
    """The domains of `holes` at rest, their interior vertices thrown about by 0.3 to 4 local edge lengths."""
    return Scene(holes(rng).outline, lambda rng: lambda p, loop, t: p, jitter=(0.3, 4.0))


def letter(rng: np.random.Generator) -> Scene:
    """A block letter, some with holes, bent by a smooth random field and twisted about its middle."""
    loops = letter_loops(str(rng.choice(list(LETTERS))))
    outline = Outline(loops, (1.0,) * len(loops), 0.2)

    def motion(rng: np.random.Generator) -> Motion:
        twist, waves = rng.uniform(-2.5, 2.5), rng.normal(0, 0.12, (3, 2))
        frequency, phase = rng.uniform(2, 6, (3, 2)), rng.uniform(0, 2 * np.pi, 3)

        def move(p: np.ndarray, loop: np.ndarray, t: float) -> np.ndarray:
            bent = p + t * np.sin(p @ frequency.T + phase) @ waves
            return _turned(bent, t * twist * (bent**2).sum(1))

        return move

    return Scene(outline, motion)


def spiral(rng: np.random.Generator) -> Scene:
    """A strip wound up, wound further or back: turned by an angle in proportion to the distance from its middle."""
    outline = Outline((spiral_loop(rng.uniform(1.0, 2.0), rng.uniform(0.35, 0.6)),), (1.0,), 0.2)

    def motion(rng: np.random.Generator) -> Motion:
        angle = rng.uniform(1.5, 6.0) * rng.choice([-1, 1])
        return lambda p, loop, t: _turned(p, t * angle * np.hypot(*p.T))

    return Scene(outline, motion)


def onto(rng: np.random.Generator) -> Scene:
    """A disc whose boundary is laid, at equal steps, onto the outline of a block letter or of a spiral."""
    outline = Outline((regular_polygon(96),), (1.0,))
    simple = [name for name in LETTERS if len(letter_loops(name)) == 1]

    def motion(rng: np.random.Generator) -> Motion:
        if rng.integers(2):
            goal = letter_loops(str(rng.choice(simple)))[0]
        else:
            goal = spiral_loop(rng.uniform(0.6, 1.2), rng.uniform(0.4, 0.7))
        shift = int(rng.integers(0, len(goal)))

        def move(p: np.ndarray, loop: np.ndarray, t: float) -> np.ndarray:
            return (1 - t) * p + t * laid_along(np.roll(goal, -shift, 0), len(p))

        return move

    return Scene(outline, motion)


FAMILIES: dict[str, Callable[[np.random.Generator], Scene]] = {
    f.__name__: f for f in (circle, bar, holes, airfoil, gate, jitter, letter, spiral, onto)
}


def _with_bodies(
    rng: np.random.Generator, width: float, radii: list[float], shapes: list[Callable], turn: float
) -> Scene:
    """A rectangle, `width` by 1, with a hole of each shape and radius; motions take holes to other free positions."""
    walls = np.array([[0.0, 0], [width, 0], [width, 1], [0, 1]])
    start, radii = _free_centres(rng, width, radii)
    bodies = [
        (centre + radius * _turned(shape(rng), rng.uniform(0, 2 * np.pi)))[::-1]
        for centre, radius, shape in zip(start, radii, shapes, strict=False)
    ]
    outline = Outline((walls, *bodies), (1.0, *(rng.uniform(0.5, 1.0, len(bodies)))))

    def motion(rng: np.random.Generator) -> Motion:
        # Fewer holes may fit than before: the others stay.
        goal = start.copy()
        found, _ = _free_centres(rng, width, list(radii))
        goal[: len(found)] = found
        angle = np.append(0.0, rng.uniform(-turn, turn, len(radii)))
        pivot, shift = np.concatenate([[[0, 0]], start]), np.concatenate([[[0, 0]], goal - start])

        def move(p: np.ndarray, loop: np.ndarray, t: float) -> np.ndarray:
            return pivot[loop] + _turned(p - pivot[loop], t * angle[loop]) + t * shift[loop]

        return move

    return Scene(outline, motion)


def _free_centres(rng: np.random.Generator, width: float, radii: list[float]) -> tuple[np.ndarray, list[float]]:
    """Centres of discs in the rectangle, clear of it and of each other; discs that find no room are left out."""
    centres: list[np.ndarray] = []
    kept: list[float] = []
    for radius in radii:
        margin = radius + _GAP
        for centre in rng.uniform([margin, margin], [width - margin, 1 - margin], (_CENTRE_TRIES, 2)):
            if all(np.hypot(*(centre - c)) > radius + r + _GAP for c, r in zip(centres, kept, strict=True)):
                centres.append(centre)
                kept.append(radius)
                break
        else:
            if len(kept):
                break
    return np.array(centres), kept


def _round(rng: np.random.Generator) -> np.ndarray:
    return regular_polygon(48)


def _thin(rng: np.random.Generator) -> np.ndarray:
    half = rng.uniform(0.15, 0.3)
    return np.array([[-1, -half], [1, -half], [1, half], [-1, half]]) / np.hypot(1, half)


def _oblong(rng: np.random.Generator) -> np.ndarray:
    return regular_polygon(64) * [1.0, rng.uniform(0.3, 0.8)]


def _angular(rng: np.random.Generator) -> np.ndarray:
    return regular_polygon(int(rng.integers(3, 8)))


def _wavy(rng: np.random.Generator) -> np.ndarray:
    waves, depth = int(rng.integers(3, 7)), rng.uniform(0.05, 0.25)
    ring = regular_polygon(120)
    return ring * ((1 + depth * np.cos(waves * np.arctan2(ring[:, 1], ring[:, 0]))) / (1 + depth))[:, None]


def _direction(rng: np.random.Generator) -> np.ndarray:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def _turned(p: np.ndarray, angle: float | np.ndarray) -> np.ndarray:
    """(N, 2) turned about the origin by one angle or (N,) one each, in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1]], 1)
