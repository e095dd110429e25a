"""VTK's XML files: what meshio leaves out is there."""

import numpy as np
from file_contents import grid, load, save

from torchmesh.files.mesh_files import read, write


def test_vtu_keeps_field_data(tmp_path):
    source = save(tmp_path / "in.vtu", grid(field_data={"TIME": np.array([1 / 3])}))
    write(tmp_path / "out.vtu", read(source), like=source)
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").field_data["TIME"], [1 / 3])
