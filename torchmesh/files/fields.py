"""Decides what the data of a file means: which cell data tells the regions, and which numbers the cells."""

import re
from dataclasses import dataclass

import meshio
import numpy as np

# Integer cell data that names regions (materials, groups, entities) in some format.  Where there is room for one
# only, the first of these is taken.
REGION_TAGS = (
    "gmsh:physical", "gmsh:geometrical", "medit:ref", "su2:tag", "cell_tags", "CellEntityIds", "nastran:ref",
    "avsucd:material", "netgen:index", "obj:group_ids", "MaterialIDs", "MaterialIds", "material", "region",
    "kratos:properties", "exodus:block", "freefem:label", "mfem:attribute", "triangle:attribute", "sms:material",
    "comsol:entity", "adcirc:boundary", "vtm:block",
    "unv:property",
)  # fmt: skip


# Words in the names of cell data that tells regions, in any spelling (`material_id`, `MaterialID`, `Mat Id`).
_REGION_WORDS = frozenset((
    "material", "materials", "mat", "mats", "region", "regions", "domain",
    "domains", "subdomain", "subdomains", "zone", "zones", "block", "blocks", "physical",
    "phase", "phases", "group", "groups", "entity", "entities", "entityid", "entityids", "attribute",
    "attributes", "marker", "markers", "label", "labels", "tag", "tags", "ref", "refs", "reference", "property",
    "properties", "pid", "section", "sections", "tissue", "tissues", "medium", "media", "elset", "elsets", "soil",
    "soils", "family", "families", "facies", "lithology",
))  # fmt: skip
# Words of what repeats and is no region, whatever else the name has.
_NO_REGION_WORDS = frozenset((
    "rank", "ranks", "mpi", "proc", "procs", "process", "processor", "processors", "partition", "partitions",
    "part", "parts", "level", "levels", "flag", "flags", "ghost", "ghosts", "owner", "owners", "thread",
    "threads", "colour", "color", "refine", "refined", "refinement", "refinements", "coarsen", "error", "quality",
    "visited", "valid", "valence", "count", "counts",
))  # fmt: skip
# meshio's set of the entities that bound others, which it also folds into one array of numbers with the other sets,
# under all their names: the cells of the groups behind them have no numbers there.
_NO_GROUP = "gmsh:bounding_entities"
# What FEniCS and its tutorials call tags of cells.
_FENICS = ("f", "name_to_read")
_SUFFIX = re.compile(r"(?<=[a-z]{3})(ids?|nos?|numbers?|nums?|index)$")
_WORD = re.compile(r"(?<=[a-z0-9])([A-Z])")

# More cell sets than this are counted, and not named, in a message.
_SETS_NAMED = 4


def region_tag(mesh: meshio.Mesh) -> str | None:
    """The integer cell data that is written as the regions where a format has room for one."""
    chosen = getattr(mesh, "told_by", None)
    told = Regions.of(mesh).data if chosen is None else chosen
    whole = [
        name
        for name, v in mesh.cell_data.items()
        if name in told and all(b.dtype.kind in "iub" and b.ndim == 1 for b in v)
    ]
    return next((name for name in REGION_TAGS if name in whole), whole[0] if whole else None)


