"""Legacy VTK files: what meshio passes over stays."""

import torch
from file_contents import grid, save

from torchmesh.files.mesh_files import read, write


def test_legacy_vtk_keeps_title_and_field_data(tmp_path):
    source = save(tmp_path / "in.vtk", grid(), binary=False, file_format="vtk42")
    text = source.read_text().splitlines()
    text[1] = "a title of mine"
    text.insert(4, "FIELD FieldData 1\nTIME 1 1 double\n0.125")
    source.write_text("\n".join(text) + "\n")
    write(tmp_path / "out.vtk", read(source), like=source)
    after = (tmp_path / "out.vtk").read_text()
    assert "\na title of mine\n" in after
    assert "TIME 1 1 double\n0.125" in after
    assert torch.equal(read(tmp_path / "out.vtk").points, read(source).points)
