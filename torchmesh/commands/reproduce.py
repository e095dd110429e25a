"""`torchmesh reproduce`: the three experiments of Kim 2017, our numbers beside the paper's.

Nothing here imports torch before it is needed.
"""

from pathlib import Path
from typing import Annotated

import typer

from . import console
from .shared_options import ThreadsOption, use_threads

EXAMPLES = ("torchmesh reproduce", "torchmesh reproduce --out results --no-plots")


def reproduce(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for tables, meshes and pictures.")] = Path("out"),
    plots: Annotated[bool, typer.Option(help="Draw the paper's figures 4 to 18; needs matplotlib.")] = True,
    threads: ThreadsOption = 1,
) -> int:
    """Run the three experiments of Kim 2017 and print our rows beside the paper's.

    Moving circle, moving bar and moving gate: undeformed, deformed, after the first edge flip, untangled, final; the
    paper's ablation without flips; and the default method. Less than a minute.
    """
    use_threads(threads)
    from .paper_experiments import run_all

    records = run_all(out, plots, console.stdout())
    failed = [r for r in records if r["stage"] in ("final", "default") and r["ours"]["inverted"]]
    for record in failed:
        console.say(f"not valid: {record['domain']}, {record['stage']}: {record['ours']['inverted']} inverted")
    return int(bool(failed))