@dataclass(frozen=True)
class Regions:
    """What of a file tells the regions of its triangles; the docstring of `mesh_files.read` states the rule.

    data    the names of cell data that tells regions
    sets    the names of cell sets that do
    others  the names of integer cell data that might tell regions, but has a name that means something else
    """

    data: tuple[str, ...] = ()
    sets: tuple[str, ...] = ()
    others: tuple[str, ...] = ()

    @classmethod
    def of(cls, mesh: meshio.Mesh, choice: str | None = None) -> "Regions":
        """The regions by the rule (None), none ("none"), or those that one cell data or set tells, by its name.

        Raises ValueError for a name that does not exist or tells no regions.
        """
        taken, others = [], []
        for name, blocks in mesh.cell_data.items():
            values = on_elements(mesh, blocks)
            if values.dtype.kind not in "iub" or values.ndim != 1 or _NO_GROUP in name:
                continue
            found = len(np.unique(values))
            if name in REGION_TAGS or (means_regions(name) and 2 * found <= len(values)):
                taken.append(name)
            elif 1 < found <= len(values) // 2:
                others.append(name)
        if choice is None:
            return cls(tuple(taken), tuple(mesh.cell_sets), tuple(others))
        if choice == "none":
            return cls(others=(*taken, *others))
        if choice in mesh.cell_data:
            if not _is_whole(on_elements(mesh, mesh.cell_data[choice])):
                raise ValueError(f"cell data {choice!r} tells no regions: it is not one whole number for each cell")
            return cls((choice,), others=tuple(name for name in (*taken, *others) if name != choice))
        if choice in mesh.cell_sets:
            return cls(sets=(choice,), others=(*taken, *others))
        whole = [name for name, blocks in mesh.cell_data.items() if _is_whole(on_elements(mesh, blocks))]
        known = [*whole, *mesh.cell_sets]
        raise ValueError(
            f"there is no cell data or cell set {choice!r} to tell regions; "
            + (f"it has {', '.join(map(repr, known))}" if known else "it has none")
        )

    def __str__(self) -> str:
        """What tells the regions, in words; empty where nothing does."""
        sets = " and ".join(map(repr, self.sets)) if len(self.sets) <= _SETS_NAMED else ""
        parts = [f"cell data {' and '.join(map(repr, self.data))}"] if self.data else []
        parts += [f"cell set{'s' * (len(self.sets) > 1)} {sets}" if sets else f"{len(self.sets)} cell sets"]
        return " and ".join(parts if self.sets else parts[:-1])


def means_regions(name: str) -> bool:
    """Is this a name that people give to materials, groups or blocks, and not to parts of a computation?"""
    words = set(_WORD.sub(r" \1", name).replace("_", " ").lower().split())
    words = {_SUFFIX.sub("", part) for word in words for part in re.split(r"[^a-z]+", word) if part}
    return name in _FENICS or (not words & _NO_REGION_WORDS and bool(words & _REGION_WORDS))


def is_numbering(values: np.ndarray) -> bool:
    """Has every row an integer of its own?  Such data is an identity, and no property, of the row."""
    return values.dtype.kind in "iu" and values.ndim == 1 and len(np.unique(values)) == len(values)


def on_triangles(mesh: meshio.Mesh, values: list[np.ndarray]) -> np.ndarray:
    """The part of cell data, given block by block, that belongs to triangles: (R, ...) in file order."""
    parts = [v for b, v in zip(mesh.cells, values, strict=True) if b.type == "triangle"]
    return np.concatenate(parts) if parts else np.asarray(values[0])[:0] if values else np.zeros(0)


def on_elements(mesh: meshio.Mesh, values: list[np.ndarray]) -> np.ndarray:
    """The part of cell data that belongs to triangles; of a mesh without triangles, that of the quads."""
    kinds = {block.type for block in mesh.cells if len(block.data)}
    wanted = "triangle" if "triangle" in kinds or "quad" not in kinds else "quad"
    parts = [v for b, v in zip(mesh.cells, values, strict=True) if b.type == wanted]
    return np.concatenate(parts) if parts else np.asarray(values[0])[:0] if values else np.zeros(0)


def triangle_regions(mesh: meshio.Mesh, triangle: np.ndarray, count: int, told: Regions) -> np.ndarray:
    """(count,) a number for each triangle, the same for those that agree in all that tells regions.

    triangle  (R,) the triangle that each triangle row of the file belongs to; a triangle with several rows is in
              the regions of all of them
    """
    columns = [on_triangles(mesh, mesh.cell_data[name]) for name in told.data]
    for members in (mesh.cell_sets[name] for name in told.sets):
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


def _is_whole(values: np.ndarray) -> bool:
    """Is there one whole number for each cell?"""
    return values.ndim == 1 and values.dtype.kind in "iubf" and bool((values == np.round(values)).all())
