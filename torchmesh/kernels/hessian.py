"""Linear systems with the Hessians of meshes, compiled: the twin of `optimising.conjugate_gradients.solve` for them."""

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from .block_factors import BlockFactors, handles
from .library import ADDRESS, INT32, INT64, call, pointer, threads

# A call of the library comes back after about so many triangles, so that Python sees interrupts.
_TRIANGLES = 20_000


class _Systems(ctypes.Structure):
    """`SystemsArgument` of source/hessian.cpp."""

    _fields_ = [
        ("rows", ADDRESS), ("edges", ADDRESS), ("slopes", ADDRESS), ("curvatures", ADDRESS),
        ("target", ADDRESS * 4), ("target_stride", INT64 * 4), ("count", INT64),
        ("triangle_offsets", ADDRESS), ("offsets", ADDRESS), ("systems", INT64),
        ("diagonal", ADDRESS), ("right", ADDRESS), ("tolerance", ADDRESS), ("max_iterations", INT64),
        ("x", ADDRESS), ("iterations", ADDRESS), ("converged", ADDRESS),
        ("orders", ADDRESS), ("factors", ADDRESS),
    ]  # fmt: skip


def solved(
    triangles: Sequence[Tensor],
    target: Sequence[Tensor | float],
    triangle_offsets: Tensor,
    offsets: Tensor,
    diagonal: Tensor,
    right: Tensor,
    tolerance: Tensor | float,
    max_iterations: int,
    factors: BlockFactors | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """x (N,), and per system (B,) the steps taken and whether it converged.

    triangles  rows (6, T), edges (2, 2, T), slopes (2, T) and curvatures (3, T) of `optimising.hessian.Hessian`
    target     its g11, g12, g22 and m, one number or (T,) each
    triangle_offsets, offsets  (B+1,) the triangles and the unknowns of each system
    diagonal, right            (N,)
    tolerance                  a number or (B,)
    factors                    of Hessians nearby, for the preconditioner; None: the diagonal
    """
    systems = len(offsets) - 1
    columns = [torch.as_tensor(v, dtype=torch.float64).contiguous() for v in target]
    whole = [v.contiguous() for v in triangles]
    limits = torch.as_tensor(tolerance, dtype=torch.float64).expand(systems).contiguous()
    rest = [v.contiguous() for v in (triangle_offsets, offsets, diagonal, right)]
    x, iterations = torch.empty_like(rest[3]), torch.empty(systems, dtype=torch.int64)
    converged = torch.empty(systems, dtype=torch.bool)
    argument = _Systems(
        *(pointer(v) for v in whole), (ADDRESS * 4)(*(pointer(v) for v in columns)),
        (INT64 * 4)(*(int(v.dim() > 0) for v in columns)), whole[0].shape[1],
        pointer(rest[0]), pointer(rest[1]), systems, pointer(rest[2]), pointer(rest[3]), pointer(limits),
        max_iterations, pointer(x), pointer(iterations), pointer(converged), *handles(factors),
    )  # fmt: skip
    ends = rest[0].tolist()
    start = 0
    for system in range(1, systems + 1):
        if system == systems or ends[system] - ends[start] >= _TRIANGLES:
            call("tm_hessian_solve", None, ctypes.byref(argument), INT64(start), INT64(system), INT32(threads()))
            start = system
    return x, iterations, converged
