// The factors of Hessians in blocks of 2x2: the order of elimination, the factorisation and the solution.
//
// The rows of L follow from the elimination tree (Davis, Direct methods for sparse linear systems, SIAM, 2006, chapter
// 4).  Columns are computed from left to right, each from those before it that have an entry in its row (the same, section
// 4.8; George & Liu, Computer solution of large sparse positive definite systems, 1981, section 5.4).
#include "block_factors.hpp"

namespace torchmesh {
namespace {

using Real = BlockFactors::Real;

// Takes the blocks of L D in column j from the entry `p` on, times a block m, off the entries `at` of their rows.
TM_INLINE void subtract(std::int64_t p, std::int64_t end, const Index* rows, const std::int64_t* at, const Real* m,
                        Real* lower) {
    const Real m0 = m[0], m1 = m[1], m2 = m[2], m3 = m[3];
    for (; p < end; ++p) {
        const Real *l = lower + 4 * p, l0 = l[0], l1 = l[1], l2 = l[2], l3 = l[3];
        Real* to = lower + 4 * at[rows[p]];
        to[0] -= l0 * m0 + l1 * m2;
        to[1] -= l0 * m1 + l1 * m3;
        to[2] -= l2 * m0 + l3 * m2;
        to[3] -= l2 * m1 + l3 * m3;
    }
}

// Puts the factors in the place of the matrix: `lower` has its blocks, `inverse` (size, 3) those of its diagonal.
TM_INLINE bool eliminate(const Elimination& of, Real* lower, Real* inverse) {
    const Index n = of.size();
    const std::int64_t* start = of.start.data();
    const Index* rows = of.rows.data();
    // The columns whose next entry is in row i, as a list, and that entry.
    std::vector<Index> first(n, -1), following(n);
    std::vector<std::int64_t> next(n), at(n);
    for (Index i = 0; i < n; ++i) {
        for (std::int64_t p = start[i]; p < start[i + 1]; ++p) at[rows[p]] = p;
        Real *d = inverse + 3 * i, xx = d[0], xy = d[1], yy = d[2];
        for (Index j = first[i], after; j >= 0; j = after) {
            after = following[j];
            const std::int64_t p = next[j];
            const Real *l = lower + 4 * p, *v = inverse + 3 * j;
            // D_j^-1 times the transpose of the block of L D.
            const Real m[4] = {v[0] * l[0] + v[1] * l[1], v[0] * l[2] + v[1] * l[3], v[1] * l[0] + v[2] * l[1],
                                 v[1] * l[2] + v[2] * l[3]};
            xx -= l[0] * m[0] + l[1] * m[2];
            xy -= l[0] * m[1] + l[1] * m[3];
            yy -= l[2] * m[1] + l[3] * m[3];
            subtract(p + 1, start[j + 1], rows, at.data(), m, lower);
            if (p + 1 == start[j + 1]) continue;
            next[j] = p + 1;
            following[j] = first[rows[p + 1]];
            first[rows[p + 1]] = j;
        }
        const Real det = xx * yy - xy * xy;
        if (!(xx > 0) || !(det > 0)) return false;
        d[0] = yy / det;
        d[1] = -xy / det;
        d[2] = xx / det;
        if (start[i] == start[i + 1]) continue;
        next[i] = start[i];
        following[i] = first[rows[start[i]]];
        first[rows[start[i]]] = i;
    }
    return true;
}

TM_DISPATCH bool eliminated(const Elimination& of, Real* lower, Real* inverse) {
    return eliminate(of, lower, inverse);
}

TM_DISPATCH void substitute(const Elimination& of, const Real* lower, const Real* inverse, Real* y) {
    const Index n = of.size();
    const std::int64_t* start = of.start.data();
    const Index* rows = of.rows.data();
    for (Index j = 0; j < n; ++j) {
        const Real *v = inverse + 3 * j, x0 = y[2 * j], y0 = y[2 * j + 1];
        const Real s = v[0] * x0 + v[1] * y0, t = v[1] * x0 + v[2] * y0;
        y[2 * j] = s;
        y[2 * j + 1] = t;
        for (std::int64_t p = start[j]; p < start[j + 1]; ++p) {
            const Real* l = lower + 4 * p;
            Real* to = y + 2 * rows[p];
            to[0] -= l[0] * s + l[1] * t;
            to[1] -= l[2] * s + l[3] * t;
        }
    }
    for (Index j = n; j-- > 0;) {
        Real s = 0, t = 0;
        for (std::int64_t p = start[j]; p < start[j + 1]; ++p) {
            const Real *l = lower + 4 * p, *from = y + 2 * rows[p];
            s += l[0] * from[0] + l[2] * from[1];
            t += l[1] * from[0] + l[3] * from[1];
        }
        const Real* v = inverse + 3 * j;
        y[2 * j] -= v[0] * s + v[1] * t;
        y[2 * j + 1] -= v[1] * s + v[2] * t;
    }
}

// A block, row by row, into the entry of L of two corners of which the first is eliminated later, or the other way round.
TM_INLINE void add_block(Real* to, bool turned, double xx, double xy, double yx, double yy) {
    to[0] += Real(xx);
    to[1] += Real(turned ? yx : xy);
    to[2] += Real(turned ? xy : yx);
    to[3] += Real(yy);
}

}  // namespace

Elimination::Elimination(const std::int32_t* const* rows, std::int64_t count, std::int64_t half) : half(half) {
    std::vector<Index> offsets, columns;
    const std::vector<Index> order = ordered(rows, count, offsets, columns);
    const Index n = size();
    std::vector<Index> of_vertex(n), parent(n), mark(n), filled(n, 0), at(half, -1);
    for (Index i = 0; i < n; ++i) of_vertex[order[i]] = i;
    start.assign(n + 1, 0);
    // The elimination tree, and how many entries the columns of L have; then the entries.
    for (int pass = 0; pass < 2; ++pass) {
        for (Index i = 0; i < n; ++i) {
            if (pass == 0) parent[i] = -1;
            mark[i] = i;
            for (Index e = offsets[order[i]]; e < offsets[order[i] + 1]; ++e)
                for (Index j = of_vertex[columns[e]]; j < i && mark[j] != i; j = parent[j]) {
                    if (parent[j] < 0) parent[j] = i;
                    mark[j] = i;
                    if (pass == 0)
                        ++start[j + 1];
                    else
                        this->rows[start[j] + filled[j]++] = i;
                }
        }
        if (pass > 0) break;
        for (Index i = 0; i < n; ++i) start[i + 1] += start[i];
        this->rows.resize(start[n]);
        std::fill(mark.begin(), mark.end(), -1);
    }
    std::vector<Index> named(n);
    for (Index i = 0; i < n; ++i) {
        named[i] = vertex[order[i]];
        at[named[i]] = i;
    }
    vertex = std::move(named);
    number.resize(std::size_t(3 * count));
    entry.resize(std::size_t(3 * count));
    constexpr int one[3] = {0, 0, 1}, two[3] = {1, 2, 2};
    for (std::int64_t t = 0; t < count; ++t) {
        for (int k = 0; k < 3; ++k) {
            const std::int32_t row = rows[2 * k][t];
            number[k * count + t] = row >= 0 && row < half ? at[row] : -1;
        }
        for (int k = 0; k < 3; ++k) {
            const Index u = number[one[k] * count + t], v = number[two[k] * count + t], low = std::min(u, v);
            const auto begin = this->rows.begin();
            entry[k * count + t] =
                low < 0 ? -1 : std::lower_bound(begin + start[low], begin + start[low + 1], std::max(u, v)) - begin;
        }
    }
}

// The order of the vertices that triangles touch, which `vertex` names, and their neighbours.
std::vector<Index> Elimination::ordered(const std::int32_t* const* rows, std::int64_t count,
                                        std::vector<Index>& offsets, std::vector<Index>& columns) {
    std::vector<Index> name(half, -1);
    const auto corner = [&](int k, std::int64_t t) {
        const std::int32_t row = rows[2 * k][t];
        return row >= 0 && row < half ? name[row] : -1;
    };
    for (int k = 0; k < 3; ++k)
        for (std::int64_t t = 0; t < count; ++t) {
            const std::int32_t row = rows[2 * k][t];
            if (row >= 0 && row < half) name[row] = 0;
        }
    for (std::int64_t v = 0; v < half; ++v)
        if (name[v] >= 0) {
            name[v] = Index(vertex.size());
            vertex.push_back(Index(v));
        }
    const Index n = size();
    std::vector<Index> all(n + 1, 0), mark(n, -1), found;
    for (std::int64_t t = 0; t < count; ++t)
        for (int k = 0; k < 3; ++k)
            if (corner(k, t) >= 0) all[corner(k, t) + 1] += 2;
    for (Index v = 0; v < n; ++v) all[v + 1] += all[v];
    found.resize(all[n]);
    std::vector<Index> fill(all.begin(), all.end() - 1);
    for (std::int64_t t = 0; t < count; ++t)
        for (int k = 0; k < 3; ++k) {
            const Index v = corner(k, t);
            if (v < 0) continue;
            found[fill[v]++] = corner((k + 1) % 3, t);
            found[fill[v]++] = corner((k + 2) % 3, t);
        }
    offsets.assign(n + 1, 0);
    for (Index v = 0; v < n; ++v) {
        for (Index e = all[v]; e < all[v + 1]; ++e) {
            const Index w = found[e];
            if (w < 0 || mark[w] == v) continue;
            mark[w] = v;
            columns.push_back(w);
        }
        offsets[v + 1] = Index(columns.size());
    }
    const Graph graph{offsets.data(), columns.data(), n};
    return n > SMALL_GRAPH ? Dissection(graph).order() : minimum_degree(graph);
}

bool BlockFactors::factorise(const Elimination& of, const HessianTriangles& triangles) {
    const std::int64_t count = triangles.count;
    lower_.assign(4 * of.rows.size(), 0);
    inverse_.assign(3 * std::size_t(of.size()), 0);
    for (std::int64_t t = 0; t < count; ++t) {
        double h[10];
        Index n[3];
        for (int k = 0; k < 10; ++k) h[k] = triangles.column(k)[t];
        for (int k = 0; k < 3; ++k) n[k] = of.number[k * count + t];
        // Blocks of the corners b and c; those of a are minus the sums of these.
        const double bb[3] = {h[0], h[1], h[4]}, bc[4] = {h[2], h[3], h[5], h[6]}, cc[3] = {h[7], h[8], h[9]};
        const double ab[4] = {-(bb[0] + bc[0]), -(bb[1] + bc[2]), -(bb[1] + bc[1]), -(bb[2] + bc[3])};
        const double ac[4] = {-(bc[0] + cc[0]), -(bc[1] + cc[1]), -(bc[2] + cc[1]), -(bc[3] + cc[2])};
        const double aa[3] = {-(ab[0] + ac[0]), -(ab[1] + ac[1]), -(ab[3] + ac[3])};
        const double *own[3] = {aa, bb, cc}, *joint[3] = {ab, ac, bc};
        for (int k = 0; k < 3; ++k) {
            if (n[k] >= 0)
                for (int i = 0; i < 3; ++i) inverse_[3 * std::size_t(n[k]) + i] += Real(own[k][i]);
            const std::int64_t to = of.entry[k * count + t];
            if (to < 0) continue;
            // The block has the rows of the first corner of the edge; L has those of the later one.
            const bool turned = n[k == 2] < n[k == 0 ? 1 : 2];
            add_block(lower_.data() + 4 * to, turned, joint[k][0], joint[k][1], joint[k][2], joint[k][3]);
        }
    }
    if (eliminated(of, lower_.data(), inverse_.data())) return true;
    lower_.clear();
    inverse_.clear();
    return false;
}

void BlockFactors::solve(const Elimination& of, const double* right, double* x, std::vector<Real>& scratch) const {
    const Index n = of.size();
    scratch.resize(2 * std::size_t(n));
    for (Index i = 0; i < n; ++i) {
        scratch[2 * i] = Real(right[of.vertex[i]]);
        scratch[2 * i + 1] = Real(right[of.half + of.vertex[i]]);
    }
    substitute(of, lower_.data(), inverse_.data(), scratch.data());
    std::fill(x, x + 2 * of.half, 0.0);
    for (Index i = 0; i < n; ++i) {
        x[of.vertex[i]] = scratch[2 * i];
        x[of.half + of.vertex[i]] = scratch[2 * i + 1];
    }
}

}  // namespace torchmesh

