"""Programs for a fresh process, each of which prints what it measured as JSON."""

from __future__ import annotations

# Its argument is the file of a case.  torch is loaded before the clock starts, and torchmesh after.
FIRST_CALL = """
import json, sys, time
import numpy as np, torch
torch.set_num_threads(1)
data = np.load(sys.argv[1])
assert "torchmesh" not in sys.modules
wall, cpu = time.perf_counter(), time.process_time()
import torchmesh as tm
load = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
from torchmesh.bench.stopwatch import Stopwatch
with Stopwatch() as first:
    mesh, report = tm.improve(tm.MeshBatch.from_arrays(data["tangled"], data["triangles"]))
with Stopwatch() as second:
    tm.improve(tm.MeshBatch.from_arrays(data["tangled"], data["triangles"]))
q = report.quality
print(json.dumps({name: vars(value) for name, value in
    {"first": first.seconds, "second": second.seconds}.items()}
    | {"load": load, "valid": bool(report.valid), "inverted": int(q.inverted), "mean": float(q.mean),
       "max": float(q.max)}))
"""

# Its argument is the file of a case; peak memory is in GiB.  Where Linux tells it, it is that of this program alone:
# ru_maxrss begins with what the process held that started it.
GROWTH = """
import json, pathlib, re, resource, sys
import numpy as np, torch
torch.set_num_threads(1)
def peak():
    status = pathlib.Path("/proc/self/status")
    own = re.search(r"VmHWM:\\s+(\\d+)", status.read_text()) if status.exists() else None
    return int(own[1]) if own else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
import torchmesh as tm
from torchmesh.bench.stopwatch import Stopwatch
data = np.load(sys.argv[1])
mesh = tm.MeshBatch.from_arrays(data["points"], data["triangles"]).with_points(torch.from_numpy(data["tangled"]))
loaded = peak()
with Stopwatch() as watch:
    mesh, report = tm.improve(mesh)
q = report.quality
print(json.dumps(vars(watch.seconds) | {
    "triangles": len(mesh.triangles), "loaded": loaded / 2**20,
    "peak": peak() / 2**20,
    "inverted": int(q.inverted), "mean": float(q.mean), "max": float(q.max),
    "stages": [[step.stage, round(step.seconds, 3), step.iterations, step.inverted] for step in report.steps[0]]}))
"""
