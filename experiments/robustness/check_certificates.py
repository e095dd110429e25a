"""Is it proved that these meshes cannot be valid?  Certificates are checked with whole numbers and fractions alone.

    python -m experiments.robustness.check_certificates FILE ...
    python experiments/robustness/check_certificates.py FILE ...    (without torchmesh)

A file holds one JSON object a line (or one in all), as torchmesh writes them: points, triangles, fixed vertices and
certificates.  Reports of `torchmesh improve --report` are read, too.  This program, with experiments/shared/certified,
imports nothing of torchmesh; it reads JSON and computes with fractions.  Its claim is: with these triangles and fixed
vertices no positions of the other vertices make all triangles turn to the left.

What it relies on.  Upright triangles cover each point as often as the boundary goes round it to the left (the degree of
a map).  So if the boundary consists of loops of fixed vertices that meet neither themselves nor each other, one of
which turns to the left and all others to the right, a valid mesh covers its domain once, its edges lie inside, meet
in common ends only, and touch the boundary in their ends only.  Validity is an open condition, so free vertices may be
taken to lie on no line that is spoken of here.

The exit status is 0 if each mesh has a certificate and all certificates hold.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

if not __package__:  # run by its path: what it is made of is found from the root
    sys.path.insert(0, str(Path(__file__).parents[2]))

from experiments.shared.certified import places, reasons
from experiments.shared.certified.mesh import Mesh, Wrong

KINDS = {
    "fixed triangle": reasons.fixed_triangle,
    "empty kernel": reasons.empty_kernel,
    "edges meet": reasons.edges_meet,
    "vertex outside": reasons.vertex_outside,
    "point outside": reasons.point_outside,
    "turns": reasons.turns,
    "handles": reasons.handles,
    "no place": places.no_place,
}


def check(data: dict) -> list[str]:
    """What is wrong with the certificates of a mesh; an empty list: it is proved that the mesh cannot be valid."""
    if not data["certificates"]:
        return ["there is no certificate"]
    try:
        mesh = Mesh(data)
    except Wrong as wrong:
        return [str(wrong)]
    wrongs = []
    for given in data["certificates"]:
        try:
            KINDS[given["kind"]](mesh, given)
        except (Wrong, KeyError) as wrong:
            wrongs.append(f"{given.get('kind')}: {wrong}")
    return wrongs


def _objects(path: Path) -> Iterator[dict]:
    """The meshes of a file with their certificates."""
    text = path.read_text()
    try:
        whole = [json.loads(text)]
    except ValueError:
        whole = [json.loads(line) for line in filter(str.strip, text.splitlines())]
    for data in whole:
        # A report has meshes that were proved impossible, or none.
        yield from [data] if "certificates" in data else data.get("proofs", [{"certificates": []}])


def main(paths: list[str] | None = None) -> int:
    paths = sys.argv[1:] if paths is None else paths
    if not paths or {"-h", "--help"} & set(paths):
        print(__doc__)
        sys.exit(0 if paths else 2)
    failed = 0
    for path in paths:
        for number, data in enumerate(_objects(Path(path)), 1):
            name = data.get("case", f"{path}, object {number}")
            wrongs = check(data)
            failed += bool(wrongs)
            kinds = ", ".join(dict.fromkeys(given["kind"] for given in data["certificates"]))
            print(f"{name}: {'; '.join(wrongs) if wrongs else 'proved: ' + kinds}")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
