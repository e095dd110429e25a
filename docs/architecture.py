"""Write the drawing and the table of the folders in architecture.md: python docs/architecture.py.

Both come from ALLOWED in tests/test_architecture.py, which the imports are held to, and from the docstrings of the
folders.  A test fails while the page differs.
"""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
START, END = "<!-- written by docs/architecture.py: {} -->\n", "<!-- end -->\n"
FILES = {
    "errors": "The exceptions and warnings of the package.",
    "status": "How a mesh ended.",
    "__main__": "`python -m torchmesh`.",
}


def allowed() -> dict[str, list[str]]:
    """What each folder may import, from the ground up."""
    tree = ast.parse((ROOT / "tests" / "test_architecture.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "ALLOWED":
            return {name: below.split() for name, below in ast.literal_eval(node.value).items()}
    raise LookupError("tests/test_architecture.py has no ALLOWED")


def drawing(below: dict[str, list[str]]) -> str:
    """The folders floor by floor, the highest first; a folder stands one floor above the highest that it imports."""
    floor: dict[str, int] = {}
    for name, names in below.items():
        floor[name] = 1 + max((floor[other] for other in names), default=0)
    lines = [
        f"{level:>2}   {'   '.join(name for name in floor if floor[name] == level)}"
        for level in range(max(floor.values()), 0, -1)
    ]
    return "```text\n" + "\n".join(lines) + "\n```\n"


def table(below: dict[str, list[str]]) -> str:
    rows = ["| folder | what lives there | may import |", "| --- | --- | --- |"]
    for name, names in below.items():
        path = ROOT / "torchmesh" / name / "__init__.py"
        words = FILES.get(name) or ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).splitlines()[0]
        rows.append(f"| `{name}` | {words} | {' '.join(f'`{other}`' for other in names) or '-'} |")
    return "\n".join(rows) + "\n"


def written(text: str) -> str:
    """The page with both parts as they must be."""
    below = allowed()
    for name, part in (("drawing", drawing(below)), ("table", table(below))):
        start = START.format(name)
        head, rest = text.split(start)
        text = f"{head}{start}{part}{END}{rest.split(END, 1)[1]}"
    return text


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
