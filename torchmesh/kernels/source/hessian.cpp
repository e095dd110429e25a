// Linear systems with the Hessians of meshes, by conjugate gradients, one mesh after the other or in threads.
#include "block_factors.hpp"

namespace torchmesh {
namespace {

// Must have the fields of kernels/hessian.py, `_Systems`, in the same order.
struct SystemsArgument {
    const std::int64_t* rows;   // (6, count)
    const double* edges;        // (4, count): e1x, e1y, e2x, e2y
    const double* slopes;       // (2, count)
    const double* curvatures;   // (3, count)
    const double* target[4];    // g11, g12, g22, m
    std::int64_t target_stride[4];
    std::int64_t count;
    const std::int64_t *triangle_offsets, *offsets;  // (B+1,)
    std::int64_t systems;
    const double *diagonal, *right, *tolerance;  // (N,), (N,), (B,)
    std::int64_t max_iterations;
    double* x;
    std::int64_t* iterations;
    std::uint8_t* converged;
    const Eliminations* orders;        // or null
    const FactorsOfMeshes* factors;    // near the solution, or null
};

constexpr int TILE = 128;

// Steps with factors of another point at most, before those of this point are computed: twice what those cost.
constexpr std::int64_t FEW = 10;

TM_INLINE void add_product(const HessianTriangles& of, const double* TM_RESTRICT u, double* TM_RESTRICT out) {
    double d[4][TILE], f[4][TILE];
    const std::int32_t* row[6];
    for (int k = 0; k < 6; ++k) row[k] = of.rows[k];
    for (std::int64_t start = 0; start < of.count; start += TILE) {
        const int n = int(std::min<std::int64_t>(TILE, of.count - start));
        for (int i = 0; i < n; ++i) {
            const std::int64_t t = start + i;
            const double x = u[row[0][t]], y = u[row[1][t]];
            d[0][i] = u[row[2][t]] - x;
            d[1][i] = u[row[3][t]] - y;
            d[2][i] = u[row[4][t]] - x;
            d[3][i] = u[row[5][t]] - y;
        }
        const double *TM_RESTRICT m00 = of.column(0) + start, *TM_RESTRICT m01 = of.column(1) + start,
                     *TM_RESTRICT m02 = of.column(2) + start, *TM_RESTRICT m03 = of.column(3) + start,
                     *TM_RESTRICT m11 = of.column(4) + start, *TM_RESTRICT m12 = of.column(5) + start,
                     *TM_RESTRICT m13 = of.column(6) + start, *TM_RESTRICT m22 = of.column(7) + start,
                     *TM_RESTRICT m23 = of.column(8) + start, *TM_RESTRICT m33 = of.column(9) + start;
        for (int i = 0; i < n; ++i) {
            f[0][i] = (m00[i] * d[0][i] + m01[i] * d[1][i]) + (m02[i] * d[2][i] + m03[i] * d[3][i]);
            f[1][i] = (m01[i] * d[0][i] + m11[i] * d[1][i]) + (m12[i] * d[2][i] + m13[i] * d[3][i]);
            f[2][i] = (m02[i] * d[0][i] + m12[i] * d[1][i]) + (m22[i] * d[2][i] + m23[i] * d[3][i]);
            f[3][i] = (m03[i] * d[0][i] + m13[i] * d[1][i]) + (m23[i] * d[2][i] + m33[i] * d[3][i]);
        }
        for (int i = 0; i < n; ++i) {
            const std::int64_t t = start + i;
            out[row[0][t]] -= f[0][i] + f[2][i];
            out[row[1][t]] -= f[1][i] + f[3][i];
            out[row[2][t]] += f[0][i];
            out[row[3][t]] += f[1][i];
            out[row[4][t]] += f[2][i];
            out[row[5][t]] += f[3][i];
        }
    }
}

TM_DISPATCH void add_hessian_product(const HessianTriangles& of, const double* u, double* out) {
    add_product(of, u, out);
}

// The triangles of one system, with rows of its own: those beyond its unknowns are that of one more number.
HessianTriangles triangles_of(const SystemsArgument& all, std::int64_t system, std::vector<std::int32_t>& rows) {
    const std::int64_t from = all.triangle_offsets[system], count = all.triangle_offsets[system + 1] - from;
    const std::int64_t first = all.offsets[system], n = all.offsets[system + 1] - first;
    HessianTriangles of(count);
    rows.resize(std::size_t(6 * count));
    for (int k = 0; k < 6; ++k) {
        of.rows[k] = rows.data() + k * count;
        for (std::int64_t t = 0; t < count; ++t) {
            const std::int64_t row = all.rows[k * all.count + from + t] - first;
            rows[k * count + t] = std::int32_t(row >= 0 && row < n ? row : n);
        }
    }
    for (std::int64_t t = 0; t < count; ++t) {
        double e[4], g[4], block[10];
        for (int k = 0; k < 4; ++k) {
            e[k] = all.edges[k * all.count + from + t];
            g[k] = all.target[k][all.target_stride[k] * (from + t)];
        }
        const double *slope = all.slopes + from + t, *curvature = all.curvatures + from + t;
        hessian_of_triangle(e, g, slope[0], slope[all.count], curvature[0], curvature[all.count],
                            curvature[2 * all.count], block);
        for (int k = 0; k < 10; ++k) of.column(k)[t] = block[k];
    }
    return of;
}

void solve(const SystemsArgument& all, std::int64_t system) {
    const std::int64_t first = all.offsets[system], n = all.offsets[system + 1] - first;
    std::vector<std::int32_t> rows;
    const HessianTriangles of = triangles_of(all, system, rows);
    Solution found = solve_with_factors(of, n, n + 1, all.right + first, all.tolerance[system], all.max_iterations,
                                        all.x + first, order_of(all.orders, system), factors_of(all.factors, system));
    if (!found.converged)
        found = solve_with_hessian(of, n, n + 1, all.diagonal + first, all.right + first, all.tolerance[system],
                                   all.max_iterations, all.x + first);
    all.iterations[system] = found.iterations;
    all.converged[system] = found.converged;
}

}  // namespace

TM_DISPATCH double dot(std::int64_t n, const double* u, const double* v) { return inner_product(n, u, v); }

void add_diagonal(const HessianTriangles& of, std::vector<double>& diagonal) {
    std::fill(diagonal.begin(), diagonal.end(), 0.0);
    for (std::int64_t t = 0; t < of.count; ++t) {
        const double second[4] = {of.column(0)[t], of.column(4)[t], of.column(7)[t], of.column(9)[t]};
        for (int k = 0; k < 2; ++k)
            diagonal[std::size_t(of.rows[k][t])] += (second[k] + second[k + 2]) + 2 * of.column(k == 0 ? 2 : 6)[t];
        for (int k = 0; k < 4; ++k) diagonal[std::size_t(of.rows[k + 2][t])] += second[k];
    }
}

Solution solve_with_hessian(const HessianTriangles& of, std::int64_t n, std::int64_t length, const double* diagonal,
                            const double* right, double tolerance, std::int64_t max_iterations, double* x) {
    const auto product = [&](const double* u, double* image) {
        std::fill(image, image + length, 0.0);
        add_hessian_product(of, u, image);
    };
    return conjugate_gradients(n, length, product, Diagonal(n, diagonal), right, tolerance, max_iterations, x);
}

Solution solve_with_factors(const HessianTriangles& of, std::int64_t n, std::int64_t length, const double* right,
                            double tolerance, std::int64_t max_iterations, double* x, const Elimination* order,
                            const BlockFactors* near) {
    if (!order) return {0, false};
    std::vector<BlockFactors::Real> scratch;
    const auto product = [&](const double* u, double* image) {
        std::fill(image, image + length, 0.0);
        add_hessian_product(of, u, image);
    };
    const auto by = [&](const BlockFactors& factors, std::int64_t most) {
        const auto precondition = [&](const double* u, double* image) { factors.solve(*order, u, image, scratch); };
        return conjugate_gradients(n, length, product, precondition, right, tolerance, most, x);
    };
    if (near && near->any()) {
        const Solution found = by(*near, std::min(FEW, max_iterations));
        if (found.converged) return found;
    }
    BlockFactors here;
    if (!here.factorise(*order, of)) return {0, false};
    return by(here, max_iterations);
}

}  // namespace torchmesh

TM_EXPORT void tm_hessian_solve(const torchmesh::SystemsArgument* all, std::int64_t from, std::int64_t to,
                                std::int32_t threads) {
    torchmesh::in_threads(to - from, threads, [&](std::int64_t i) { torchmesh::solve(*all, from + i); });
}
