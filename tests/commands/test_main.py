"""The command line as a whole: bad input and usage, help, and what it imports."""

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import Outcome, is_one_clear_line, names, process

from torchmesh.commands import main as cli
from torchmesh.kernels.library import kernels_in_use

# --- bad input and usage -----------------------------------------------------------------------------

TO = ["improve", "tangled.vtu"]
WARP = ["warp", "plate.vtu", "out.vtu"]
BAD = {
    "missing file": (["improve", "missing.vtu", "out.vtu"], "missing.vtu: there is no such file"),
    "a directory": (["improve", "folder.vtu", "out.vtu"], "folder.vtu: is a directory"),
    "empty file": (["improve", "empty.vtu", "out.vtu"], "empty.vtu: the file is empty"),
    "unknown extension": (["improve", "unknown.foo", "out.vtu"], "'.foo' is not known"),
    "truncated": (["improve", "broken.vtu", "out.vtu"], "broken.vtu: cannot be read"),
    "not a number": (["improve", "nan.vtk", "out.vtu"], "points row 5 is"),
    "no triangles": (["improve", "lines.vtu", "out.vtu"], "lines.vtu: no triangles"),
    "no output directory": ([*TO, "nowhere/out.vtu"], "does not exist"),
    "unknown output extension": ([*TO, "out.foo"], "'.foo' is not known"),
    "output is a directory": ([*TO, "folder.vtu"], "folder.vtu: is a directory"),
    "unknown picture": ([*TO, "out.vtu", "--plot", "p.bmp"], "p.bmp: the extension '.bmp' is no picture's"),
    "no picture directory": ([*TO, "out.vtu", "--plot", "nowhere/p.png"], "does not exist"),
    "no report directory": ([*TO, "out.vtu", "--report", "nowhere/r.json"], "does not exist"),
    "report is a directory": ([*TO, "out.vtu", "--report", "folder.vtu"], "is a directory"),
    "one file for two": ([*TO, "out.vtu", "--report", "./out.vtu"], "named twice"),
    "report over input": ([*TO, "out.vtu", "--report", "tangled.vtu"], "named twice"),
    "beta of the default": ([*TO, "out.vtu", "--beta", "1"], "--beta needs --method paper"),
    "negative beta": ([*TO, "out.vtu", "--method", "paper", "--beta", "-1"], "must not be negative"),
    "infinite beta": ([*TO, "out.vtu", "--method", "paper", "--beta", "inf"], "finite"),
    "beta a word": ([*TO, "out.vtu", "--method", "paper", "--beta", "small"], "--beta"),
    "unknown method": ([*TO, "out.vtu", "--method", "best"], "--method"),
    "no threads": ([*TO, "out.vtu", "--threads", "0"], "--threads"),
    "no output": (TO, "OUT"),
    "no file": (["quality"], "FILE"),
    "quality of a missing file": (["quality", "missing.vtu"], "missing.vtu: there is no such file"),
    "unknown command": (["untangle"], "untangle"),
    "unknown option": ([*TO, "out.vtu", "--fast"], "--fast"),
    "nothing to move": (WARP, "nothing to move"),
    "nowhere to write": (["warp", "plate.vtu", "--move", "hole:1:1,0"], "Missing argument 'OUT'"),
    "list and more": ([*WARP, "--list"], "--list goes with IN alone"),
    "no such hole": ([*WARP, "--move", "hole:2:1,0"], "there is no hole:2, only outer:1, hole:1"),
    "no such part": (
        [*WARP, "--move", "slot:1,0"],
        "there is no slot, only outer:1, hole:1 (--list",
    ),
    "hole without number": ([*WARP, "--move", "hole:1,0"], "there is no hole, only outer:1, hole:1"),
    "one number": ([*WARP, "--move", "hole:1:1"], "'1' is not 2 numbers"),
    "infinitely far": ([*WARP, "--move", "hole:1:inf,0"], "'inf,0' is not 2 numbers"),
    "empty box": ([*WARP, "--move", "5,5,6,6:1,0"], "no boundary vertex"),
    "box inside the mesh": ([*WARP, "--move", "0.05,0.05,0.15,0.15:1,0"], "no boundary vertex"),
    "no angle": ([*WARP, "--rotate", "hole:1"], "expected hole:N:DEG"),
    "angle a word": ([*WARP, "--rotate", "hole:1:left"], "'left' is not a number"),
    "no such field": ([*WARP, "--displacement", "w"], "it has 'displacement', 'u'"),
    "a field of numbers": ([*WARP, "--displacement", "u"], "not a vector"),
    "warp of a tangled mesh": (["warp", "tangled.vtu", "out.vtu", "--move", "hole:1:1,0"], "tangled.vtu: mesh 0"),
    "output a folder, improve": ([*TO, "."], ".: is a directory"),
    "output a folder, warp": (["warp", "plate.vtu", ".", "--move", "hole:1:1,0"], ".: is a directory"),
    "output a folder, clean": (["clean", "plate.vtu", "."], ".: is a directory"),
    "output a folder, the root": (["clean", "plate.vtu", "/"], "/: is a directory"),
    "reproduce into a file": (["reproduce", "--out", "unknown.foo"], "unknown.foo: cannot be made a directory"),
}


