"""Boundary and interface vertices that slide along their curves while the interior is smoothed.

A sliding vertex has one unknown, its parameter on its curve, which stands in the place of its x
coordinate; its y coordinate's place stays empty.  The optimiser moves interior and sliding
vertices together and knows nothing of it.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.curve_fitting import fit_curves
from ..mesh.curve_motion import order_penalty, restore_area
from ..mesh.curves import BoundaryCurves
from ..mesh.measure import upright
from ..mesh.ragged import counts_from_offsets, owner_of, segment_any, segment_max, segment_sum, spread
from ..mesh.triangle import corners, signed_area
from ..optimising.blocks import BLOCK
from ..optimising.objective import MeshObjective, Packing
from ..triangulating.crossings import crossing_pairs

# How much of a mesh's area the chain of a curve may change by, beyond which a slide is shortened.
AREA_TOLERANCE = 1e-9


# Halvings of a slide that would invert a triangle, cross the boundary or change an area.
_HALVINGS = 10


def curves_of(batch: MeshBatch, corner_angle: float = 40.0, hold: Tensor | None = None) -> BoundaryCurves:
    """The curves along the boundary and the constrained edges, with the vertices on them as they are now.

    corner_angle  degrees; a vertex where the curve turns by more is a corner and stays
    hold          (V,) bool, further vertices that stay
    """
    network, on_network = _network(batch)
    if hold is not None:
        hold = torch.as_tensor(hold, device=on_network.device)
        if hold.dtype != torch.bool or hold.shape != on_network.shape:
            raise InvalidMeshError(f"hold must be ({len(on_network)},) bool, not {tuple(hold.shape)} {hold.dtype}")
        on_network &= ~hold
    return fit_curves(batch.points.to(torch.float64), network, on_network, corner_angle, batch.point_offsets)


def _network(batch: MeshBatch) -> tuple[Tensor, Tensor]:
    """(E, 2) the boundary and constrained edges, and (V,) bool their vertices."""
    rim = connectivity.boundary_edges(batch.triangles, batch.twin)
    network = torch.cat([rim, batch.constrained_edges])
    mask = torch.zeros(len(batch.points), dtype=torch.bool, device=rim.device)
    mask[network.reshape(-1)] = True
    return network, mask


@dataclass(frozen=True, eq=False)
class SlidingObjective:
    """An objective whose sliding vertices have a parameter for an unknown, as an `lbfgs.Objective`.

    curves          in packed coordinates; those that slide have the S stations `sliding`
    x_rows, y_rows  (S,) int64, where their coordinates stand
    shift           (S, 2) from the curve to where the vertex was
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
        """(N,) as the inner one's, zero for the empty places."""
        scale = self.inner.scale.clone()
        scale[self.y_rows] = 0
        return scale

    def __call__(self, unknowns: Tensor) -> tuple[Tensor, Tensor, Tensor | None]:
        curves = self.curves
        s = curves.moved_to(unknowns[self.x_rows])
        place, tangent, _ = curves.at(s)
        place, tangent = place[curves.slides] + self.shift, tangent[curves.slides]
        coordinates = unknowns.clone()
        coordinates[self.x_rows], coordinates[self.y_rows] = place[:, 0], place[:, 1]
        energy, gradient, done = self.inner(coordinates)
        penalty, slope, in_order = order_penalty(curves, s)
        along = gradient[self.x_rows] * tangent[:, 0] + gradient[self.y_rows] * tangent[:, 1]
        gradient[self.x_rows] = along + slope[curves.slides]
        gradient[self.y_rows] = 0
        return torch.where(in_order, energy + penalty, torch.inf), gradient, done

    def select(self, keep: Tensor) -> "SlidingObjective":
        kept = keep.repeat_interleave(counts_from_offsets(self.block_offsets)).repeat_interleave(BLOCK)
        shift = kept.to(torch.int64).cumsum(0) - 1
        stay = kept[self.x_rows]
        x_rows, y_rows = shift[self.x_rows[stay]], shift[self.y_rows[stay]]
        return SlidingObjective(self.inner.select(keep), self.curves.select(keep), x_rows, y_rows, self.shift[stay])


