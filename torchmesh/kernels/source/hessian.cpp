// Linear systems with the Hessians of meshes, by conjugate gradients, one mesh after the other or in threads.
#include "hessian.hpp"

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
};

constexpr int TILE = 128;

struct Tile {
    double d[4][TILE], f[4][TILE], by_stretch[TILE], by_det[TILE];
};

TM_INLINE double at(const HessianTriangles& of, int k, std::int64_t t) { return of.target[k][of.stride[k] * t]; }

TM_INLINE void add_product(const HessianTriangles& of, const double* TM_RESTRICT u, double* TM_RESTRICT out) {
    Tile tile;
    const std::int32_t* row[6];
    for (int k = 0; k < 6; ++k) row[k] = of.rows[k];
    for (std::int64_t start = 0; start < of.count; start += TILE) {
        const int n = int(std::min<std::int64_t>(TILE, of.count - start));
        for (int i = 0; i < n; ++i) {
            const std::int64_t t = start + i;
            const double x = u[row[0][t]], y = u[row[1][t]];
            tile.d[0][i] = u[row[2][t]] - x;
            tile.d[1][i] = u[row[3][t]] - y;
            tile.d[2][i] = u[row[4][t]] - x;
            tile.d[3][i] = u[row[5][t]] - y;
        }
        for (int i = 0; i < n; ++i) {
            const std::int64_t t = start + i;
            const double g11 = at(of, 0, t), g12 = at(of, 1, t), g22 = at(of, 2, t), m = at(of, 3, t);
            const double e1x = of.edges[0][t], e1y = of.edges[1][t], e2x = of.edges[2][t], e2y = of.edges[3][t];
            const double d1x = tile.d[0][i], d1y = tile.d[1][i], d2x = tile.d[2][i], d2y = tile.d[3][i];
            // The first derivatives of stretch and det by the edges.
            const double s1x = 2 * (g11 * e1x + g12 * e2x), s1y = 2 * (g11 * e1y + g12 * e2y),
                         s2x = 2 * (g22 * e2x + g12 * e1x), s2y = 2 * (g22 * e2y + g12 * e1y);
            const double a1x = m * e2y, a1y = -m * e2x, a2x = -m * e1y, a2y = m * e1x;
            const double by_stretch = ((s1x * d1x + s1y * d1y) + s2x * d2x) + s2y * d2y;
            const double by_det = ((a1x * d1x + a1y * d1y) + a2x * d2x) + a2y * d2y;
            const double ss = of.curvatures[0][t], sd = of.curvatures[1][t], dd = of.curvatures[2][t];
            const double p = ss * by_stretch + sd * by_det, q = sd * by_stretch + dd * by_det;
            const double two = 2 * of.slopes[0][t], area = m * of.slopes[1][t];
            tile.f[0][i] = (two * (g11 * d1x + g12 * d2x) + area * d2y) + (s1x * p + a1x * q);
            tile.f[1][i] = (two * (g11 * d1y + g12 * d2y) - area * d2x) + (s1y * p + a1y * q);
            tile.f[2][i] = (two * (g22 * d2x + g12 * d1x) - area * d1y) + (s2x * p + a2x * q);
            tile.f[3][i] = (two * (g22 * d2y + g12 * d1y) + area * d1x) + (s2y * p + a2y * q);
        }
        for (int i = 0; i < n; ++i) {
            const std::int64_t t = start + i;
            out[row[0][t]] -= tile.f[0][i] + tile.f[2][i];
            out[row[1][t]] -= tile.f[1][i] + tile.f[3][i];
            out[row[2][t]] += tile.f[0][i];
            out[row[3][t]] += tile.f[1][i];
            out[row[4][t]] += tile.f[2][i];
            out[row[5][t]] += tile.f[3][i];
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
    HessianTriangles of;
    of.count = count;
    rows.resize(std::size_t(6 * count));
    for (int k = 0; k < 6; ++k) {
        of.rows[k] = rows.data() + k * count;
        for (std::int64_t t = 0; t < count; ++t) {
            const std::int64_t row = all.rows[k * all.count + from + t] - first;
            rows[k * count + t] = std::int32_t(row >= 0 && row < n ? row : n);
        }
    }
    for (int k = 0; k < 4; ++k) {
        of.edges[k] = all.edges + k * all.count + from;
        of.stride[k] = all.target_stride[k];
        of.target[k] = all.target[k] + of.stride[k] * from;
    }
    for (int k = 0; k < 2; ++k) of.slopes[k] = all.slopes + k * all.count + from;
    for (int k = 0; k < 3; ++k) of.curvatures[k] = all.curvatures + k * all.count + from;
    return of;
}

void solve(const SystemsArgument& all, std::int64_t system) {
    const std::int64_t first = all.offsets[system], n = all.offsets[system + 1] - first;
    std::vector<std::int32_t> rows;
    const HessianTriangles of = triangles_of(all, system, rows);
    const Solution found = solve_with_hessian(of, n, n + 1, all.diagonal + first, all.right + first,
                                              all.tolerance[system], all.max_iterations, all.x + first);
    all.iterations[system] = found.iterations;
    all.converged[system] = found.converged;
}

}  // namespace

TM_DISPATCH double dot(std::int64_t n, const double* u, const double* v) { return inner_product(n, u, v); }

Solution solve_with_hessian(const HessianTriangles& of, std::int64_t n, std::int64_t length, const double* diagonal,
                            const double* right, double tolerance, std::int64_t max_iterations, double* x) {
    const auto product = [&](const double* u, double* image) {
        std::fill(image, image + length, 0.0);
        add_hessian_product(of, u, image);
    };
    return conjugate_gradients(n, length, product, diagonal, right, tolerance, max_iterations, x);
}

}  // namespace torchmesh

TM_EXPORT void tm_hessian_solve(const torchmesh::SystemsArgument* all, std::int64_t from, std::int64_t to,
                                std::int32_t threads) {
    torchmesh::in_threads(to - from, threads, [&](std::int64_t i) { torchmesh::solve(*all, from + i); });
}
