"""`-` in place of files, results in place of their input, and completion in the shell."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Outcome, inverted, is_one_clear_line, names


def through(line: str, folder: Path) -> subprocess.CompletedProcess:
    line = line.replace("$T", f"{sys.executable} -m torchmesh")
    return subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, timeout=120)


posix = pytest.mark.skipif(os.name == "nt", reason="a POSIX shell")


@posix
def test_a_mesh_flows_from_command_to_command(call, folder):
    """What flows is what would be written; the formats of both ends may differ."""
    improve = "$T improve - - --format vtu --report r.json < tangled.vtu"
    done = through(f"set -o pipefail; {improve} | tee flowed | $T clean - - --format vtu,msh 2> log", folder)
    assert (done.returncode, done.stdout[:11]) == (0, b"$MeshFormat")
    (folder / "clean.msh").write_bytes(done.stdout)
    assert inverted(folder / "clean.msh") == 0
    assert b"-, " in done.stderr, "the table is on standard error, and calls the file as it was given"
    assert b"standard-output" not in done.stderr
    assert '"output": "-"' in (folder / "r.json").read_text()
    call("improve", "tangled.vtu", "same.vtu")
    assert (folder / "flowed").read_bytes() == (folder / "same.vtu").read_bytes()


def test_errors_call_a_pipe_by_its_name_and_nothing_flows(call, monkeypatch):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"nonsense\n")))
    done = call("improve", "-", "-", "--format", "vtu")
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("error: -: ")
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"")))
    assert call("quality", "-", "--format", "vtu") == Outcome(2, "", "error: -: the file is empty\n")


def test_a_pipe_needs_a_format_and_a_format_a_pipe(call, folder):
    before = names(folder)
    assert is_one_clear_line(call("improve", "-", "out.vtu"), "- needs --format EXT")
    assert is_one_clear_line(call("improve", "tangled.vtu", "-"), "- needs --format EXT")
    assert is_one_clear_line(call("improve", "tangled.vtu", "-", "--format", "vtu,msh"), "- needs --format EXT")
    assert is_one_clear_line(call("improve", "tangled.vtu", "out.vtu", "--format", "vtu"), "--format goes with -")
    assert is_one_clear_line(call("quality", "-", "-", "--format", "vtu"), "standard input once")
    assert is_one_clear_line(call("improve", "tangled.vtu", "-", "--format", "foo"), "'.foo' is not known")
    assert names(folder) == before


@pytest.mark.parametrize(
    "arguments",
    [["improve", "tangled.vtu"], ["clean", "tangled.vtu"], ["warp", "undeformed.vtu", "--move", "hole:1:0.01,0"]],
)
def test_a_result_takes_the_place_of_its_input_only_if_asked(call, folder, arguments):
    path = folder / arguments[1]
    before = path.read_bytes()
    (folder / "link.vtu").symlink_to(path)
    for target in (arguments[1], f"./{arguments[1]}", "link.vtu"):
        assert is_one_clear_line(call(*arguments, target), "add --in-place"), target
    assert is_one_clear_line(call(*arguments), "Missing argument 'OUT'")
    assert path.read_bytes() == before
    assert call(*arguments, "--in-place").status == 0
    if arguments[0] != "clean":  # which has nothing to mend there
        assert path.read_bytes() != before


@posix
def test_the_shell_completes_commands_and_options(folder):
    done = through("_TORCHMESH_COMPLETE=complete_bash COMP_WORDS='torchmesh im' COMP_CWORD=1 $T", folder)
    assert done.stdout.split() == [b"improve"]
    done = through("_TORCHMESH_COMPLETE=complete_bash COMP_WORDS='torchmesh improve --to' COMP_CWORD=2 $T", folder)
    assert done.stdout.split() == [b"--topology"]
    done = through("$T --help", folder)
    assert b"--install-completion" in done.stdout
