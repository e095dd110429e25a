"""What a reader passes over is named when the file is written again: by warnings, in reports, and under --strict."""

import re
import struct
import warnings
from pathlib import Path

import h5py
import meshio
import pytest
from file_contents import grid, save

import torchmesh as tm
from experiments.robustness.attack.mutants import KINDS, sample
from torchmesh.files.formats import skipped
from torchmesh.files.formats.registry import FORMATS, format_of

OFF = "OFF\n# a square\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"
MEDIT = (
    "MeshVersionFormatted 2\nDimension 2\n# a square\nVertices\n4\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n"
    "Triangles\n2\n1 2 3 5\n1 3 4 5\nCorners\n2\n1\n2\nRidges\n1\n1\nEnd\n"
)
PLY = (
    "ply\nformat ascii 1.0\ncomment by hand\nobj_info 7\nelement vertex 3\nproperty double x\nproperty double y\n"
    "property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)
STL = (
    "solid my part\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    "endsolid\n"
)
TECPLOT = (
    '# measured\nTITLE = "plate"\nVARIABLES = "X", "Y", "u"\nDATASETAUXDATA a="b"\n'
    'ZONE T="inner", N=3, E=1, F=FEPOINT, ET=TRIANGLE\n0 0 1\n1 0 2\n0 1 3\n1 2 3\n'
)
PERMAS = (
    "!PERMAS DataFile Version 18.0\n! mine\n$ENTER COMPONENT NAME=A\n$STRUCTURE\n$COOR\n1 0. 0. 0.\n2 1. 0. 0.\n"
    "3 0. 1. 0.\n$ELEMENT TYPE=TRIA3\n1 1 2 3\n$MATERIAL NAME=S\n$END STRUCTURE\n$EXIT COMPONENT\n$FIN\n"
)
AVS = "# mine\n3 1 0 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n1 1 tri 1 2 3\n"
DOLFIN = (
    '<?xml version="1.0"?>\n<!-- mine -->\n<dolfin><mesh celltype="triangle" dim="2"><vertices size="3">'
    '<vertex index="0" x="0" y="0"/><vertex index="1" x="1" y="0"/><vertex index="2" x="0" y="1"/></vertices>'
    '<cells size="1"><triangle index="0" v0="0" v1="1" v2="2"/></cells><data/></mesh></dolfin>\n'
)
VTK = (
    "# vtk DataFile Version 3.0\nplate\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 3 double\n0 0 0\n1 0 0\n0 1 0\n"
    "CELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n5\nPOINT_DATA 3\nSCALARS u double 1\nLOOKUP_TABLE mine\n0\n1\n2\n"
    "LOOKUP_TABLE mine 1\n0 0 1 1\n"
)
NETGEN = (
    "# by hand\nmesh3d\ndimension\n2\ngeomtype\n0\n# surfnr bcnr domin domout np p1 p2 p3\nsurfaceelements\n1\n"
    "1 1 0 0 3 1 2 3\n#          X\npoints\n3\n0 0 0\n1 0 0\n0 1 0\nendmesh\n"
)
OBJ = "# by hand\nmtllib a.mtl\no part\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\ns 1\nf 1 2 3\nf 1 3 4\n"
CASES = {
    "a.off": (OFF, ["comments"]),
    "a.mesh": (MEDIT, ["comments", "Corners", "Ridges"]),
    "a.ply": (PLY, ["comments", "obj_info"]),
    "a.stl": (STL, ["the name 'my part'"]),
    "a.dat": (TECPLOT, ["comments", "the title 'plate'", 'T="inner"', "DATASETAUXDATA"]),
    "a.dato": (PERMAS, ["comments", "the name 'A'", "the element type TRIA3", "$MATERIAL"]),
    "a.vol": (NETGEN, ["comments"]),
    "a.avs": (AVS, ["comments"]),
    "a.xml": (DOLFIN, ["comments", "<data>"]),
}


def lost(path: Path, out: Path) -> list[str]:
    """What writing the mesh of a file at `out`, after it, says is not carried over."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        mesh = tm.read(path)
        before = len(said)
        tm.write(out, mesh, like=path)
    names = [re.sub(".*not carried over from [^:]*: ", "", str(w.message)) for w in said[before:]]
    return [name for text in names for name in text.split(", ")]


@pytest.mark.parametrize("name", CASES)
def test_what_a_reader_passes_over_is_named(tmp_path, name):
    text, names = CASES[name]
    (tmp_path / name).write_text(text)
    assert lost(tmp_path / name, tmp_path / f"out{Path(name).suffix}") == names
    assert lost(tmp_path / name, tmp_path / "out.vtu")[: len(names)] == names


@pytest.mark.filterwarnings("ignore::torchmesh.MeshWarning")
def test_it_stands_in_the_report_and_strict_writes_nothing(tmp_path):
    from torchmesh.commands.main import main

    (tmp_path / "a.mesh").write_text(MEDIT)
    assert main(["improve", str(tmp_path / "a.mesh"), str(tmp_path / "b.mesh"), "--strict", "-q"]) == 2
    assert not (tmp_path / "b.mesh").exists()
    report = tmp_path / "r.json"
    assert main(["improve", str(tmp_path / "a.mesh"), str(tmp_path / "b.mesh"), "--report", str(report), "-q"]) == 0
    assert "Corners" in report.read_text()


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "batch"])
def test_nothing_is_said_of_files_that_have_nothing_else(tmp_path, kind):
    path = sample(kind, tmp_path)
    mesh = tm.read(path)
    out = tmp_path / f"out{path.suffix}"
    assert lost(path, out) == []
    assert lost(out, out) == []
    assert len(mesh.triangles) == 32


def test_tables_and_metadata_of_vtk():
    assert list(skipped.each_once(skipped.in_vtk(VTK.encode()))) == ["the lookup table 'mine'"]
    assert skipped.in_vtk(b"POINTS 0 float\nMETADATA\nINFORMATION 0\n\n") == ["METADATA"]


def test_vtu_and_xdmf(tmp_path):
    path = save(tmp_path / "a.vtu", grid())
    text = path.read_text().replace("<Points>", "<!-- mine --><Points>").replace("<PointData", '<PointData Scalars="u"')
    path.write_text(text)
    assert lost(path, tmp_path / "b.vtp") == ["comments", "the active Scalars 'u'"]
    assert lost(path, tmp_path / "b.vtu") == []  # the file is changed in place
    assert "<!-- mine --><Points>" in (tmp_path / "b.vtu").read_text()
    strings = b'<FieldData><Array type="String" Name="case" format="ascii">65</Array></FieldData>'
    assert "the text 'case'" in skipped.in_xml(strings, "vtu")
    meshio.write(tmp_path / "a.xdmf", grid(), data_format="XML")
    path = tmp_path / "a.xdmf"
    path.write_text(path.read_text().replace("</Grid>", "<!-- mine --></Grid>"))
    assert lost(path, tmp_path / "b.xdmf") == ["comments"]
    assert skipped.in_xml(b"<Xdmf><Domain><Grid><Time/><Set/></Grid></Domain></Xdmf>", "xdmf") == ["<Set>", "<Time>"]


def test_hdf5(tmp_path):
    path = save(tmp_path / "a.med", grid())
    with h5py.File(path, "a") as file:
        file.create_group("PARAMETRES")
        (mesh,) = file["ENS_MAA"].values()
        (step,) = mesh.values()
        step["NOE"]["NUM"] = list(range(9))
    assert lost(path, tmp_path / "b.med") == ["PARAMETRES", "NUM of NOE"]
    path = save(tmp_path / "a.h5m", grid())
    with h5py.File(path, "a") as file:
        file["tstt/sets/list"] = [1, 2]
    assert lost(path, tmp_path / "b.h5m") == ["sets/list"]


def test_obj_with_other_rows(tmp_path):
    (tmp_path / "a.obj").write_text(OBJ)
    names = ["comments", "materials", "names of objects", "smoothing groups"]
    assert lost(tmp_path / "a.obj", tmp_path / "b.obj") == []
    assert sorted(lost(tmp_path / "a.obj", tmp_path / "b.off")) == names


def test_binary_keywords_of_medit():
    def keyword(code: int, content: bytes, at: int) -> bytes:
        return struct.pack("<ii", code, at + 8 + len(content)) + content

    data = struct.pack("<ii", 1, 2)
    for code, content in ((3, struct.pack("<i", 2)), (13, struct.pack("<ii", 1, 1)), (777, b"")):
        data += keyword(code, content, len(data))
    data += struct.pack("<ii", 54, 0)
    assert skipped.in_medit(data) == ["Corners", "the keyword 777"]


def test_netgen():
    text = b"mesh3d\nsurfaceelements\n1\n1 1 1 0 3 1 2 3\nface_colours\n1\n1 0 0 0\nsingular_points\n0\n"
    assert skipped.in_netgen(text) == ["face_colours", "domains of surfaceelements"]


def test_names_are_few_and_printable():
    assert skipped.each_once(["a", "b", "a", "c\n"]) == ("a", "b", "c?")
    many = skipped.each_once(map(str, range(25)))
    assert len(many) == 11
    assert many[-1] == "15 more of the kind"


def test_every_format_of_meshio_has_such_a_look():
    from torchmesh.files.formats.meshio_formats import MeshioFormat

    known = {f.name for f in FORMATS.values() if isinstance(f, MeshioFormat) and not (f.skipped or f.skipped_file)}
    # These are changed in place.
    assert known == {"exodus", "abaqus", "nastran", "mdpa"}
    assert format_of(Path("a.off")).name == "off"


def test_names_units_and_times_of_med_xdmf_and_hmf(tmp_path):
    import numpy as np

    plain = meshio.Mesh(grid().points[:, :2], [("triangle", grid().cells[1].data)], point_data={"u": np.arange(25.0)})
    plain.write(tmp_path / "a.med")
    assert skipped.in_med(tmp_path / "a.med") == []
    with h5py.File(tmp_path / "a.med", "a") as file:
        file["ENS_MAA/mesh"].attrs.update({"DES": b"a plate", "UNI": b"mm"})
        file["CHA/u"].attrs["UNI"] = b"K"
        next(iter(file["CHA/u"].values())).attrs["PDT"] = 0.5
    names = ["the description 'a plate'", "units of coordinates", "units of 'u'", "times of 'u'"]
    assert lost(tmp_path / "a.med", tmp_path / "b.med") == names
    plain.write(tmp_path / "a.hmf")
    with h5py.File(tmp_path / "a.hmf", "a") as file:
        file.attrs["title"] = "mine"
        file["domain/grid"].attrs["author"] = "me"
    assert skipped.in_hmf(tmp_path / "a.hmf") == ["the attribute 'title'", "the attribute 'author' of domain/grid"]
    meshio.write(tmp_path / "a.xdmf", plain, data_format="XML")
    (tmp_path / "a.xdmf").write_text(
        (tmp_path / "a.xdmf").read_text().replace('<Grid Name="Grid"', '<Grid Name="plate"')
    )
    assert lost(tmp_path / "a.xdmf", tmp_path / "b.vtu") == ["the name 'plate'"]
    assert lost(tmp_path / "a.xdmf", tmp_path / "b.xdmf") == []  # the file is changed in place
    assert '<Grid Name="plate"' in (tmp_path / "b.xdmf").read_text()
