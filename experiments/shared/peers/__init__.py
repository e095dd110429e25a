"""Other tools on the same mesh: each a function of (points, triangles, fixed) that gives an `Outcome`.

Only the call of a tool's own optimiser is timed, not the way of the mesh into the tool's data structures; that favours
the peers.  A tool that is not installed raises `Missing`, one that cannot take the mesh `Refused`.  A further peer
is a module here and a line in PEERS.
"""

from __future__ import annotations

from collections.abc import Callable

from experiments.shared.peers.anew import gmsh_anew
from experiments.shared.peers.delaunay import libigl, scipy_delaunay
from torchmesh.bench.answers import Missing, Refused
from torchmesh.bench.methods.foldover_free_maps import foldover_free
from torchmesh.bench.methods.gmsh_winslow import gmsh
from torchmesh.bench.methods.mfem_tmop import mfem, mfem_best
from torchmesh.bench.methods.mouette_winslow import mouette
from torchmesh.bench.methods.outcome import Outcome

PEERS: dict[str, Callable[..., Outcome]] = {
    "gmsh": gmsh,
    "gmsh, meshed anew": gmsh_anew,
    "MFEM TMOP": mfem,
    "mouette": mouette,
    "libigl (flips)": libigl,
    "scipy (Delaunay of the points)": scipy_delaunay,
    "foldover-free maps": foldover_free,
}

__all__ = ["PEERS", "Missing", "Outcome", "Refused", "gmsh", "gmsh_anew", "libigl", "mfem", "mfem_best", "mouette"]
