"""Boundary and interface vertices that slide along their curves while the interior is smoothed.

A sliding vertex has one unknown: its parameter on its curve.  This unknown takes the slot of the vertex's x coordinate,
and the slot of its y coordinate stays empty.  The optimiser moves interior and sliding vertices together and does not
see the difference.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.alone import errors_alone
from ..mesh.batch import MeshBatch
from ..mesh.curve_fitting import fit_curves
from ..mesh.curve_motion import order_penalty, restore_area
from ..mesh.curves import BoundaryCurves
from ..mesh.interfaces import Interfaces, interface_vertices
from ..mesh.measure import upright
from ..mesh.ragged import counts_from_offsets, owner_of, segment_any, segment_max, segment_sum, spread, true_rows
from ..mesh.triangle import corners, signed_area
from ..optimising.blocks import BLOCK
from ..optimising.objective import MeshObjective, Packing
from ..triangulating.crossings import crossing_pairs

# The area that the chain of a curve encloses may change by this part of its mesh's area, which is what rounding comes
# to; where it changes by more than twice as much, the slide is shortened.
AREA_TOLERANCE = 1e-9


# How often a slide is halved that would invert a triangle, cross the boundary or change an area, before the mesh stays.
_HALVINGS = 10


def curves_of(
    batch: MeshBatch,
    corner_angle: float = 40.0,
    hold: Tensor | None = None,
    *,
    boundary: Literal["fixed", "slide"] = "slide",
    interfaces: Interfaces = "slide",
) -> BoundaryCurves:
    """The curves along the boundary and the constrained edges, with the vertices on them as they are now.

    corner_angle  degrees; a vertex where the curve turns by more is a corner and stays
    hold          (V,) bool, further vertices that stay
    boundary      "fixed": the vertices on the boundary stay
    interfaces    "fixed": the vertices on constrained edges stay; "slide": those stay that are `fixed`; "free": they
                  are on no curve, and where an interface ends is no corner of the boundary

    Where curves meet is a corner.  Raises InvalidMeshError when `hold` has another shape or type.
    """
    if interfaces == "free":
        batch = replace(batch, constrained_edges=batch.constrained_edges[:0])
    network, on_network = _network(batch)
    if len(batch.constrained_edges):
        on_boundary = connectivity.boundary_vertices(batch.triangles, batch.twin, len(on_network))
        inside = interface_vertices(batch) & ~on_boundary
        on_network &= ~(inside & batch.fixed) if interfaces == "slide" else ~inside
        if boundary == "fixed":
            on_network &= ~on_boundary
    elif boundary == "fixed":
        on_network = torch.zeros_like(on_network)
    if hold is not None:
        hold = torch.as_tensor(hold, device=on_network.device)
        check_held(batch, hold)
        on_network &= ~hold
    return fit_curves(batch.points.to(torch.float64), network, on_network, corner_angle, batch.point_offsets)


def curves_or_errors(
    batch: MeshBatch, corner_angle: float = 40.0, hold: Tensor | None = None, **which: Any
) -> tuple[BoundaryCurves, dict[int, Exception]]:
    """As `curves_of`, but an error in one mesh is not raised: on its curves no vertex slides.

    Returns the curves, and the errors by the rows of their meshes.  The curves of the others are those that they have
    alone, to the bit.
    """
    check_held(batch, hold)
    try:
        return curves_of(batch, corner_angle, hold, **which), {}
    except Exception:
        errors = errors_alone(
            batch, lambda mesh, rows: curves_of(mesh, corner_angle, None if hold is None else hold[rows], **which)
        )
        if not errors:
            raise
    bad = torch.zeros(len(batch), dtype=torch.bool, device=batch.points.device)
    bad[list(errors)] = True
    still = spread(bad, batch.point_offsets)
    # What made the errors is left out: no station is on these meshes.
    batch = batch.with_points(torch.where(still[:, None], 0.0, batch.points))
    return curves_of(batch, corner_angle, still if hold is None else hold | still, **which), errors


def check_held(batch: MeshBatch, hold: Tensor | None) -> None:
    """Raise InvalidMeshError unless `hold` is None or (V,) bool."""
    if hold is not None and (hold.dtype != torch.bool or hold.shape != batch.fixed.shape):
        raise InvalidMeshError(f"hold must be ({len(batch.fixed)},) bool, not {tuple(hold.shape)} {hold.dtype}")


def _network(batch: MeshBatch) -> tuple[Tensor, Tensor]:
    """(E, 2) the boundary and constrained edges, and (V,) bool their vertices."""
    network = torch.cat([connectivity.boundary_edges(batch.triangles, batch.twin), batch.constrained_edges])
    mask = torch.zeros(len(batch.points), dtype=torch.bool, device=network.device)
    mask[network.reshape(-1)] = True
    return network, mask


@dataclass(frozen=True, eq=False)
class SlidingObjective:
    """An objective in which sliding vertices have their parameter as unknown; an `lbfgs.Objective`.

    curves          in packed coordinates; S of their stations slide
    x_rows, y_rows  (S,) int64, the slots of the sliding vertices' coordinates
    shift           (S, 2) from the curve to the position that the vertex had
    """

    inner: MeshObjective
    curves: BoundaryCurves
    x_rows: Tensor
    y_rows: Tensor
    shift: Tensor

    @property
    def block_offsets(self) -> Tensor:
        return self.inner.block_offsets

    @property
    def scale(self) -> Tensor:
        """(N,) as that of the inner objective, and zero for the empty slots."""
        scale = self.inner.scale.clone()
        scale[self.y_rows] = 0
        return scale

    def __call__(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        curves = self.curves
        s = curves.moved_to(unknowns[self.x_rows])
        position, tangent, _ = curves.at(s)
        position, tangent = position[curves.slides] + self.shift, tangent[curves.slides]
        coordinates = unknowns.clone()
        coordinates[self.x_rows], coordinates[self.y_rows] = position[:, 0], position[:, 1]
        energy, gradient, done = self.inner(coordinates)
        penalty, slope, in_order = order_penalty(curves, s)
        along = gradient[self.x_rows] * tangent[:, 0] + gradient[self.y_rows] * tangent[:, 1]
        gradient[self.x_rows] = along + slope[curves.slides]
        gradient[self.y_rows] = 0
        return torch.where(in_order, energy + penalty, torch.inf), gradient, done

    def select(self, keep: Tensor) -> "SlidingObjective":
        """The meshes `keep` (B,) bool only."""
        kept = keep.repeat_interleave(counts_from_offsets(self.block_offsets)).repeat_interleave(BLOCK)
        shift = kept.to(torch.int64).cumsum(0) - 1
        stay = kept[self.x_rows]
        x_rows, y_rows = shift[self.x_rows[stay]], shift[self.y_rows[stay]]
        return SlidingObjective(self.inner.select(keep), self.curves.select(keep), x_rows, y_rows, self.shift[stay])


class _Goal(NamedTuple):
    """Where the optimiser wants the vertices.

    points    (V, 2) float64: interior vertices moved, all others as they were
    stations  (S,) the parameters of all stations of the curves
    still     (S,) bool, the stations of chains on which none moves
    """

    points: Tensor
    stations: Tensor
    still: Tensor


class Slide:
    """One smoothing of a batch with sliding vertices: from the packing to the vertices' new positions."""

    def __init__(self, batch: MeshBatch, curves: BoundaryCurves, packing: Packing) -> None:
        self.batch, self.packing = batch, packing
        rows = curves.rows(batch.point_offsets)
        x_row, y_row = (torch.full((len(batch.points),), -1, device=rows.device) for _ in range(2))
        x_row[packing.vertices], y_row[packing.vertices] = packing.x_rows, packing.y_rows
        self.curves = replace(curves, slides=curves.slides & (x_row[rows] >= 0))
        self.rows = rows[self.curves.slides]
        self.every_row = rows
        self.x_rows, self.y_rows = x_row[self.rows], y_row[self.rows]
        self.unit = spread(packing.unit, curves.offsets)

    def start(self, inner: MeshObjective) -> tuple[SlidingObjective, Tensor]:
        """The objective, and the unknowns to start from."""
        curves = self.curves.packed(self.packing.centre, self.packing.unit)
        positions = self.curves.at(self.curves.parameter)[0][self.curves.slides]
        shift = (self.batch.points[self.rows].to(positions) - positions) / self.unit[self.curves.slides][:, None]
        unknowns = self.packing.unknowns.clone()
        unknowns[self.x_rows] = curves.parameter[curves.slides]
        unknowns[self.y_rows] = 0
        return SlidingObjective(inner, curves, self.x_rows, self.y_rows, shift), unknowns

    def finish(self, unknowns: Tensor) -> tuple[Tensor, BoundaryCurves]:
        """(V, 2) the batch's points as `unknowns` have them, and the curves with their new stations.

        The vertices of each curve are pushed back along its normals, all by the same width, so that the curve
        encloses what it did.  Where a triangle inverts, an edge crosses another or an area changes, the whole mesh
        goes only half the way, then a quarter, and so on; at last it stays.
        """
        batch, curves = self.batch, self.curves
        goal = self._goal(unknowns)
        part = torch.ones(len(batch), dtype=torch.float64, device=batch.points.device)
        before = corners(batch.points.to(torch.float64), batch.triangles)
        tolerance = 2 * AREA_TOLERANCE * segment_sum(signed_area(before), batch.triangle_offsets)
        for halving in range(_HALVINGS + 1):
            points, s, segment, lack = self._on_the_way(goal, part)
            result = batch.with_points(points)
            wrong = self._wrong(result, goal.still, segment, lack, tolerance) & (part > 0)
            if not bool(wrong.any()):
                break
            part = torch.where(wrong, 0.5 * part if halving < _HALVINGS - 1 else 0.0, part)
        return result.points, replace(curves, parameter=s)

    def _goal(self, unknowns: Tensor) -> _Goal:
        """The end of the way, as the optimiser's `unknowns` have it."""
        curves, packing = self.curves, self.packing
        target = packing.unknowns.clone()
        target[:] = unknowns
        target[self.x_rows], target[self.y_rows] = packing.unknowns[self.x_rows], packing.unknowns[self.y_rows]
        stations = curves.moved_to(unknowns[self.x_rows] * self.unit[curves.slides])
        moves = (stations != curves.parameter).to(stations.dtype)
        still = spread(segment_max(moves, curves.chain_offsets) == 0, curves.chain_offsets)
        return _Goal(packing.unpack(target, self.batch.points).to(torch.float64), stations, still)

    def _on_the_way(self, goal: _Goal, part: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The meshes after `part` (B,) of the way: points, stations, their segments, and the area each chain lacks."""
        batch, curves = self.batch, self.curves
        before = batch.points.to(torch.float64)
        weight, along = spread(part, batch.point_offsets)[:, None], spread(part, curves.offsets)
        points = torch.where(weight == 1, goal.points, before + weight * (goal.points - before))
        s = curves.parameter + along * (goal.stations - curves.parameter)
        s = torch.where(along == 1, goal.stations, s)
        positions, _, segment = curves.at(s)
        positions = self._with_held(positions, before[self.every_row])
        positions, lack = restore_area(curves, positions, segment)
        moving = ~(goal.still | (along == 0))[curves.slides]
        points[self.rows[moving]] = positions[curves.slides][moving]
        return points, s, segment, lack

    def _with_held(self, positions: Tensor, before: Tensor) -> Tensor:
        """`positions` (K, 2) of the stations on the curves, but where they were `before` (K, 2) if they do not slide.

        Vertices that slid once and are held now lie beside the curve, as far as areas asked for.
        """
        curves = self.curves
        held = ~torch.where(curves.comes_again(), curves.slides[curves.first], curves.slides)
        rounding = 1e-12 * (curves.at_knot[curves.last] + before.abs().amax(1))
        held &= (positions - before).abs().amax(1) > rounding
        return torch.where(held[:, None], before, positions)

    def _wrong(self, result: MeshBatch, still: Tensor, segment: Tensor, lack: Tensor, tolerance: Tensor) -> Tensor:
        """(B,) bool: a triangle is inverted, a chain lacks more area than `tolerance` (B,), or edges cross."""
        curves = self.curves
        chains = curves.chain_offsets
        chain_mesh = owner_of(chains[:-1], curves.offsets)
        wrong = segment_any(~upright(result), result.triangle_offsets)
        off = (lack.abs() > tolerance[chain_mesh]) & ~still[chains[:-1]]
        wrong[chain_mesh[off]] = True
        # Vertices that slide along a straight line cannot make their edges cross others.
        bent = curves.slides & ~curves.straight[segment] & ~still
        return wrong | _crosses(result, segment_any(bent, curves.offsets) & ~wrong)


def on_the_curves(batch: MeshBatch, curves: BoundaryCurves, s: Tensor, at: Tensor) -> Tensor:
    """(V, 2) float64 the points of the batch, with the vertices of some chains at parameters s (K,) of their stations.

    at  (K,) bool: the chains of these stations are meant; they enclose what they did when the curves were fitted
    """
    positions, _, segment = curves.at(s)
    positions, _ = restore_area(curves, positions, segment)
    moves = segment_max(at.to(s.dtype), curves.chain_offsets) > 0
    moves = spread(moves, curves.chain_offsets) & curves.slides
    points = batch.points.to(torch.float64).clone()
    points[curves.rows(batch.point_offsets)[moves]] = positions[moves]
    return points


def _crosses(batch: MeshBatch, at: Tensor) -> Tensor:
    """(B,) bool: in this one of the meshes `at` (B,) bool, boundary or constrained edges cross each other."""
    crossing = torch.zeros_like(at)
    if not bool(at.any()):
        return crossing
    # The meshes of a batch lie over each other, so a search over all at once would find edges of different meshes.
    for b in true_rows(at).tolist():
        mesh = batch.select(torch.arange(len(batch), device=at.device) == b)
        edges, _ = _network(mesh)
        component = connectivity.triangle_components(mesh.triangles, mesh.twin)
        of_vertex = torch.zeros(len(mesh.points), dtype=torch.int64, device=component.device)
        of_vertex[mesh.triangles] = component[:, None]
        points = mesh.points.detach().to("cpu", torch.float64).numpy()
        group = of_vertex[edges[:, 0]].cpu().numpy()
        crossing[b] = len(crossing_pairs(points, edges.cpu().numpy(), group)) > 0
    return crossing
