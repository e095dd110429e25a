"""Layers that were meant: they are held while the rest of the mesh is worked on.

      reference or given mesh          the mesh to be worked on                      the result
    find_layers ------------------> their vertices follow their walls, are ----> vertices and edges are
                                    held there, and their edges are constrained    as free as before

A held layer may leave the rest no room, for example where a wall has come too near to another one.  A mesh that stays
tangled is therefore tried again without its layers; if that is better, with the lower half of the rows, or a quarter.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..layering.following import follow_walls
from ..layering.layers import Layers, find_layers
from ..mesh.batch import MeshBatch, triangle_mesh, vertex_mesh
from ..mesh.connectivity import edge_components, keys_of
from ..mesh.measure import upright
from ..mesh.ragged import put_rows, rows_of
from .given import Given
from .runner import Job, Log
from .state import State

# Where not all rows of a layer can be held, these parts of them are tried, the larger first.
_SHARES = (0.5, 0.25)
# So many layers of a mesh are named in its message.
_NAMED = 3


def keeping_layers(job: Job, without: Job) -> Job:
    """The job that does `job` with the layers of each mesh held; it is `without` where no mesh has a layer."""

    def keep(state: State, log: Log) -> State:
        layers = find_layers(state.given if state.reference is None else state.reference, known=_known(state))
        if not len(layers):
            return without(state, log)
        done, has_layers = _with(layers, job, state, log)
        again = has_layers & ~done.valid
        return _with_fewer_rows(layers, job, state, done, again, log) if bool(again.any()) else done

    return keep


def _known(state: State) -> Tensor | None:
    """(T,) bool, which triangles of the meshes as given are upright, where that has been measured."""
    return state.quality.upright if state.reference is None else None


def _with(layers: Layers, job: Job, state: State, log: Log) -> tuple[State, Tensor]:
    """The job with these layers held, and (B,) bool in which meshes any are."""
    held = _Held.of(state, layers)
    every = torch.arange(len(state), device=state.meshes.device)
    done = job(held.state, log.view(every, lambda mesh: _as_free(mesh, state.mesh)))
    return held.released(done, state), held.has_layers


def _with_fewer_rows(layers: Layers, job: Job, state: State, done: State, again: Tensor, log: Log) -> State:
    """`done` with the meshes `again` (B,) bool tried with fewer rows, where that leaves fewer inverted triangles."""
    begun = state.select(again).naming_after(done)
    log.mark("whole", done.put(again, begun), again, kept=False)
    view = log.of_meshes(done.mesh, again)
    note = dict.fromkeys(range(len(begun)), "; there is no room for its layers, which were not kept")
    found = job(begun, view).noted(note)
    # A mesh that is no better without its layers has another fault.
    better = found.quality.inverted < done.quality.inverted[again]
    layers, left = _of_meshes(layers, state, again), better & found.valid
    for share in _SHARES:
        if bool(left.any()):
            some = _of_meshes(layers, begun, left).up_to(share)
            part, _ = _with(some, job, begun.select(left).naming_after(found), view.of_meshes(found.mesh, left))
            good = left.clone()
            good[left] = part.valid
            found = found.put(good, part.select(part.valid)) if bool(good.any()) else found
            left = left & ~good
    at = again.clone()
    at[again] = better
    whole = done.put(at, found.select(better)) if bool(better.any()) else done
    log.mark("layers", whole, again)
    return whole


def _of_meshes(layers: Layers, state: State, at: Tensor) -> Layers:
    """The layers of the meshes `at` (B,) bool, with the rows of `state.select(at)`."""
    mesh = state.given
    layers = layers.select(at[vertex_mesh(mesh)[layers.corners[:, 0]]])
    vertex, face = (_new_rows(at, offsets) for offsets in (mesh.point_offsets, mesh.triangle_offsets))
    return replace(
        layers,
        wall=3 * face[layers.wall // 3] + layers.wall % 3,
        corners=vertex[layers.corners],
        diagonal=vertex[layers.diagonal],
        triangles=face[layers.triangles],
    )


def _as_free(mesh: MeshBatch, before: MeshBatch) -> MeshBatch:
    """`mesh` with vertices and edges as free as in `before`, for the observer; not where vertices came and went."""
    if len(mesh.points) != len(before.points):
        return mesh
    return replace(mesh, fixed=before.fixed, constrained_edges=before.constrained_edges)


def _new_rows(at: Tensor, offsets: Tensor) -> Tensor:
    """(N,) int64 the row that each row of the meshes `at` (B,) bool has once the other meshes are gone; 0 for those."""
    new = torch.zeros(int(offsets[-1]), dtype=torch.int64, device=at.device)
    rows = rows_of(at, offsets)
    return put_rows(new, rows, torch.arange(len(rows), device=at.device))


@dataclass(frozen=True, eq=False)
class _Held:
    """A state with its layers held.

    state       that state
    has_layers  (B,) bool, the meshes in which anything is held
    added       (K,) int64, the keys of the edges that are constrained for the time being, by the rows of the origin
    """

    state: State
    has_layers: Tensor
    added: Tensor

    @classmethod
    def of(cls, state: State, layers: Layers) -> "_Held":
        """`state` with these layers, which are those of its meshes or of their reference, at their walls and held."""
        given, reference = state.given, state.reference
        points = given.points
        if reference is not None:
            points = follow_walls(layers, reference.points, given.points).to(given.points.dtype)
            layers = layers.unbroken(upright(given.with_points(points))[layers.triangles].all(1))
            points = torch.where(layers.vertices(len(points))[:, None], points, given.points)
        with_walls = layers.vertices(len(points))
        with_walls[layers.corners.reshape(-1)] = True
        # The walls are interfaces, in part; those hold still for their layers, even where they may move otherwise.
        held = with_walls & ~given.fixed
        rows = state.of_given_vertices(torch.arange(len(state.origin.mesh.points), device=points.device))
        edges = layers.loose_edges(given)
        origin = _origin(state.origin, rows, points, held, with_walls, edges)
        mesh = replace(state.mesh, points=points, fixed=state.mesh.fixed | held)
        added = keys_of(rows[edges], len(state.origin.mesh.points))
        mesh = replace(mesh, constrained_edges=torch.cat([mesh.constrained_edges, edges]))
        owner = triangle_mesh(given)[layers.triangles[:, 0]]
        has_layers = torch.zeros(len(state), dtype=torch.bool, device=points.device).index_fill_(0, owner, True)
        curves = None if state.curves is None else state.curves.holding(with_walls, mesh.point_offsets)
        begun = replace(state, origin=origin, curves=curves)
        begun = replace(begun, mesh=mesh) if reference is None else begun.at(mesh)
        called = {name: rows_in(edges, rows) for name, edges in state.origin.walls().items()}
        return cls(begun.noted(_notes(layers, owner, points, called)), has_layers, added)

    def released(self, done: State, before: State) -> State:
        """`done`, what became of the held state, with vertices and edges as free as in `before`."""
        origin, mesh = before.origin, done.mesh
        if done.curves is not None and before.curves is not None:
            done = replace(done, curves=replace(done.curves, slides=before.curves.slides))
        if done.names is None:
            mesh = replace(mesh, fixed=before.mesh.fixed, constrained_edges=before.mesh.constrained_edges)
            return replace(done, mesh=mesh, origin=origin)
        of, first = done.names.of, done.names.first
        kept = of < first
        fixed = torch.where(kept, origin.mesh.fixed[of.clamp_max(first - 1)], mesh.fixed)
        ends = of[mesh.constrained_edges]
        extra = (ends < first).all(1)
        extra[extra.clone()] = torch.isin(keys_of(ends[extra], first), self.added)
        mesh = replace(mesh, fixed=fixed, constrained_edges=mesh.constrained_edges[~extra])
        return replace(done, mesh=mesh, origin=origin)


def _origin(origin: Given, rows: Tensor, points: Tensor, held: Tensor, with_walls: Tensor, edges: Tensor) -> Given:
    """`origin` with the layers of some of its meshes held.

    rows  (V,) int64 the rows of these meshes' vertices in the origin, which the other arguments are numbered by
    """
    mesh = origin.mesh
    all_held, layers = (torch.zeros(len(mesh.points), dtype=torch.bool, device=rows.device) for _ in range(2))
    all_held[rows], layers[rows] = held, with_walls
    mesh = replace(
        mesh,
        points=put_rows(mesh.points, rows, points.to(mesh.points.dtype)),
        fixed=mesh.fixed | all_held,
        constrained_edges=torch.cat([mesh.constrained_edges, rows[edges]]),
    )
    return replace(origin, mesh=mesh, stays=origin.stays | layers, layers=layers)


def rows_in(edges: Tensor, rows: Tensor) -> Tensor:
    """(N, 2) those of the edges (K, 2) whose ends are among `rows` (V,), numbered by their positions in `rows`.

    rows  in ascending order
    """
    edges = torch.as_tensor(edges, device=rows.device)
    if not len(rows) or not len(edges):
        return torch.zeros((0, 2), dtype=torch.int64, device=rows.device)
    at = torch.searchsorted(rows, edges).clamp_max(len(rows) - 1)
    return at[(rows[at] == edges).all(1)]


def _notes(layers: Layers, owner: Tensor, points: Tensor, walls: Mapping[str, Tensor]) -> dict[int, str]:
    """For the message of each mesh: how many rows its layers have, at which wall, and how high they begin.

    walls  by name, the edges (K, 2) that are called so
    """
    keys = {name: keys_of(edges, len(points)) for name, edges in walls.items()}
    notes = {}
    meshes = owner.unique().tolist()
    for b in meshes:
        mine = layers.select(owner == b) if len(meshes) > 1 else layers
        texts = [
            f"layer of {int(part.row.max())} at {_wall_text(part, points, keys)}, first height "
            f"{float(_columns(part, points).median()):.2g}: kept"
            for part in _by_wall(mine)
        ]
        more = f"; and {len(texts) - _NAMED} more layers" if len(texts) > _NAMED else ""
        notes[b] = "; " + "; ".join(texts[:_NAMED]) + more
    return notes


def layers_in_words(mesh: MeshBatch, walls: Mapping[str, Tensor]) -> str:
    """The layers of a batch of one, as messages tell them; empty for none.

    walls  by name, the edges (K, 2) that are called so
    """
    layers = find_layers(mesh)
    if not len(layers.row):
        return ""
    text = "; ".join(_notes(layers, torch.zeros_like(layers.row), mesh.points, walls).values())
    return text.removeprefix("; ").replace(": kept", "")


def _wall_text(layers: Layers, points: Tensor, walls: Mapping[str, Tensor]) -> str:
    """What the wall of one layer is called: by its names, or else by a position on it.

    walls  by name, the keys of the edges that are called so
    """
    feet = layers.corners[layers.row == 1, :2]
    keys = keys_of(feet, len(points))
    names = [repr(name) for name, own in walls.items() if bool(torch.isin(keys, own).any())]
    if names:
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        return f"wall {', '.join(names[:_NAMED])}{more}"
    # The corner of the wall that is nearest to its middle lies on the wall, which the middle need not.
    there = points[feet.reshape(-1)].to(torch.float64)
    x, y = there[(there - there.mean(0)).square().sum(1).argmin()].tolist()
    return f"the wall near ({x:.6g}, {y:.6g})"


def _columns(layers: Layers, points: Tensor) -> Tensor:
    """The lengths of the columns of the first row."""
    foot, top = (points[layers.corners[layers.row == 1, k]] for k in (0, 3))
    return (top - foot).norm(dim=1)


def _by_wall(layers: Layers) -> list[Layers]:
    """The layers of one mesh, one for each connected run of wall."""
    first = layers.row == 1
    feet = layers.corners[first, :2]
    label = edge_components(feet, int(feet.max()) + 1)
    if bool((label[feet] == label[feet[0, 0]]).all()):
        return [layers]
    of_wall = torch.zeros(int(layers.wall.max()) + 1, dtype=torch.int64, device=feet.device)
    of_wall[layers.wall[first]] = label[feet[:, 0]]
    which = of_wall[layers.wall]
    return [layers.select(which == k) for k in which.unique().tolist()]
