"""`-` in place of files, results in place of their input, and completion in the shell."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import inverted, is_one_clear_line, names


def through(line: str, folder: Path) -> subprocess.CompletedProcess:
    line = line.replace("$T", f"{sys.executable} -m torchmesh")
    return subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, timeout=120)


posix = pytest.mark.skipif(os.name == "nt", reason="a POSIX shell")


@posix
def test_a_mesh_flows_from_command_to_command(call, folder):
    line = "$T improve - - --format vtu --report r.json < tangled.vtu | $T clean - clean.vtk --format vtu > log"
    done = through(line, folder)
    assert done.returncode == 0
    assert inverted(folder / "clean.vtk") == 0
    assert b"-, " in done.stderr, "the table is on standard error, and calls the file as it was given"
    assert b"standard-output" not in done.stderr
    assert '"output": "-"' in (folder / "r.json").read_text()
    call("improve", "tangled.vtu", "same.vtu")
    flowed = through("$T improve tangled.vtu - --format vtu -q", folder)
    assert flowed.stdout == (folder / "same.vtu").read_bytes()


@posix
def test_formats_of_both_ends_may_differ(folder):
    done = through("$T improve - - --format vtu,msh -q < tangled.vtu", folder)
    assert (done.returncode, done.stdout[:11]) == (0, b"$MeshFormat")


@posix
def test_errors_call_a_pipe_by_its_name_and_nothing_flows(folder):
    done = through("echo nonsense | $T improve - - --format vtu", folder)
    assert (done.returncode, done.stdout) == (2, b"")
    assert done.stderr.startswith(b"error: -: ")
    done = through("$T quality - --format vtu < /dev/null", folder)
    assert (done.returncode, done.stderr) == (2, b"error: -: the file is empty\n")


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
