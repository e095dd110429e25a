"""`torchmesh generate`."""

import pytest
import torch

import torchmesh as tm
from torchmesh.commands.main import main


def test_one_file_holds_the_stream(tmp_path, capsys):
    out = tmp_path / "meshes.h5"
    arguments = ["generate", str(out), "--count", "10", "--family", "gate", "--family", "bar"]
    assert main([*arguments, "--triangles", "200", "--seed", "4", "--motions", "3"]) == 0
    expected = tm.domains.generate(10, ["gate", "bar"], triangles=200, seed=4, motions=3)
    batch = tm.load_batch(out)
    points, records = tm.load_fields(out)
    assert torch.equal(batch.points, expected.deformed.points)
    assert torch.equal(batch.triangles, expected.deformed.triangles)
    assert torch.equal(points["undeformed"], expected.undeformed.points)
    assert records["family"] == list(expected.families)
    assert torch.equal(records["inverted"], expected.inverted)
    tangled = int((expected.inverted > 0).sum())
    assert f"10 meshes in {out}" in capsys.readouterr().err.replace("\n", "") or tangled


def test_a_folder_gets_mesh_files(tmp_path):
    out = tmp_path / "folder"
    arguments = ["generate", str(out), "--count", "2", "--family", "onto", "--triangles", "200"]
    assert main([*arguments, "--format", "vtu", "-q"]) == 0
    assert sorted(p.name for p in out.iterdir()) == ["000000-onto.vtu", "000001-onto.vtu"]
    expected = tm.domains.generate(2, ["onto"], triangles=200).deformed.split()[1]
    assert torch.equal(tm.read(out / "000001-onto.vtu").points, expected.points)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["x", "--count", "3"], "ends in .h5"),
        (["x.h5", "--count", "3", "--format", "vtu"], "into a folder"),
        (["x.h5", "--count", "3", "--family", "cube"], "cube"),
        (["x.h5", "--count", "0"], "--count"),
        (["nowhere/x.h5", "--count", "3"], "nowhere"),
    ],
)
def test_what_cannot_be_made_is_told_and_leaves_nothing(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert main(["generate", *arguments]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert list(tmp_path.iterdir()) == []
