"""torchmesh's own ways, and the algorithm of Kim 2017 as printed.  Each runs in one process."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..registry import method

if TYPE_CHECKING:
    from ...mesh.batch import MeshBatch


def _improve(words: str, kind: str = "", **settings: Any) -> "Callable[[MeshBatch], MeshBatch]":
    """`improve` with the options that the class method `kind` of `ImproveOptions` makes; "": its constructor."""

    def run(mesh: "MeshBatch") -> "MeshBatch":
        from ...improving.options import ImproveOptions
        from ...improving.pipeline import improve

        make = getattr(ImproveOptions, kind) if kind else ImproveOptions
        return improve(mesh, make(workers=1, **settings))[0]

    run.__doc__ = words
    return run


method("ours")(_improve("torchmesh, the default: edges flip, vertices keep number and order."))
method("ours-keep")(_improve("torchmesh, topology keep: the triangles stay.", topology="keep"))
method("ours-full")(_improve("torchmesh, topology full: vertices come and go.", topology="full"))
method("ours-fast")(_improve("torchmesh, the fast options.", "fast"))
method("kim2017")(_improve("Kim 2017 as printed.", "paper"))
