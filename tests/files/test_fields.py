"""Which data of a file tells regions."""

import meshio
import numpy as np
import pytest
from file_contents import LEFT, N, flipped, grid, load, save

from torchmesh.files.mesh_files import read, write


def constrained(tmp_path, **changes) -> int:
    return len(read(save(tmp_path / "a.vtu", grid(**changes))).constrained_edges)


@pytest.mark.parametrize(
    ("name", "values", "edges"),
    [
        ("gmsh:physical", "sides", N - 1),
        ("anything", "sides", N - 1),
        ("anything", "sides as float", 0),
        ("anything", "number of each", 0),
        ("CellEntityIds", "number of each", 40),  # a name that means regions is taken at its word
    ],
)
def test_regions_part_where_integers_differ(tmp_path, name, values, edges):
    sides = grid().cell_data["region"][1]
    field = {"sides": sides, "sides as float": sides.astype(float), "number of each": np.arange(32)}[values]
    assert constrained(tmp_path, cell_data={name: [np.zeros(4, field.dtype), field]}) == edges


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
