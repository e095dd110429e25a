"""Walls are called what a file calls them: groups, markers, surfaces, the regions beside an interface."""

import meshio
import numpy as np
import pytest
from file_contents import grid, save

from torchmesh.files.source import Source
from torchmesh.files.walls import walls_of

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]])
FACES = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])

SU2 = """NDIME= 2
NELEM= 4
5 0 1 4 0
5 0 4 3 1
5 1 2 5 2
5 1 5 4 3
NPOIN= 6
0 0 0
1 0 1
2 0 2
0 1 3
1 1 4
2 1 5
NMARK= 2
MARKER_TAG= lower
MARKER_ELEMS= 2
3 0 1
3 1 2
MARKER_TAG= upper
MARKER_ELEMS= 2
3 5 4
3 4 3
"""

ABAQUS = """*NODE
1, 0, 0
2, 1, 0
3, 2, 0
4, 0, 1
5, 1, 1
6, 2, 1
*ELEMENT, TYPE=CPE3, ELSET=STEEL
1, 1, 2, 5
2, 1, 5, 4
*ELEMENT, TYPE=CPE3, ELSET=FLUID
3, 2, 3, 6
4, 2, 6, 5
*SURFACE, NAME=WET, TYPE=ELEMENT
3, S1
"""


def edges(walls) -> dict[str, set[frozenset[int]]]:
    return {name: {frozenset(edge) for edge in rows.tolist()} for name, rows in walls.items()}


def of(*pairs: tuple[int, int]) -> set[frozenset[int]]:
    return {frozenset(pair) for pair in pairs}


def walls(path) -> dict[str, set[frozenset[int]]]:
    return edges(walls_of(Source.open(path)))


def test_markers_of_su2(tmp_path):
    (tmp_path / "a.su2").write_text(SU2)
    assert walls(tmp_path / "a.su2") == {"lower": of((0, 1), (1, 2)), "upper": of((5, 4), (4, 3))}


def test_surfaces_and_the_regions_beside_an_interface_of_abaqus(tmp_path):
    (tmp_path / "a.inp").write_text(ABAQUS)
    assert walls(tmp_path / "a.inp") == {"WET": of((1, 2)), "STEEL": of((1, 4)), "FLUID": of((1, 4))}


@pytest.mark.parametrize("named", [True, False])
def test_physical_groups_of_lines_go_before_those_of_regions(tmp_path, named):
    lines = np.array([[1, 4], [0, 1]])
    tags = [np.array([1, 1, 2, 2]), np.array([3, 4] if named else [7, 8])]
    mesh = meshio.Mesh(
        points=SQUARE,
        cells=[("triangle", FACES), ("line", lines)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={
            "body": np.array([1, 2]), "air": np.array([2, 2]), "skin": np.array([3, 1]), "floor": np.array([4, 1]),
        },
    )  # fmt: skip
    found = walls(save(tmp_path / "a.msh", mesh, file_format="gmsh22", binary=False))
    # The number 3 is no group of lines if nothing has it.
    expected = {"skin": of((1, 4)), "floor": of((0, 1))}
    assert found == (expected if named else {"body": of((1, 4)), "air": of((1, 4))})


def test_a_file_without_names_has_none(tmp_path):
    assert walls(save(tmp_path / "a.vtu", grid())) == {}
