"""Edge splits against the plain way of doing each."""

import pytest
import torch
from editing import VALID, assert_twins, editing, finished
from exact import inverted, triangle_set
from judges import euler

import torchmesh as tm
from torchmesh.remeshing.splits import append, split, splittable, worst_after


@pytest.mark.parametrize("name", list(VALID))
def test_a_split_makes_four_triangles_of_two(name):
    mesh = VALID[name]()
    everything = editing(mesh)
    for h in everything.edges().tolist()[::7]:
        for allow in (False, True):
            e = editing(mesh)
            edge = torch.tensor([h])
            inner = int(e.twin[h]) >= 0 and not bool(e.locked[h])
            assert bool(splittable(e, edge, allow)) == (inner or allow)
            if not bool(splittable(e, edge, allow)):
                continue
            u, w = int(e.vertex[h]), int(e.head(edge))
            before, worst = worst_after(e, edge)
            new, rows = append(e, edge)
            split(e, edge, new, rows)
            assert_twins(e)
            after = finished(mesh, e)
            m = len(mesh.points)
            plain = []
            for row in mesh.triangles.tolist():
                if {u, w} <= set(row):
                    plain += [[m if v == u else v for v in row], [m if v == w else v for v in row]]
                else:
                    plain.append(row)
            assert triangle_set(after.triangles) == triangle_set(plain)
            assert after.points[m].tolist() == pytest.approx((0.5 * (mesh.points[u] + mesh.points[w])).tolist())
            ratio = tm.quality(after).inverse_mean_ratio
            assert float(worst) == pytest.approx(float(ratio[(after.triangles == m).any(1)].max()), rel=1e-12)
            old = tm.quality(mesh).inverse_mean_ratio[((mesh.triangles == u).any(1)) & ((mesh.triangles == w).any(1))]
            assert float(before) == pytest.approx(float(old.max()), rel=1e-12)
            assert bool(after.fixed[m]) == (not inner)
            assert e.births[-1].tolist() == [[m, u, w]]
            assert inverted(after) == 0
            assert euler(after) == euler(mesh)
