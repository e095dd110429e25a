"""Meshes improved or remeshed together in one batch, and what each of them has of the result.

A batch of ten small meshes takes about as long as two of them alone.  That a mesh gets alone what it gets in a batch,
to the bit, is tested for each of the ways in which batches are used here.
"""

from dataclasses import replace

import torch

from torchmesh import (
    ImproveOptions,
    MeshBatch,
    RemeshInfo,
    RemeshOptions,
    Report,
    SizeConformity,
    improve,
    join,
    remesh,
)
from torchmesh.mesh.measure import Quality


def improved(parts: list[MeshBatch], options: ImproveOptions | None = None) -> list[tuple[MeshBatch, Report]]:
    """What `improve` makes of each mesh, and the report on it; options do not depend on the number of vertices."""
    batch = join(parts)
    after, report = improve(batch, options)
    q = report.quality
    assert report.regions is None, "regions are not taken apart here"
    infos = [None] * len(parts) if report.remeshed is None else _infos(report.remeshed, batch, after)
    results = []
    for b, mesh in enumerate(after.split()):
        rows = slice(*after.triangle_offsets[b : b + 2].tolist())
        here = slice(b, b + 1)
        own = replace(
            report,
            status=report.status[here], valid=report.valid[here], certified=report.certified[here],
            quality=Quality(
                q.area[rows], q.inverse_mean_ratio[rows], q.upright[rows], q.mean[here], q.max[here], q.inverted[here]
            ),
            steps=report.steps[here], messages=report.messages[here], moved=report.moved[here],
            remeshed=infos[b], sizes=_sizes(report.sizes, here), lost=report.lost[here], travel=None,
        )  # fmt: skip
        results.append((mesh, own))
    return results


def remeshed(parts: list[MeshBatch], options: RemeshOptions) -> list[tuple[MeshBatch, RemeshInfo]]:
    """What `remesh` makes of each mesh; sizes by vertex are those of all the meshes, one after the other."""
    batch = join(parts)
    after, info = remesh(batch, options)
    return list(zip(after.split(), _infos(info, batch, after), strict=True))


def _infos(info: RemeshInfo, batch: MeshBatch, after: MeshBatch) -> list[RemeshInfo]:
    maps = info.vertex_map.split(batch, after)
    size = torch.split(info.size, after.point_offsets.diff().tolist())
    counts = [info.splits, info.collapses, info.flips, info.rounds]
    return [
        RemeshInfo(*(c[b : b + 1] for c in counts), maps[b], size[b], _sizes(info.conformity, slice(b, b + 1)))
        for b in range(len(batch))
    ]


def _sizes(sizes: SizeConformity | None, here: slice) -> SizeConformity | None:
    return sizes and SizeConformity(sizes.mean[here], sizes.low[here], sizes.high[here])
