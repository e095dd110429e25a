"""All experiments under one command: by name, with what each asks.

python -m experiments                        (lists them)
python -m experiments NAME --help            (NAME as channel, or simulation.channel)
python -m experiments NAME [OPTIONS]
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).parent


def scripts() -> dict[str, Path]:
    """The files of all scripts, by their names without `experiments.`."""
    found = {}
    for path in sorted(FOLDER.rglob("*.py")):
        name = ".".join(path.relative_to(FOLDER).with_suffix("").parts).removesuffix(".__main__")
        if name != "__main__" and '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            found[name] = path
    return found


def question(path: Path) -> str:
    """The first line of a script's docstring."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]


def chosen(name: str) -> str:
    """The script that is meant, by its whole name or the last part of it.  Raises ValueError for none or several."""
    known = scripts()
    name = name.removeprefix("experiments.")
    found = [full for full in known if full == name or full.rpartition(".")[2] == name]
    if len(found) != 1:
        raise ValueError(f"no experiment {name}" if not found else f"{name} may be {' or '.join(found)}")
    return found[0]


def main(argv: Sequence[str] | None = None) -> int:
    given = list(sys.argv[1:] if argv is None else argv)
    if not given or given[0] in ("-h", "--help"):
        print(__doc__)
        for name, path in scripts().items():
            print(f"{name:34} {question(path)}")
        return 0
    try:
        name = chosen(given[0])
    except ValueError as error:
        print(f"error: {error}; python -m experiments lists all", file=sys.stderr)
        return 2
    script = importlib.import_module(f"experiments.{name}")
    if not hasattr(script, "main"):  # a package that is run as one script
        script = importlib.import_module(f"experiments.{name}.__main__")
    return int(script.main(given[1:]) or 0)


if __name__ == "__main__":
    sys.exit(main())
