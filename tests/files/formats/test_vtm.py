"""Lists of blocks: blocks share vertices, bound regions, and are changed in files of their own."""

import os

import numpy as np
import pytest
from decks import changed_lines
from dialects import VTU as TEXT
from dialects import named

import torchmesh as tm
from torchmesh.files.documents import load

# The square of TEXT with its vertex in place, and two triangles to its right that share its side.
RIGHT = (
    TEXT.replace("0 0 0 1 0 0 1 1 0 0 1 0 1.4 0.5 0", "1 0 0 2 0 0 2 1 0 1 1 0 1.5 0.5 0")
    .replace('Name="rank" format="ascii">0 1 2 3 4', 'Name="rank" format="ascii">1 5 6 2 7')
)  # fmt: skip
LIST = """<?xml version="1.0"?>
<VTKFile type="vtkMultiBlockDataSet" version="1.0" byte_order="LittleEndian">
  <vtkMultiBlockDataSet>
    <Block index="0" name="domain">
      <DataSet index="0" name="fluid" file="a/left.vtu"/>
      <DataSet index="1" name="solid" file="a/right.vtu"/>
    </Block>
  </vtkMultiBlockDataSet>
</VTKFile>
"""


@pytest.fixture
def source(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "left.vtu").write_text(TEXT.replace("1.4 0.5", "0.9 0.5"))
    (tmp_path / "a" / "right.vtu").write_text(RIGHT)
    (tmp_path / "a.vtm").write_text(LIST)
    return tmp_path / "a.vtm"


def test_blocks_share_vertices_and_bound_regions(source):
    mesh = tm.read(source)
    assert len(mesh.points) == 8
    assert len(mesh.triangles) == 8
    assert mesh.constrained_edges.tolist() == [[1, 2]]
    assert named(source) == {"fluid": [[1, 2]]} or set(named(source)) == {"fluid", "solid"}
    assert load(source).mesh.point_data["rank"].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]


def test_blocks_are_written_beside_the_list(source, tmp_path):
    mesh = tm.read(source)
    points = mesh.points.clone()
    points[4, 0] = 0.5
    (tmp_path / "out").mkdir()
    tm.write(tmp_path / "out" / "b.vtm", mesh.with_points(points), like=source)
    assert sorted(os.listdir(tmp_path / "out")) == ["b.vtm", "b_0.vtu", "b_1.vtu"]
    assert (tmp_path / "out" / "b_1.vtu").read_text() == RIGHT
    changed = changed_lines(tmp_path / "a" / "left.vtu", tmp_path / "out" / "b_0.vtu")
    assert len(changed) == 2
    files = [new for _, new in changed_lines(source, tmp_path / "out" / "b.vtm")]
    assert [line.split("file=")[1] for line in files] == ['"b_0.vtu"/>', '"b_1.vtu"/>']
    assert np.array_equal(tm.read(tmp_path / "out" / "b.vtm").points, points)


def test_mistakes_name_the_block(source, tmp_path):
    (tmp_path / "a" / "right.vtu").write_text(RIGHT.replace("5 5 5 5", "5 5 5"))
    with pytest.raises(tm.MeshIOError, match=r"its block a/right\.vtu: it has 3 types"):
        tm.read(source)
    (tmp_path / "a" / "right.vtu").unlink()
    with pytest.raises(tm.MeshIOError, match=r"should lie in a/right\.vtu, which is no file"):
        tm.read(source)
    source.write_text(LIST.replace("a/left.vtu", "a/left.vts"))
    with pytest.raises(tm.MeshIOError, match=r"its block a/left\.vts is in a format of its own"):
        tm.read(source)
    source.write_text(LIST.replace("DataSet", "Data"))
    with pytest.raises(tm.MeshIOError, match="lists none"):
        tm.read(source)
