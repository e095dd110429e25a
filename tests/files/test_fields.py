"""Which data of a file tells regions."""

import meshes
import meshio
import numpy as np
import pytest
from file_contents import LEFT, N, flipped, grid, load, save

from torchmesh.errors import InvalidMeshError, MeshWarning
from torchmesh.files.fields import Regions
from torchmesh.files.mesh_files import read, write
from torchmesh.files.source import Source


def constrained(tmp_path, **changes) -> int:
    return len(read(save(tmp_path / "a.vtu", grid(**changes))).constrained_edges)


@pytest.mark.parametrize(
    ("name", "values", "edges"),
    [
        ("gmsh:physical", "sides", N - 1),
        ("material_id", "sides", N - 1),
        ("SubdomainMarker", "sides", N - 1),
        ("Mat Id", "sides", N - 1),
        ("material_id", "sides as float", 0),
        ("material_id", "number of each", 0),
        # What merely repeats is no region, whatever it is called.
        ("rank", "sides", 0),
        ("part_id", "sides", 0),
        ("level", "sides", 0),
        ("refinement_flag", "sides", 0),
        ("vtkGhostType", "sides", 0),
        ("mpi_domain_rank", "sides", 0),
        ("anything", "sides", 0),
        ("CellEntityIds", "number of each", 40),  # a name that means regions is taken at its word
    ],
)
def test_regions_part_where_integers_differ(tmp_path, name, values, edges):
    sides = grid().cell_data["region"][1]
    field = {"sides": sides, "sides as float": sides.astype(float), "number of each": np.arange(32)}[values]
    assert constrained(tmp_path, cell_data={name: [np.zeros(4, field.dtype), field]}) == edges


def test_a_name_or_none_chooses_what_tells_the_regions(tmp_path):
    sides = grid().cell_data["region"][1]
    data = {
        name: [np.zeros(4, v.dtype), v] for name, v in (("rank", sides), ("whole", sides + 0.0), ("half", sides / 4))
    }
    path = save(tmp_path / "a.vtu", grid(cell_data=data | {"material": [np.zeros(4, int), np.ones(32, int)]}))
    assert len(read(path).constrained_edges) == 0
    assert len(read(path, regions="rank").constrained_edges) == N - 1
    assert len(read(path, regions="whole").constrained_edges) == N - 1
    assert Source.open(path).content.told_by == Regions(("material",), (), ("rank",))
    for name, why in (("half", "not one whole number"), ("absent", "it has 'rank', 'whole', 'material'")):
        with pytest.raises(InvalidMeshError, match=why):
            read(path, regions=name)
    path = save(tmp_path / "b.vtu", grid())
    assert len(read(path).constrained_edges) == N - 1
    assert len(read(path, regions="none").constrained_edges) == 0


def test_what_is_not_taken_for_regions_is_no_region_in_a_format_with_room_for_one(tmp_path):
    sides = grid().cell_data["region"][1]
    path = save(tmp_path / "a.vtu", grid(cell_data={"rank": [np.zeros(4, int), sides]}, point_data={}))
    source = Source.open(path)
    with pytest.warns(MeshWarning, match="rank"):
        write(tmp_path / "b.mesh", source.mesh, like=source)
    source = Source.open(path, "rank")
    write(tmp_path / "c.mesh", source.mesh, like=source)
    assert len(read(tmp_path / "c.mesh").constrained_edges) == N - 1


def test_cell_sets_are_regions(tmp_path):
    sides = grid().cell_data["region"][1]
    sets = {"STEEL": [np.arange(0), np.flatnonzero(sides == LEFT)]}
    save(tmp_path / "in.inp", grid(cell_data={}, point_data={}, cell_sets=sets))
    mesh = read(tmp_path / "in.inp")
    assert len(mesh.constrained_edges) == N - 1
    write(tmp_path / "out.inp", flipped(mesh), like=tmp_path / "in.inp")
    members = load(tmp_path / "out.inp").cell_sets["STEEL"]
    np.testing.assert_array_equal(np.concatenate(members), np.flatnonzero(sides == LEFT))


def test_a_region_tag_in_a_column_of_its_own_is_a_region_tag(tmp_path):
    """Gmsh's legacy VTK files have their CellEntityIds as (cells, 1)."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], float)
    cells = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    tags = np.array([[1], [1], [2], [2]], np.int32)
    path = tmp_path / "tags.vtu"
    meshio.Mesh(np.c_[points, np.zeros(6)], [("triangle", cells)], cell_data={"CellEntityIds": [tags]}).write(path)
    assert {frozenset(edge) for edge in read(path).constrained_edges.tolist()} == {frozenset((1, 2))}


def test_only_data_that_can_tell_regions_is_offered():
    points, triangles = meshes.grid_arrays(2, 2)
    data = {"perm": [np.linspace(0, 1, len(triangles))], "rock": [np.arange(len(triangles)) % 2]}
    with pytest.raises(ValueError, match=r"to tell regions; it has 'rock'$"):
        Regions.of(meshio.Mesh(points, [("triangle", triangles)], cell_data=data), "foo")
