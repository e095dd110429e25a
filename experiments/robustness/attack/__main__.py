"""What torchmesh must bear, tried at random until the minutes are over.

    python -m experiments.robustness.attack files --minutes 5 --seed 0
    python -m experiments.robustness.attack files --only vtu,off --start 1200
    python -m experiments.robustness.attack meshes --minutes 5 --seed 0
    python -m experiments.robustness.attack signals --minutes 5 --seed 0

    files    mutated files of every format: each is read, or refused in one line, and soon
    meshes   hard domains, vertices anywhere, boundaries at fault: each is mended, or told truly, and soon
    signals  commands that are interrupted at any moment: one line, nothing half-written, batches go on where they were

A trial is a function of the part, the seed, its kind and its number, so that what fails can be made again with --only
and --start.  Prints each fault, then how much was tried; the exit status is 1 if there was a fault.
"""

import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing

from experiments.robustness.attack import files, meshes, signals
from experiments.shared import arguments

# The trials of a part: a function of the seed, the kinds of trials (None: all) and the number of the first, which
# gives the kind and number of a trial and its fault, or "", one after the other without end.
PARTS: dict[str, Callable[[int, list[str] | None, int], Iterator[tuple[str, str]]]] = {
    "files": files.trials,
    "meshes": meshes.trials,
    "signals": signals.trials,
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("part", choices=PARTS, help="what is attacked")
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", help="kinds of trials, with commas between; otherwise all")
    parser.add_argument("--start", type=int, default=0, help="number of the first trial of each kind")
    given = arguments.parse(parser, argv)
    end, tried, failed = time.monotonic() + 60 * given.minutes, Counter[str](), 0
    with closing(PARTS[given.part](given.seed, given.only and given.only.split(","), given.start)) as trials:
        for name, fault in trials:
            tried[re.split(r" \d", name)[0]] += 1
            if fault:
                failed += 1
                print(f"{given.part}, seed {given.seed}, {name}: {fault}", flush=True)
            if time.monotonic() > end:
                break
    print("; ".join(f"{kind}: {count:,}" for kind, count in tried.items()))
    print(f"{tried.total():,} trials of {given.part}, seed {given.seed}: {failed} faults")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
