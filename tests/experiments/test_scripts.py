"""Every script says what it does, stands in the table of experiments/README.md, and is named rightly elsewhere."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "experiments"
SCRIPTS = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")
    for path in FOLDER.rglob("*.py")
    if '__name__ == "__main__"' in path.read_text(encoding="utf-8") and path != FOLDER / "__main__.py"
)
PAGES = [*ROOT.glob("*.md"), *FOLDER.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
NEEDS = {
    "experiments.quality.poisson": "skfem",
    "experiments.simulation.airfoil": "skfem",
    "experiments.simulation.bodies": "skfem",
    "experiments.simulation.channel": "skfem",
    "experiments.simulation.history": "skfem",
}


def test_there_are_scripts_in_every_group():
    groups = {path.parent.name for path in FOLDER.glob("*/__init__.py")} - {"shared"}
    assert {name.split(".")[1] for name in SCRIPTS} == groups == {
        "paper", "quality", "robustness", "speed", "learning", "files", "simulation"
    }  # fmt: skip


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_says_what_it_does(name, capsys):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    script = importlib.import_module(name)
    if not hasattr(script, "main"):  # a package that is run as one script
        script = importlib.import_module(f"{name}.__main__")
    with pytest.raises(SystemExit) as stopped:
        script.main(["--help"])
    assert stopped.value.code == 0
    shown = " ".join(capsys.readouterr().out.split())
    # argparse breaks lines at hyphens.
    assert script.__doc__.split("\n")[0].replace(" ", "") in shown.replace(" ", "")
    assert f"python -m {name}" in script.__doc__


def test_the_table_of_the_readme_has_every_script_once():
    text = (FOLDER / "README.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"^\|[^|]*\| `python -m ([\w.]+)", text, re.MULTILINE)) == SCRIPTS


def test_pages_name_scripts_that_exist():
    named = {
        name for page in PAGES for name in re.findall(r"python -m (experiments\.[a-z_.]*[a-z_])", page.read_text())
    }
    assert len(named) > 8
    assert named <= set(SCRIPTS)
    paths = {
        path
        for page in [*PAGES, *(ROOT / "torchmesh").rglob("*.py")]
        for path in re.findall(r"\bexperiments/[\w/]+\.py", page.read_text(encoding="utf-8"))
    }
    assert paths
    assert [path for path in sorted(paths) if not (ROOT / path).exists()] == []


def test_no_module_of_the_package_imports_an_experiment():
    modules = list((ROOT / "torchmesh").rglob("*.py"))
    assert len(modules) > 50
    for path in modules:
        assert not re.search(r"^\s*(from|import) experiments", path.read_text(encoding="utf-8"), re.MULTILINE), path


def test_scripts_are_short():
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in FOLDER.rglob("*.py")}
    assert len(lengths) > len(SCRIPTS)
    assert [path.name for path, length in lengths.items() if length >= 200] == []


def test_one_command_line_has_them_all(capsys):
    from experiments.__main__ import main

    assert main([]) == 0
    listed = capsys.readouterr().out
    for name in SCRIPTS:
        assert name.removeprefix("experiments.") in listed
    with pytest.raises(SystemExit):
        main(["draw_loop", "--help"])
    assert "--out" in capsys.readouterr().out
    assert main(["no_such_thing"]) == 2
    assert "no experiment no_such_thing" in capsys.readouterr().err


def test_tables_are_kept_as_csv_beside_a_record_of_the_run(tmp_path, capsys):
    import json

    from experiments.quality import travel

    assert travel.main(["--count", "2", "--vertices", "80", "--csv", str(tmp_path / "kept")]) == 0
    shown = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    rows = (tmp_path / "kept" / "travel.csv").read_text().splitlines()
    assert len(rows) == len(shown) > 2
    assert rows[0].split(",")[0] == shown[0].split("|")[1].strip()
    record = json.loads((tmp_path / "kept" / "travel.run.json").read_text())
    assert record["experiment"] == "travel"
    assert record["options"]["count"] == 2
    assert record["seed"] == "fixed in the script"
    assert record["versions"]["torch"]
    assert record["processor"]
    assert record["time"]


def test_every_table_of_a_run_has_a_file_of_plain_numbers(tmp_path):
    from experiments.shared import tables

    tables.keep(tmp_path, "some", {"seed": 1})
    tables.table(["name", "count"], [["**a**", "2,145"], ["b, c", "-1,234.5"], ["`d`", "1,2"]])
    tables.head(["x"])
    tables.line(["1.5"])
    assert (tmp_path / "some.csv").read_text().splitlines() == ["name,count", "a,2145", '"b, c",-1234.5', 'd,"1,2"']
    assert (tmp_path / "some-2.csv").read_text().splitlines() == ["x", "1.5"]


def test_results_say_where_they_come_from(tmp_path):
    import json

    from experiments.shared import arguments

    options = arguments.parser("A script.")
    arguments.add_out(options, "some")
    given = arguments.parse(options, ["--out", str(tmp_path)])
    arguments.write_rows(given, "numbers", [{"a": 1, "b": "x"}, {"a": 2, "b": None}])
    assert (tmp_path / "numbers.csv").read_text().splitlines() == ["a,b", "1,x", "2,"]
    record = json.loads((tmp_path / "numbers.run.json").read_text())
    assert record["options"]["out"] == str(tmp_path)
    assert record["versions"]["torch"]
    assert record["processor"]
