"""Fitting a mesh to a format: what has to go is named."""

import pytest
from file_contents import grid, save

from torchmesh.errors import MeshWarning
from torchmesh.files.mesh_files import read, write


def test_what_a_format_cannot_hold_is_named(tmp_path):
    source = save(tmp_path / "in.vtu", grid())
    with pytest.warns(MeshWarning, match=r"out\.off: off files do not hold .*'p'.*'region'.*line cells.*'u'.*'v'"):
        write(tmp_path / "out.off", read(source), like=source)
