"""Where the weights of the benchmark's network are: in a checkout, and in no installed package."""

import os
from pathlib import Path

from .answers import Missing

# The environment variable, set by the option --weights, that names another file.
VARIABLE = "TORCHMESH_BENCH_WEIGHTS"

# Where a checkout has them; experiments/learning/train_mover.py makes them.
CHECKOUT = Path(__file__).parents[2] / "experiments" / "learning" / "weights" / "mover.pt"


def weights_file() -> Path:
    """The file of the weights.  Raises Missing if there is none."""
    path = Path(os.environ.get(VARIABLE) or CHECKOUT)
    if not path.is_file():
        raise Missing(
            f"{path}: the weights of the network are not there; they are in a checkout of the repository, "
            "experiments/learning/weights/mover.pt: name the file by --weights"
        )
    return path
