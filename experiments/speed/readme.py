"""The measured numbers, tables and pictures of the README, all from one run, and a check that says when they are stale.

    python -m experiments.speed.readme            # some minutes on an idle machine, with the extras plot and peers
    python -m experiments.speed.readme --check    # exit status 1 if the code has changed since that run

The run writes the parts of README.md between `<!-- written by experiments/speed/readme.py: NAME -->` and
`<!-- end -->`, docs/moving-bar.png and docs/cost.png, and notes in docs/readme.json the commit, the versions and the
processor.
"""

from __future__ import annotations

import datetime
import hashlib
import io
import json
import re
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.shared import arguments
from torchmesh.bench.provenance import provenance

ROOT = Path(__file__).parents[2]
README, NOTE = ROOT / "README.md", ROOT / "docs" / "readme.json"

# What the numbers depend on.
SOURCES = ("torchmesh/**/*.py", "torchmesh/**/*.cpp", "torchmesh/**/*.hpp", "torchmesh/data/*.vtk")

# The comparison with other tools, as its own script takes it.
COMPARISON = ["--triangles", "2200", "20000", "--batch", "60", "--first-call", "--repeats", "2", "--patience", "8"]


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--check", action="store_true", help="say whether the numbers are of today's code, and end")
    given = arguments.parse(parser, argv)
    if given.check:
        trouble = stale()
        print(trouble or "the README's numbers are of this code")
        return int(bool(trouble))
    note = about_this_run()
    with tempfile.TemporaryDirectory() as name:
        parts = {"run": in_words(note), **reproduction(Path(name)), **comparison(Path(name))}
    text = README.read_text(encoding="utf-8")
    for part, lines in parts.items():
        text = written(text, part, lines)
    README.write_text(text, encoding="utf-8")
    NOTE.write_text(json.dumps(note, indent=1) + "\n", encoding="utf-8")
    return 0


def written(text: str, part: str, lines: str, by: str = "experiments/speed/readme.py") -> str:
    """The page with other lines in one of its parts, `by` a script; raises ValueError if it has no such part."""
    begin = f"<!-- written by {by}: {part} -->\n"
    found = re.compile(re.escape(begin) + r".*?(?=<!-- end -->)", re.DOTALL)
    if not found.search(text):
        raise ValueError(f"the README has no part {part!r}")
    return found.sub(lambda _: begin + lines.rstrip("\n") + "\n", text)


def about_this_run() -> dict[str, Any]:
    """The commit, the day, the versions, the processor, and the digest of the code that is measured."""
    return {**provenance(), "day": datetime.date.today().isoformat(), "code": digest()}


def in_words(note: dict[str, Any]) -> str:
    """The lines of the README on its run."""
    packages = ", ".join(f"{name} {found}" for name, found in note["versions"].items())
    return (
        f"Numbers, tables and pictures are of one run of `python -m experiments.speed.readme` on {note['day']},\n"
        f"commit {note['commit'] or 'unknown'}, {note['processor']},\n{packages}."
    )


def beside_peers(command: str, count: int, limit: float) -> str:
    """The lines above the table beside compiled peers: what ran, and on what."""
    note = about_this_run()
    versions = ", ".join(f"{name} {note['versions'][name]}" for name in ("python", "torchmesh-untangle", "torch"))
    commit = note["commit"] or "unknown"
    return (
        f"With the triangles kept, `{command}` on\n"
        f"{note['day']}, commit {commit}, {note['processor']}, {versions}, {note['kernels']} loops:\n"
        f"{count} maps and turned rings of each size, beside the authors' C++ (g++ -O3). Seconds of processor time on\n"
        f"one thread, at most {limit:g} for a program.\n\n"
    )


def digest() -> str:
    """A hash of all that the numbers depend on."""
    found = hashlib.blake2b(digest_size=16)
    for path in sorted({path for pattern in SOURCES for path in ROOT.glob(pattern)}):
        found.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return found.hexdigest()


def stale() -> str:
    """Why the numbers are not of today's code; empty if they are."""
    if not NOTE.exists():
        return "stale: no run of python -m experiments.speed.readme is noted in docs/readme.json"
    note = json.loads(NOTE.read_text(encoding="utf-8"))
    if in_words(note) not in README.read_text(encoding="utf-8"):
        return "stale: the README does not speak of the run that docs/readme.json notes"
    if note["code"] != digest():
        since = f"{note['day']}, commit {note['commit'] or 'unknown'}"
        return (
            f"stale: the code has changed since the run of {since}; python -m experiments.speed.readme makes them anew"
        )
    return ""


def reproduction(folder: Path) -> dict[str, str]:
    """The table of the paper's experiments; its picture goes to docs."""
    from rich.console import Console

    from torchmesh.commands.paper_experiments import EXPERIMENTS, STAGES, Row, markdown, run_all

    records = run_all(folder / "out", True, Console(file=io.StringIO()))
    rows = {(r["domain"], r["stage"]): Row(**r["ours"]) for r in records}
    lines = markdown([(e, {stage: rows[e.name, stage] for stage in STAGES}) for e in EXPERIMENTS])
    head = ["| | " + " | ".join(f"moving {e.name}" for e in EXPERIMENTS) + " |", "|---" * (1 + len(EXPERIMENTS)) + "|"]
    shutil.copy(folder / "out" / "bar-default.png", ROOT / "docs" / "moving-bar.png")
    return {"reproduction": "\n".join([*head, *lines])}


def comparison(folder: Path) -> dict[str, str]:
    """The table of the comparison with other tools; its plot goes to docs."""
    from experiments.speed import compare

    compare.main([*COMPARISON, "--out", str(folder / "compare")])
    _, table = (folder / "compare" / "compare.md").read_text(encoding="utf-8").split("\n\n", 1)
    shutil.copy(folder / "compare" / "compare.png", ROOT / "docs" / "cost.png")
    return {"comparison": table}


if __name__ == "__main__":
    sys.exit(main())
