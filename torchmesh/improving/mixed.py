"""Meshes with quads: how `improve` sees them, what it says of those that stay inverted, and quads that are split.

    triangles and quads                 triangles, and the halves of quads
        given batch  ----- halved ----->  the strategy, as for any mesh; the edges of quads and their diagonals stay,
                                          |     energies are summed over the corners of quads, and every sign is
        result  <--------- whole --------+     that of all four corners

Under topology "full", vertices of triangles come and go afterwards, where the quads and their vertices stay.  Under
quads="split", the quads that came out inverted become two triangles, and the work begins anew from the mesh given.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.connectivity import corners_of
from ..mesh.measure import quality
from ..mesh.quads import (
    better_diagonals,
    halved,
    inverted_quads,
    quad_mesh,
    split_quads,
    triangles_alone,
    whole,
)
from ..mesh.ragged import counts_from_offsets, segment_count, true_rows
from .options import ImproveOptions
from .report import Report

# So many rows of inverted quads are told in a message.
_TOLD = 5
# How often quads that came out inverted are split, and the work begins anew.
_SPLITS = 4

Work = Callable[..., tuple[MeshBatch, Report]]


def improve_mixed(work: Work, batch: MeshBatch, options: ImproveOptions, **watch: Any) -> tuple[MeshBatch, Report]:
    """`improve` of a batch with quads.

    work   `improve` itself
    watch  its other arguments
    """
    chosen = torch.zeros(len(batch.quads), dtype=torch.bool, device=batch.points.device)
    asked, given, found = options, batch, _improved(work, batch, options, watch)
    for _ in range(_SPLITS if options.quads == "split" else 0):
        in_the_way = _in_the_way(given, *found)
        if not bool(in_the_way.any()):
            break
        if isinstance(options.smooth.targets, Tensor):
            raise ValueError("ImproveOptions.quads='split' changes the elements that smooth.targets are matrices of")
        chosen[true_rows(~chosen)[in_the_way]] = True
        like = batch if options.reference is None else options.reference
        other = better_diagonals(like, chosen)
        given = split_quads(batch, chosen, other)
        if options.reference is not None:
            asked = replace(options, reference=split_quads(options.reference, chosen, other))
        found = _improved(work, given, asked, watch)
    mesh, report = found
    return mesh, replace(report, split_quads=chosen, messages=_messages(batch, report, chosen, options))


def _in_the_way(given: MeshBatch, mesh: MeshBatch, report: Report) -> Tensor:
    """(Q,) bool, the quads to split of the meshes that are not valid: the inverted ones.

    Where only triangles are inverted, these are the quads that came inverted, or else those at such triangles.
    """
    invalid, owner = ~report.valid, quad_mesh(mesh)
    found = ~report.quality.quad_upright
    touched = corners_of(mesh.triangles, ~report.quality.upright, len(mesh.points))[mesh.quads].any(1)
    for others in (inverted_quads(given.points, given.quads), touched):
        left = invalid & (segment_count(found, mesh.quad_offsets) == 0)
        found = found | (others & left[owner])
    return found


def _improved(work: Work, batch: MeshBatch, options: ImproveOptions, watch: dict[str, Any]) -> tuple[MeshBatch, Report]:
    """The batch improved with the quads it has."""
    if not len(batch.quads):
        return work(batch, options, **watch)
    plain = options
    if options.topology == "full":
        plain = replace(options, topology="flip", remesh=type(options.remesh)())
    observe = watch.get("observe")
    seen = watch | {"observe": None if observe is None else lambda stage, mesh: observe(stage, whole(mesh))}
    if isinstance(options.smooth.targets, Tensor) and options.scope == "damage":
        raise ValueError("with quads, scope='damage' takes a metric as smooth.targets, not matrices of elements")
    reference = None if options.reference is None else halved(options.reference)
    # A submesh round the damage would have to tell elements from rows everywhere; the whole is worked on.
    mesh, report = work(halved(batch), replace(plain, reference=reference, local_repair=None), **seen)
    mesh = whole(mesh)
    report = replace(report, quality=quality(mesh))
    return (mesh, report) if options.topology != "full" else _remeshed(work, mesh, report, options, watch)


def _remeshed(
    work: Work, mesh: MeshBatch, report: Report, options: ImproveOptions, watch: dict[str, Any]
) -> tuple[MeshBatch, Report]:
    """The improved `mesh` after the vertices of its triangles have come and gone; quads stay, with their vertices."""
    some = counts_from_offsets(mesh.triangle_offsets) > 0
    if not bool(some.all()):
        raise InvalidMeshError(
            f"mesh {int((~some).nonzero()[0])} has quads alone: topology 'full' adds and removes vertices of "
            "triangles, and leaves quads as they are; take 'flip'"
        )
    if options.remesh.split_boundary:
        raise ValueError("RemeshOptions.split_boundary would halve edges of quads, which stay as they are")
    after, second = work(triangles_alone(mesh), replace(options, reference=None), **watch)
    assert second.vertex_map is not None
    row, kept = second.vertex_map.old_to_new, second.vertex_map.new_to_old
    edges = row[mesh.constrained_edges]
    known = connectivity.keys_of(after.constrained_edges, len(after.points))
    more = edges[~torch.isin(connectivity.keys_of(edges, len(after.points)), known)]
    done = replace(
        after,
        fixed=torch.where(kept >= 0, mesh.fixed[kept], after.fixed),
        constrained_edges=torch.cat([after.constrained_edges, more]),
        quads=row[mesh.quads],
        quad_offsets=mesh.quad_offsets,
    )
    q = quality(done)
    folded = segment_count(~q.quad_upright, done.quad_offsets) > 0
    last = [replace(step, mean=float(q.mean[b]), max=float(q.max[b]), inverted=int(q.inverted[b]))
            for b, step in enumerate(steps[-1] for steps in second.steps)]  # fmt: skip
    return done, replace(
        second,
        quality=q,
        valid=q.inverted == 0,
        status=torch.where(folded, report.status, second.status),
        certified=second.certified & report.certified & ~folded,
        steps=[a + b[1:-1] + [c] for a, b, c in zip(report.steps, second.steps, last, strict=True)],
        messages=[
            before if bad else now
            for before, now, bad in zip(report.messages, second.messages, folded.tolist(), strict=True)
        ],
        moved=report.moved,
        travel=report.travel,
    )


def _messages(given: MeshBatch, report: Report, chosen: Tensor, options: ImproveOptions) -> list[str]:
    """The messages with the rows of quads that are still inverted, and of those that became triangles.

    chosen  (Q,) bool, the quads of the batch given that became two triangles each
    """
    left = chosen.new_zeros(len(chosen))
    left[~chosen] = ~report.quality.quad_upright
    messages = [m.replace("inverted triangles are left", "inverted elements are left") for m in report.messages]
    messages = [m.replace("inverted triangle is left", "inverted element is left") for m in messages]
    for b, (first, end) in enumerate(itertools.pairwise(given.quad_offsets.tolist())):
        verbs = ("became two triangles each", "became two triangles each"), ("is inverted still", "are inverted still")
        for rows, (one, many) in zip((chosen[first:end], left[first:end]), verbs, strict=True):
            if bool(rows.any()):
                messages[b] += f"; {_rows_text(rows)} {many if int(rows.sum()) > 1 else one}"
        if bool(left[first:end].any()) and options.quads == "keep":
            messages[b] += ": with quads='split' (--quads split) such quads become two triangles each"
    return messages


def _rows_text(rows: Tensor) -> str:
    """How many quads (Q,) bool are marked, and the first of their rows."""
    found = true_rows(rows).tolist()
    more = ", ..." if len(found) > _TOLD else ""
    many = "s" * (len(found) > 1)
    return f"{len(found):,} quad{many} (row{many} {', '.join(map(str, found[:_TOLD]))}{more})"