TM_EXPORT void* tm_new_eliminations(std::int64_t meshes) {
    auto* made = new torchmesh::Eliminations;
    made->of.resize(std::size_t(meshes));
    return made;
}

// Orders the meshes from, ..., to - 1, whose unknowns and triangles `offsets` and `triangle_offsets` (B + 1,) tell, but for
// those with more than `most` unknowns.  rows (6, count) are those of a packing.
TM_EXPORT void tm_eliminate(void* handle, const std::int32_t* rows, std::int64_t count, const std::int64_t* offsets,
                            const std::int64_t* triangle_offsets, std::int64_t from, std::int64_t to, std::int64_t most,
                            std::int32_t threads) {
    using namespace torchmesh;
    auto& all = *static_cast<Eliminations*>(handle);
    in_threads(to - from, threads, [&](std::int64_t i) {
        const std::int64_t mesh = from + i, begin = triangle_offsets[mesh], own = triangle_offsets[mesh + 1] - begin;
        const std::int64_t first = offsets[mesh], n = offsets[mesh + 1] - first;
        if (n > most) return;
        std::vector<std::int32_t> named(std::size_t(6 * own));
        const std::int32_t* corner[6];
        for (int k = 0; k < 6; ++k) {
            corner[k] = named.data() + k * own;
            for (std::int64_t t = 0; t < own; ++t) {
                const std::int64_t row = rows[k * count + begin + t] - first;
                named[std::size_t(k * own + t)] = std::int32_t(row < n ? row : -1);
            }
        }
        all.of[std::size_t(mesh)] = std::make_unique<const Elimination>(corner, own, n / 2);
    });
}

TM_EXPORT void tm_end_eliminations(void* handle) { delete static_cast<torchmesh::Eliminations*>(handle); }

TM_EXPORT void tm_end_factors(void* handle) { delete static_cast<torchmesh::FactorsOfMeshes*>(handle); }