@pytest.mark.parametrize(("arguments", "text"), BAD.values(), ids=BAD)
def test_bad_input_is_one_clear_line_and_no_file(call, folder, arguments, text):
    before = names(folder)
    done = call(*arguments)
    assert is_one_clear_line(done, text), done
    assert names(folder) == before


@pytest.mark.parametrize("case", [case for case in BAD if "output" in case or "picture" in case or "report" in case])
def test_files_to_write_are_checked_before_the_work(call, monkeypatch, case):
    monkeypatch.setattr("torchmesh.batches.file_improvement.open_mesh", lambda *_: pytest.fail("the work began"))
    arguments, text = BAD[case]
    assert is_one_clear_line(call(*arguments), text)


@pytest.mark.parametrize("case", ["not a number", "unknown method"])
def test_bad_input_as_a_process(folder, case):
    arguments, text = BAD[case]
    before = names(folder)
    done = process(*arguments, folder=folder)
    assert is_one_clear_line(done, text), done
    assert done.out == ""
    assert names(folder) == before


def test_a_folder_that_refuses_writing(call, folder, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    before = names(folder)
    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    done = call("improve", "tangled.vtu", "out.vtu")
    assert is_one_clear_line(done, "out.vtu: cannot be written: Permission denied")
    assert names(folder) == before


def test_an_unforeseen_error_is_not_hidden(call, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("torchmesh.files.mesh_files.Source.open", fail)
    with pytest.raises(ZeroDivisionError):
        call("quality", "better.vtu")


# --- help --------------------------------------------------------------------------------------------


def test_version_and_help_as_a_process(folder):
    from importlib.metadata import version

    assert process("--version", folder=folder) == Outcome(
        0, f"torchmesh {version('torchmesh-untangle')}, {kernels_in_use()} kernels\n", ""
    )
    done = process("--help", folder=folder)
    assert (done.status, done.err) == (0, "")
    for command in ("improve", "quality", "warp", "reproduce"):
        assert command in done.out


def test_no_arguments_is_a_request_for_help(call):
    done = call()
    assert done.status == 2
    assert "Usage: torchmesh" in done.out


COMMANDS = {command.callback.__name__: command for command in cli.app.registered_commands} | {
    f"bench {command.name or command.callback.__name__}": command for command in cli.benchmark.registered_commands
}
EXAMPLES = [
    example
    for command in COMMANDS.values()
    for example in (command.epilog or "").split("\n\n")[1:]
    if not example.startswith("torchmesh reproduce")  # test_reproduce runs them
]


def test_every_command_has_examples_in_its_help(call):
    assert len(EXAMPLES) >= 12
    for name in COMMANDS:
        done = call(*name.split(), "--help")
        assert done.status == 0
        assert "Examples:" in done.out
        assert f"torchmesh {name}" in done.out


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_examples_of_the_help_run(call, example, request):
    program, *arguments = shlex.split(example)
    assert program == "torchmesh"
    if "--workers" not in arguments:  # where a number of them is asked for, worker processes run
        request.getfixturevalue("inline")
    if "--count" in arguments:  # a few are as good a test
        arguments[arguments.index("--count") + 1] = "3"
    done = call(*arguments)
    tangled = arguments[0] in ("quality", "info") and {"tangled.vtu", "run.xdmf"} & {*arguments}
    assert done.status == (1 if tangled else 0), done


def test_nothing_heavy_is_imported_by_the_command_line_itself():
    """So that --help does not wait for torch."""
    heavy = ("torch", "numpy", "scipy", "meshio", "matplotlib")
    code = f"import sys, torchmesh.commands.main; print(*(m for m in {heavy!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, [], "")


# --- odd surroundings --------------------------------------------------------------------------------


def shell(line: str, folder: Path) -> subprocess.CompletedProcess:
    """The outcome of a line of shell in which $T is the program."""
    line = line.replace("$T", f"{shlex.quote(sys.executable)} -m torchmesh")
    return subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, text=True, timeout=120)


posix = pytest.mark.skipif(os.name == "nt", reason="a POSIX shell")


@posix
@pytest.mark.parametrize("closed", [">&- 2>&-", "<&- >&-"])
def test_closed_streams_do_not_matter(folder, closed):
    """Output is closed in both: then a file that is opened gets its number."""
    done = shell(f"$T improve tangled.vtu out.vtu {closed}", folder)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert (folder / "out.vtu").exists()


@posix
def test_a_reader_that_has_gone_is_no_error(call, folder, monkeypatch):
    done = shell("$T --help | true; exit ${PIPESTATUS[0]}", folder)
    assert (done.returncode, done.stderr) == (141, "")
    reading, writing = os.pipe()
    os.close(reading)
    # Python ignores the signal, but a library that an earlier test has loaded may have given it back its deadly rule.
    before = signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    try:
        with os.fdopen(writing, "w") as unread:
            monkeypatch.setattr(sys, "stdout", unread)
            assert call("quality", "better.vtu") == Outcome(141, "", "")
    finally:
        signal.signal(signal.SIGPIPE, before)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_under_standard_output_is_one_clear_line(call, folder, monkeypatch):
    expected = "error: standard output cannot be written: No space left on device\n"
    done = shell("$T --help > /dev/full", folder)
    assert (done.returncode, done.stderr) == (2, expected)
    for more in ([], ["--json"]):
        with open("/dev/full", "w") as full:
            monkeypatch.setattr(sys, "stdout", full)
            assert call("quality", "better.vtu", *more) == Outcome(2, "", expected)


@posix
def test_names_that_are_not_utf8(call, folder, monkeypatch):
    name = os.fsdecode(b"x\xff.vtu")
    shutil.copy(folder / "tangled.vtu", folder / name)
    assert call("improve", name, "out.vtu", "--plot", "p.png", "--report", "r.json").status == 0
    assert json.loads((folder / "r.json").read_text())["input"] == name
    assert call("report", name, "out.vtu", "page.html", "--no-stages").status == 0
    assert r"x\xff.vtu: before and after" in (folder / "page.html").read_text(encoding="utf-8")
    with open(folder / "said", "w", encoding="utf-8") as out:
        monkeypatch.setattr(sys, "stdout", out)
        done = call("quality", name, "y*.vtu", "--worst", "0")
    assert done.status == 2
    assert "udcff.vtu" in (folder / "said").read_text(encoding="utf-8")
    assert done.err.count("\n") == 1
