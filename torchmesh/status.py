"""Why something ended, one word a mesh."""

import enum


class Status(enum.IntEnum):
    """Why work on a mesh ended; `message` says it in a sentence."""

    RUNNING = 0
    CONVERGED = 1
    SETTLED = 2
    VALID = 3
    STALLED = 4
    ITERATION_LIMIT = 5
    INVERTED = 6
    NOT_FINITE = 7
    INFEASIBLE = 8
    FAILED = 9
    PARTLY = 10

    @property
    def message(self) -> str:
        return _MESSAGES[self]


_MESSAGES = {
    Status.RUNNING: "still running",
    Status.CONVERGED: "converged: the gradient is below its tolerance",
    Status.SETTLED: "settled: the energy, or the quality, no longer changes",
    Status.VALID: "valid: every triangle is upright",
    Status.STALLED: "stalled: no further step lowers the energy or the number of inverted triangles",
    Status.ITERATION_LIMIT: "stopped at the limit of iterations; raise it to go on",
    Status.INVERTED: "refused: the mesh has inverted triangles; untangle it first",
    Status.NOT_FINITE: "refused: a position, or the energy of the start, is not a finite number to compute with",
    Status.PARTLY: "partly mended: what can be mended is, the rest is named",
    Status.INFEASIBLE: "impossible: the boundary or the constraints admit no valid mesh",
    Status.FAILED: "an error inside a stage; the mesh is as the other stages left it",
}
