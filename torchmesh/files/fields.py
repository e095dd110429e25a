"""Decides what the data of a file means: which cell data tells the regions, and which numbers the cells."""

import meshio
import numpy as np

# Integer cell data that names regions (materials, groups, entities) in some format.  Where there is room for one
# only, the first of these is taken.
REGION_TAGS = (
    "gmsh:physical", "gmsh:geometrical", "medit:ref", "su2:tag", "cell_tags", "CellEntityIds", "nastran:ref",
    "avsucd:material", "netgen:index", "obj:group_ids", "MaterialIDs", "MaterialIds", "material", "region",
    "kratos:properties", "exodus:block",
)  # fmt: skip


def region_tag(mesh: meshio.Mesh) -> str | None:
    """The integer cell data that is written as the regions where a format has room for one."""
    whole = [name for name, v in mesh.cell_data.items() if all(b.dtype.kind in "iub" and b.ndim == 1 for b in v)]
    return next((name for name in REGION_TAGS if name in whole), whole[0] if whole else None)


def region_names(mesh: meshio.Mesh) -> list[str]:
    """All cell data that tells regions; the docstring of `mesh_files.read` states the rule."""
    names = []
    for name, blocks in mesh.cell_data.items():
        values = on_triangles(mesh, blocks)
        if values.dtype.kind in "iub" and values.ndim == 1:
            known = name in REGION_TAGS
            if known or 2 * len(np.unique(values)) <= len(values):
                names.append(name)
    return names


def is_numbering(values: np.ndarray) -> bool:
    """Has every row an integer of its own?  Such data is an identity, and no property, of the row."""
    return values.dtype.kind in "iu" and values.ndim == 1 and len(np.unique(values)) == len(values)


def on_triangles(mesh: meshio.Mesh, values: list[np.ndarray]) -> np.ndarray:
    """The part of cell data, given block by block, that belongs to triangles: (R, ...) in file order."""
    return np.concatenate([v for b, v in zip(mesh.cells, values, strict=True) if b.type == "triangle"])


def triangle_regions(mesh: meshio.Mesh, triangle: np.ndarray, count: int) -> np.ndarray:
    """(count,) a number for each triangle, the same for those that agree in all region tags and cell sets.

    triangle  (R,) the triangle that each triangle row of the file belongs to; a triangle with several rows is in
              the regions of all of them
    """
    columns = [on_triangles(mesh, mesh.cell_data[name]) for name in region_names(mesh)]
    for members in mesh.cell_sets.values():
        flags = [np.isin(np.arange(len(b.data)), m) for b, m in zip(mesh.cells, members, strict=True)]
        columns.append(on_triangles(mesh, flags))
    code = np.zeros(len(triangle), np.int64)
    for column in columns:
        values, rank = np.unique(column, return_inverse=True)
        code = np.unique(code * len(values) + rank.reshape(-1), return_inverse=True)[1].reshape(-1)
    if len(triangle) == count:
        return code
    # The rows of one triangle come in any order.  A sum of random words, one for each code, names their set.
    words = np.random.default_rng(0).integers(1 << 62, size=int(code.max()) + 1, dtype=np.uint64)
    total = np.zeros(count, np.uint64)
    np.add.at(total, triangle, words[code])
    return np.unique(total, return_inverse=True)[1].reshape(-1)
