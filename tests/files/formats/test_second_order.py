"""Six-node triangles in the dialects of solvers: the element type, the order of the nodes and all other lines stay."""

import curved_meshes as cm
import meshio
import numpy as np
import pytest

import torchmesh as tm
from torchmesh.batches.file_improvement import improve_series, open_mesh
from torchmesh.files.documents import load

POINTS, SIX = cm.tangled_annulus()

# An element and its side, counted from 1, on the outer circle: it bears a load.
LOADED, SIDE = next(
    (row + 1, side + 1)
    for row, nodes in enumerate(SIX.tolist())
    for side in range(3)
    if np.isclose(np.hypot(*POINTS[nodes[3 + side], :2]), 1.0)
)


def abaqus(path, kind="CPE6"):
    lines = ["*HEADING", "a ring", "*NODE, NSET=ALL"]
    lines += [f"{k + 11}, {x!r}, {y!r}" for k, (x, y, _) in enumerate(POINTS.tolist())]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=RING"]
    lines += [f"{k + 1}, " + ", ".join(str(n + 11) for n in row) for k, row in enumerate(SIX.tolist())]
    lines += ["*SOLID SECTION, ELSET=RING, MATERIAL=STEEL", "1.", "*MATERIAL, NAME=STEEL", "*ELASTIC", "210000., 0.3"]
    lines += ["*STEP", "*STATIC", "*DLOAD", f"{LOADED}, P{SIDE}, 2.5", "*END STEP"]
    path.write_text("\n".join(lines) + "\n")
    return path


def nastran(path, name="CTRIA6"):
    order = [0, 3, 1, 4, 2, 5] if name == "CTRIAX6" else range(6)
    lines = ["SOL 101", "CEND", "BEGIN BULK", "PSHELL,7,1,0.01", "MAT1,1,2.1+11,,0.3"]
    lines += [f"GRID,{k + 1},,{x:.10g},{y:.10g},0.0" for k, (x, y, _) in enumerate(POINTS.tolist())]
    for k, row in enumerate(SIX.tolist()):
        nodes = [str(row[j] + 1) for j in order]
        lines += [f"{name},{k + 1},7," + ",".join(nodes)]
    path.write_text("\n".join([*lines, "ENDDATA"]) + "\n")
    return path


def exodus(path):
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(str(path), "w", format="NETCDF3_64BIT_OFFSET") as data:
        for name, size in (
            ("num_dim", 2), ("num_nodes", len(POINTS)), ("num_elem", len(SIX)), ("num_el_blk", 1),
            ("num_el_in_blk1", len(SIX)), ("num_nod_per_el1", 6), ("num_side_sets", 1), ("num_side_ss1", 1),
            ("time_step", None), ("num_nod_var", 1), ("len_name", 33),
        ):  # fmt: skip
            data.createDimension(name, size)
        data.createVariable("coordx", "f8", ("num_nodes",))[:] = POINTS[:, 0]
        data.createVariable("coordy", "f8", ("num_nodes",))[:] = POINTS[:, 1]
        rows = data.createVariable("connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"))
        rows.elem_type = "TRI6"
        rows[:] = SIX + 1
        data.createVariable("eb_prop1", "i4", ("num_el_blk",))[:] = [5]
        data.createVariable("elem_ss1", "i4", ("num_side_ss1",))[:] = [LOADED]
        data.createVariable("side_ss1", "i4", ("num_side_ss1",))[:] = [SIDE]
        names = data.createVariable("name_nod_var", "S1", ("num_nod_var", "len_name"))
        names[0, 0] = b"T"
        data.createVariable("vals_nod_var1", "f8", ("time_step", "num_nodes"))[0] = POINTS[:, 0]
        data.createVariable("time_whole", "f8", ("time_step",))[0] = 0.0
    return path


def kratos(path):
    lines = ["Begin ModelPartData", "End ModelPartData", "Begin Properties 0", "End Properties", "Begin Nodes"]
    lines += [f"{k + 1} {x!r} {y!r} 0.0" for k, (x, y, _) in enumerate(POINTS.tolist())]
    lines += ["End Nodes", "Begin Elements Element2D6N"]
    lines += [f"{k + 1} 0 " + " ".join(str(n + 1) for n in row) for k, row in enumerate(SIX.tolist())]
    path.write_text("\n".join([*lines, "End Elements"]) + "\n")
    return path


def triangle(path):
    order = [0, 1, 2, 4, 5, 3]  # the nodes stand by the corners that they lie opposite to
    lines = [f"{len(SIX)} 6 0"] + [f"{k + 1} " + " ".join(str(row[j] + 1) for j in order) for k, row in enumerate(SIX)]
    path.write_text("\n".join(lines) + "\n")
    nodes = [f"{len(POINTS)} 2 0 0"] + [f"{k + 1} {x!r} {y!r}" for k, (x, y, _) in enumerate(POINTS.tolist())]
    path.with_suffix(".node").write_text("\n".join(nodes) + "\n")
    return path


def sms(path):
    order = [0, 3, 1, 4, 2, 5]  # corners and mid-side nodes stand in turn
    lines = ["MESH2D"] + [f"E6T {k + 1} " + " ".join(str(r[j] + 1) for j in order) + " 1" for k, r in enumerate(SIX)]
    lines += [f"ND {k + 1} {x!r} {y!r} 0.0" for k, (x, y, _) in enumerate(POINTS.tolist())]
    path.write_text("\n".join(lines) + "\n")
    return path