class Slide:
    """One smoothing of a batch with sliding vertices: from the packing to the vertices' new places."""

    def __init__(self, batch: MeshBatch, curves: BoundaryCurves, packing: Packing) -> None:
        self.batch, self.packing = batch, packing
        rows = curves.rows(batch.point_offsets)
        x_row, y_row = (torch.full((len(batch.points),), -1, device=rows.device) for _ in range(2))
        x_row[packing.vertices], y_row[packing.vertices] = packing.x_rows, packing.y_rows
        self.curves = replace(curves, slides=curves.slides & (x_row[rows] >= 0))
        self.rows = rows[self.curves.slides]
        self.x_rows, self.y_rows = x_row[self.rows], y_row[self.rows]
        self.unit = spread(packing.unit, curves.offsets)

    def start(self, inner: MeshObjective) -> tuple[SlidingObjective, Tensor]:
        """The objective, and the unknowns to start from."""
        curves = self.curves.packed(self.packing.centre, self.packing.unit)
        places = self.curves.at(self.curves.parameter)[0][self.curves.slides]
        shift = (self.batch.points[self.rows].to(places) - places) / self.unit[self.curves.slides][:, None]
        unknowns = self.packing.unknowns.clone()
        unknowns[self.x_rows] = curves.parameter[curves.slides]
        unknowns[self.y_rows] = 0
        return SlidingObjective(inner, curves, self.x_rows, self.y_rows, shift), unknowns

    def finish(self, unknowns: Tensor) -> tuple[Tensor, BoundaryCurves]:
        """(V, 2) the batch's points where `unknowns` has them, and the curves with the stations there.

        The vertices of each curve go back by one width along its normals, so that it encloses what
        it did.  Where a triangle inverts, an edge crosses another or an area changes, that mesh
        goes half the way only, and so on; then it stays.
        """
        batch, curves, packing = self.batch, self.curves, self.packing
        target = packing.unknowns.clone()
        target[:] = unknowns
        target[self.x_rows], target[self.y_rows] = packing.unknowns[self.x_rows], packing.unknowns[self.y_rows]
        interior = packing.unpack(target, batch.points).to(torch.float64)
        before = batch.points.to(torch.float64)
        slid = curves.moved_to(unknowns[self.x_rows] * self.unit[curves.slides])
        chains = curves.chain_offsets
        still = spread(segment_max((slid != curves.parameter).to(slid.dtype), chains) == 0, chains)
        part = torch.ones(len(batch), dtype=before.dtype, device=before.device)
        area = segment_sum(signed_area(corners(before, batch.triangles)), batch.triangle_offsets)
        chain_mesh = owner_of(chains[:-1], curves.offsets)
        for halving in range(_HALVINGS + 1):
            weight = spread(part, batch.point_offsets)[:, None]
            points = torch.where(weight == 1, interior, before + weight * (interior - before))
            s = curves.parameter + spread(part, curves.offsets) * (slid - curves.parameter)
            s = torch.where(spread(part, curves.offsets) == 1, slid, s)
            places, _, segment = curves.at(s)
            places, lack = restore_area(curves, places, segment)
            moving = ~(still | (spread(part, curves.offsets) == 0))[curves.slides]
            points[self.rows[moving]] = places[curves.slides][moving]
            result = batch.with_points(points)
            wrong = segment_any(~upright(result), batch.triangle_offsets)
            off = (lack.abs() > 2 * AREA_TOLERANCE * area[chain_mesh]) & ~still[chains[:-1]]
            wrong[chain_mesh[off]] = True
            bent = curves.slides & ~curves.straight[segment] & ~still
            curved = segment_any(bent, curves.offsets)
            wrong |= _crosses(result, curved & ~wrong)
            wrong &= part > 0
            if not bool(wrong.any()):
                break
            part = torch.where(wrong, 0.5 * part if halving < _HALVINGS - 1 else 0.0, part)
        return result.points, replace(curves, parameter=s)


def _crosses(batch: MeshBatch, at: Tensor) -> Tensor:
    """(B,) bool: in this one of the meshes `at` (B,) bool, boundary or constrained edges cross each other."""
    crossing = torch.zeros_like(at)
    if not bool(at.any()):
        return crossing
    # Mesh by mesh: those of a batch lie over each other, and a search for neighbours would find them all.
    for b in at.nonzero().squeeze(1).tolist():
        mesh = batch.select(torch.arange(len(batch), device=at.device) == b)
        edges, _ = _network(mesh)
        piece = connectivity.triangle_components(mesh.triangles, mesh.twin)
        of_vertex = torch.zeros(len(mesh.points), dtype=torch.int64, device=piece.device)
        of_vertex[mesh.triangles] = piece[:, None]
        points = mesh.points.detach().to("cpu", torch.float64).numpy()
        group = of_vertex[edges[:, 0]].cpu().numpy()
        crossing[b] = len(crossing_pairs(points, edges.cpu().numpy(), group)) > 0
    return crossing
