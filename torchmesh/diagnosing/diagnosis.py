"""Can a valid mesh exist inside this boundary, whatever its triangles, and if not, why, and where is the fault?

With the triangles kept: can any positions of the free vertices make them valid?
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.interfaces import Interfaces, holding
from ..mesh.measure import upright
from ..mesh.quads import quads_as_halves
from ..mesh.ragged import segment_any, true_rows
from ..mesh.unfit import unfit_meshes, what_is_unfit
from .fixed_quads import fixed_quads, is_half
from .meetings import crossings, duplicates, overlaps, wrong_touchings
from .nesting import nestings
from .polygon_kernel import inverted_fixed_triangles, vertices_without_kernel
from .problems import Finding, Problem, ProblemKind, position_of, text_of
from .walls import HELD, Walls

# In a mesh that is known to be impossible, held edges are left out of the search for crossings when there are
# more edges than this: hundreds of thousands would take seconds.
_MANY = 50_000

# So often what is left of a batch is looked at together before each mesh is looked at alone.
_LOOKS = 4


@without_autograd
@quads_as_halves
def diagnose(
    batch: MeshBatch,
    topology: Literal["keep", "flip"] = "flip",
    most: int = 20,
    *,
    interfaces: Interfaces | None = None,
    thorough: bool = False,
) -> list[Problem]:
    """Everything about the fixed vertices and edges of each mesh that leaves it no valid triangulation.

    topology  "flip": triangles may change, quads not.  If no problem is found, `untangle_by_retriangulation` can repair
              the mesh, rounding permitting.  "keep": triangles stay, so
              the obstructions that moving free vertices cannot mend are told, too.  These are not all
              obstructions there are: a mesh without a problem may still have no valid positions
    most      how many problems of one kind are told of one mesh
    interfaces  "free": the ends of constrained edges may move; otherwise they are fixed, too
    thorough  with "keep": where nothing is found, look for a proof that goes from vertex to vertex, which takes up to
              seconds (`ProblemKind.NO_PLACE`)

    A mesh, or a piece of it, that has no inverted triangle is valid, and nothing is said of it.
    A boundary may touch itself, in vertices or along edges, with vertices of its own on each side, as
    a crack does; the vertices in a message are then the first ones in their position.
    Pieces of a mesh that no edge joins may lie over each other.  Loops may share vertices.  How loops
    lie, and whether the triangles are as many as a plane mesh of these vertices has, is looked at only in
    meshes whose edges do not cross.  Signs are exact.

    Raises ValueError for another `topology`.
    """
    if topology not in ("keep", "flip"):
        raise ValueError(f"topology must be 'keep' or 'flip', not {topology!r}")
    unfit = unfit_meshes(batch)
    if bool(unfit.any()):
        return _without_unfit(batch, unfit, topology, most, interfaces)
    batch = holding(batch, interfaces)
    keep = topology == "keep"
    problems = []
    for b in range(len(batch)) if len(batch.quads) else _suspects(batch, keep, most):
        mesh = _only(batch, torch.tensor([b], device=batch.points.device))
        told: dict[ProblemKind, int] = {}
        for kind, text, vertices, place in _with_quads(_of_one(mesh, keep, most), mesh, most):
            told[kind] = told.get(kind, 0) + 1
            if told[kind] <= most:
                problems.append(Problem(kind, text, b, vertices, place))
    if thorough and keep and not len(batch.quads):
        problems += _proved(batch, {problem.mesh for problem in problems})
    return sorted(problems, key=lambda problem: problem.mesh)


def _proved(batch: MeshBatch, known: set[int]) -> list[Problem]:
    """What a search from vertex to vertex proves of the meshes that are not `known` to have problems."""
    from .no_place import vertex_without_place

    problems = []
    tangled = segment_any(~upright(batch), batch.triangle_offsets)
    for b in true_rows(tangled).tolist():
        proof = None if b in known else vertex_without_place(batch[b])
        if proof is not None:
            v = proof.vertex
            ring = batch[b].triangles[(batch[b].triangles == v).any(1)].unique()
            place = position_of(batch[b].points[ring[ring != v]].mean(0).cpu().numpy())
            text = (
                f"vertex {v} has no place: wherever it is in the domain, an edge does not reach what it has to reach, "
                f"or a triangle is inverted ({len(proof.steps)} steps prove it)"
            )
            problems.append(Problem(ProblemKind.NO_PLACE, text, b, (v,), place, proof))
    return problems


def _suspects(batch: MeshBatch, keep: bool, most: int) -> list[int]:
    """The meshes that are to be looked at alone, in order; nothing is wrong with the others."""
    all_of = most * len(batch)
    suspects = _sieved(batch, partial(_at_first_sight, keep=keep, most=all_of))
    # Boundaries that touch themselves come this far, and are no problem as such.
    part = _only(batch, torch.tensor(suspects, dtype=torch.int64, device=batch.points.device))
    return [suspects[i] for i in _sieved(part, partial(_of_one, keep=keep, most=all_of))]


def _sieved(batch: MeshBatch, look: Callable[[MeshBatch], list[Finding]]) -> list[int]:
    """The meshes in which `look` might find something, in order.

    It looks at all of them together, as pieces of one.  What is found in one may hide what is wrong with another, so
    the others are looked at again, together, until nothing is found.
    """
    suspects: list[int] = []
    left = torch.arange(len(batch), device=batch.points.device)
    for _ in range(_LOOKS):
        if len(left) < 2:
            break
        part = _only(batch, left)
        found = look(part)
        if not found:
            left = left[:0]
            break
        vertices = torch.tensor([v for finding in found for v in finding.vertices], device=left.device)
        guilty = torch.zeros(len(left), dtype=torch.bool, device=left.device)
        guilty[torch.searchsorted(part.point_offsets, vertices, right=True) - 1] = True
        suspects += left[guilty].tolist()
        left = left[~guilty]
    return sorted(suspects + left.tolist())


def _only(batch: MeshBatch, meshes: Tensor) -> MeshBatch:
    """The `meshes` (K,) of the batch, in its order."""
    if len(meshes) == len(batch):
        return batch
    return batch.select(torch.zeros(len(batch), dtype=torch.bool, device=meshes.device).index_fill_(0, meshes, True))


def _at_first_sight(mesh: MeshBatch, keep: bool, most: int) -> list[Finding]:
    """Whether something may be wrong with one mesh, by what is found first."""
    walls = Walls.of(mesh, keep)
    return [] if walls is None else _meetings(walls, keep, most) or list(nestings(walls, keep))


def _with_quads(found: list[Finding], mesh: MeshBatch, most: int) -> list[Finding]:
    """What was `found` in one mesh with quads as halves, and the quads whose corners are held."""
    if not len(mesh.quads):
        return found
    return [f for f in found if not is_half(f, mesh)] + _first(fixed_quads(mesh), most)


def _without_unfit(
    batch: MeshBatch,
    unfit: Tensor,
    topology: Literal["keep", "flip"],
    most: int,
    interfaces: Interfaces | None,
) -> list[Problem]:
    """The problems where the meshes `unfit` (B,) bool have positions that one cannot compute with."""
    problems = []
    for b in true_rows(unfit).tolist():
        text, row = what_is_unfit(batch, b)
        x, y = batch.points[int(batch.point_offsets[b]) + row].tolist()
        problems.append(Problem(ProblemKind.NOT_FINITE, text, b, (row,), (x, y)))
    if not bool(unfit.all()):
        meshes = true_rows(~unfit).tolist()
        found = diagnose(batch.select(~unfit), topology, most, interfaces=interfaces)
        problems += [replace(problem, mesh=meshes[problem.mesh]) for problem in found]
    return sorted(problems, key=lambda problem: problem.mesh)


def _of_one(mesh: MeshBatch, keep: bool, most: int) -> list[Finding]:
    """The problems of one mesh; `keep` as in `Walls.of`."""
    walls = Walls.of(mesh, keep)
    if walls is None:
        return []
    found = _meetings(walls, keep, most)
    if not found:
        return list(nestings(walls, keep))
    if all(finding.kind in (ProblemKind.FIXED_TRIANGLE, ProblemKind.NO_KERNEL) for finding in found):
        return found
    # A boundary that touches itself, and does not cross itself, is no problem as such.
    flat, boundary = walls.in_plane()
    left = _meetings(flat, keep, most) + _first(overlaps(walls, boundary), most)
    if left:
        return left
    left = list(nestings(flat, keep))
    assert flat.doubled is not None
    if any(f.kind is ProblemKind.VERTEX_OUTSIDE and flat.doubled[f.vertices[0]] for f in left):
        # Where stretches of boundary lie on each other, no domain is on both sides: they are told.
        return found
    left = _overlapping(left, walls, keep)
    told = [finding for finding in left if finding.kind is not ProblemKind.NOT_PLANE]
    return told or _first(wrong_touchings(walls, boundary), most) or left


def _overlapping(found: list[Finding], walls: Walls, keep: bool) -> list[Finding]:
    """What was `found` of a boundary that was parted where it touches itself.

    A hole that lies wrongly may be a piece of a loop that is sound as a whole: rounding has laid the sides of a crack
    over each other.  There the boundary lies over itself, and a valid mesh may do so, too.
    """
    holes = (ProblemKind.HOLE_INSIDE_OUT, ProblemKind.HOLE_OUTSIDE)
    if not any(f.kind in holes for f in found) or any(f.kind in holes for f in nestings(walls, keep)):
        return found
    return [
        Finding(ProblemKind.BOUNDARY_CROSSING, f"the boundary lies over itself at {text_of(f.place)}", *f[2:])
        if f.kind in holes
        else f
        for f in found
    ]


def _meetings(walls: Walls, keep: bool, most: int) -> list[Finding]:
    """What meets that should not, and, with `keep`, what stands in the way of the triangles; of each kind `most`."""
    found = _first(duplicates(walls), most)
    edges, kind = walls.ends[walls.once], walls.kind[walls.once]
    if keep:
        found += _obstructions(walls, most)
        if found and len(edges) > _MANY:
            edges, kind = edges[kind != HELD], kind[kind != HELD]
    return found + crossings(walls, edges, kind, most)


def _first(found: Iterable[Finding], most: int) -> list[Finding]:
    """At most `most` of each kind; kinds come one after the other."""
    groups = itertools.groupby(found, key=lambda f: f[0])
    return [f for _, group in groups for f in itertools.islice(group, most)]


def _obstructions(walls: Walls, most: int) -> Iterator[Finding]:
    """What stands in the way of the triangles as they are, `most` of each kind at most."""
    points, faces, fixed = walls.points, walls.triangles, walls.fixed
    inner = walls.used.copy()
    inner[walls.ends[walls.alone]] = False
    for row in inverted_fixed_triangles(points, faces, fixed)[:most].tolist():
        place = position_of(points[faces[row]].mean(0))
        corners = faces[row].tolist()
        text = f"triangles row {row} {corners} at {text_of(place)} has three fixed vertices, and is not upright"
        yield Finding(ProblemKind.FIXED_TRIANGLE, text, tuple(corners), place)
    for v in vertices_without_kernel(points, faces, fixed, inner, most)[:most].tolist():
        ring = np.setdiff1d(faces[(faces == v).any(1)], [v])
        place = position_of(points[ring].mean(0))
        text = f"the fixed edges round vertex {v}, near {text_of(place)}, leave it no place"
        yield Finding(ProblemKind.NO_KERNEL, text, (v,), place)