def comsol(path, order=(0, 1, 2, 3, 5, 4)):
    edges = [(a, b, cm.edges(SIX)[a, b]) for a, b in cm.boundary(SIX)]
    lines = ["# Created by COMSOL.", "", "0 1", "1 # number of tags", "5 mesh1", "1 # number of types", "3 obj", ""]
    lines += ["0 0 1", "4 Mesh # class", "4 # version", "2 # sdim", f"{len(POINTS)} # number of mesh vertices"]
    lines += ["0 # lowest mesh vertex index", "# Mesh vertex coordinates"]
    lines += [f"{x!r} {y!r}" for x, y, _ in POINTS.tolist()] + ["2 # number of element types"]
    for word, rows in (("edg2", edges), ("tri2", [[row[k] for k in order] for row in SIX.tolist()])):
        lines += [f"4 {word} # type name", f"{len(rows[0])} # number of vertices per element", f"{len(rows)} # n"]
        lines += [" ".join(map(str, row)) for row in rows] + [f"{len(rows)} # number of geometric entity indices"]
        lines += ["1"] * len(rows)
    path.write_text("\n".join(lines) + "\n")
    return path


def unv(path):
    order = [0, 3, 1, 4, 2, 5]
    lines = ["    -1", "  2411"]
    for k, point in enumerate(POINTS.tolist()):
        lines += [f"{k + 1:10d}{1:10d}{1:10d}{11:10d}", "".join(f"{x:25.16E}" for x in point)]
    lines += ["    -1", "    -1", "  2412"]
    for k, row in enumerate(SIX.tolist()):
        lines += ["".join(f"{v:10d}" for v in (k + 1, 92, 1, 1, 7, 6)), "".join(f"{row[j] + 1:10d}" for j in order)]
    path.write_text("\n".join([*lines, "    -1"]) + "\n")
    return path


def by_meshio(path):
    field = {"T": POINTS[:, 0].copy()} if path.suffix in (".med", ".msh", ".xdmf", ".vtk") else {}
    form = {".msh": {"file_format": "gmsh"}}.get(path.suffix, {})
    meshio.Mesh(POINTS, [("triangle6", SIX)], point_data=field).write(path, **form)
    return path


WRITERS = {
    "ring.inp": abaqus,
    "strain.inp": lambda path: abaqus(path, "CAX6"),
    "ring.bdf": nastran,
    "axis.bdf": lambda path: nastran(path, "CTRIAX6"),
    "ring.e": exodus,
    "ring.mdpa": kratos,
    "ring.ele": triangle,
    "ring.2dm": sms,
    "ring.mphtxt": comsol,
    "other.mphtxt": lambda path: comsol(path, range(6)),
    "ring.unv": unv,
    "ring.med": by_meshio,
    "ring.msh": by_meshio,
    "ring.xdmf": by_meshio,
    "ring.vtk": by_meshio,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_dialect_gets_its_six_nodes_back(tmp_path, name):
    path = WRITERS[name](tmp_path / name)
    before = load(path).mesh
    assert [b.type for b in before.cells if b.type != "line3"] == ["triangle6"]
    assert (before.cells[-1].data == SIX).all()
    (done,) = improve_series([open_mesh(path)], tm.ImproveOptions())
    out = tmp_path / f"out{path.suffix}"
    done.write(out)
    after = load(out).mesh
    assert [b.type for b in after.cells] == [b.type for b in before.cells]
    six = after.cells[-1].data
    assert (cm.jacobians(after.points, six).min(1) > 0).all()
    assert done.curved.inverted == 0
    nodes, old = cm.edges(six), cm.edges(SIX)
    assert set(nodes.values()) == set(old.values())
    for edge in cm.boundary(SIX):
        assert nodes[edge] == old[edge]
        assert (after.points[nodes[edge]] == before.points[old[edge]]).all()
    if "T" in after.point_data:
        # T is x: quadratic functions carry it exactly, but where the mesh came tangled.
        assert np.median(np.abs(after.point_data["T"] - after.points[:, 0])) < 1e-12


@pytest.mark.parametrize("name", ["ring.inp", "strain.inp", "ring.bdf", "axis.bdf", "ring.mdpa", "ring.mphtxt"])
def test_only_nodes_and_elements_of_a_deck_change(tmp_path, name):
    path = WRITERS[name](tmp_path / name)
    (done,) = improve_series([open_mesh(path)], tm.ImproveOptions())
    done.write(tmp_path / f"out{path.suffix}")
    was, now = path.read_text().splitlines(), (tmp_path / f"out{path.suffix}").read_text().splitlines()
    assert len(was) == len(now)
    changed = [k for k, (a, b) in enumerate(zip(was, now, strict=True)) if a != b]
    assert changed
    nodes = next(k for k, line in enumerate(was) if line.startswith(("*NODE", "GRID", "Begin Nodes", "# Mesh vertex")))
    last = max(
        k for k, line in enumerate(was) if line.startswith(("*SOLID", "ENDDATA", "End Elements", "48 # number of geo"))
    )
    # The load on a side goes to the element that has the side now.
    assert all(nodes <= k < last or "P" in was[k] for k in changed)


def test_a_new_node_order_of_axisymmetric_triangles_is_read_and_kept(tmp_path):
    path = nastran(tmp_path / "axis.bdf", "CTRIAX6")
    assert (load(path).mesh.cells[0].data == SIX).all()
    mesh = tm.read(path)
    tm.write(tmp_path / "out.bdf", mesh.with_points(mesh.points), like=path)
    assert "CTRIAX6" in (tmp_path / "out.bdf").read_text()
    assert cm.edges(load(tmp_path / "out.bdf").mesh.cells[0].data) == cm.edges(SIX)
