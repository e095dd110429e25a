// The matrices of the L2 projection of torchmesh/transferring/projection.py, and its systems.
#include "conjugate_gradients.hpp"
#include "rows.hpp"

namespace torchmesh {
namespace {

// The hat functions of the corners of a triangle about an origin: f + fx x + fy y.
struct Hats {
    double f[3], fx[3], fy[3];

    Hats(const double* x, const double* y, const std::int64_t* corner, double origin_x, double origin_y) {
        double u[3], v[3];
        for (int k = 0; k < 3; ++k) {
            u[k] = x[corner[k]] - origin_x;
            v[k] = y[corner[k]] - origin_y;
        }
        const double twice = (u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0]);
        for (int k = 0; k < 3; ++k) {
            const int b = (k + 1) % 3, c = (k + 2) % 3;
            f[k] = (u[b] * v[c] - v[b] * u[c]) / twice;
            fx[k] = (v[b] - v[c]) / twice;
            fy[k] = (u[c] - u[b]) / twice;
        }
    }
};

// Adds up what each row has at equal columns; the result is as that of tm_summed_rows.
std::int64_t summed_rows(Rows& found, std::int64_t* offsets, std::int64_t* out_columns, double* out_values) {
    const std::int64_t size = std::int64_t(found.start.size()) - 1;
    std::int64_t used = 0;
    offsets[0] = 0;
    for (std::int64_t r = 0; r < size; ++r) {
        Entry* row = found.entries.data() + found.start[r];
        const std::int64_t different = summed(row, found.start[r + 1] - found.start[r]);
        for (std::int64_t k = 0; k < different; ++k) {
            out_columns[used] = row[k].column;
            out_values[used++] = row[k].value;
        }
        offsets[r + 1] = used;
    }
    return used;
}

}  // namespace
}  // namespace torchmesh

// Sums up entries (count,) at equal rows and columns.  The result has `size` compressed rows, their columns in order,
// and room for `count` entries; their number is returned.
TM_EXPORT std::int64_t tm_summed_rows(const std::int64_t* rows, const std::int64_t* columns, const double* weights,
                                      std::int64_t count, std::int64_t size, std::int64_t* offsets,
                                      std::int64_t* out_columns, double* out_values) {
    using namespace torchmesh;
    Rows found(size, [&](const auto& take) {
        for (std::int64_t i = 0; i < count; ++i) take(rows[i], columns[i], weights[i]);
    });
    return summed_rows(found, offsets, out_columns, out_values);
}

// The mixed mass of pairs (pairs,) of triangles that overlap, nine entries for each, summed up as by tm_summed_rows.  x
// and y are coordinates of vertices, `moments` (pairs, 6) integrals over the overlaps about the first corner before.
TM_EXPORT std::int64_t tm_mixed_mass(const double* x, const double* y, const std::int64_t* triangles,
                                     const double* old_x, const double* old_y, const std::int64_t* old_triangles,
                                     const std::int64_t* after, const std::int64_t* before, const double* moments,
                                     const double* sign, std::int64_t pairs, std::int64_t size, std::int64_t* offsets,
                                     std::int64_t* out_columns, double* out_values) {
    using namespace torchmesh;
    Rows found(size);
    for (std::int64_t i = 0; i < pairs; ++i)
        for (int p = 0; p < 3; ++p) found.start[triangles[3 * after[i] + p] + 1] += 3;
    found.fill([&](const auto& take) {
        for (std::int64_t i = 0; i < pairs; ++i) {
            const std::int64_t *t = triangles + 3 * after[i], *s = old_triangles + 3 * before[i];
            const Hats a(x, y, t, old_x[s[0]], old_y[s[0]]), b(old_x, old_y, s, old_x[s[0]], old_y[s[0]]);
            double m[6];
            for (int k = 0; k < 6; ++k) m[k] = moments[6 * i + k] * sign[i];
            for (int p = 0; p < 3; ++p)
                for (int q = 0; q < 3; ++q)
                    take(t[p], s[q],
                         a.f[p] * b.f[q] * m[0] + (a.f[p] * b.fx[q] + a.fx[p] * b.f[q]) * m[1] +
                             (a.f[p] * b.fy[q] + a.fy[p] * b.f[q]) * m[2] + a.fx[p] * b.fx[q] * m[3] +
                             (a.fx[p] * b.fy[q] + a.fy[p] * b.fx[q]) * m[4] + a.fy[p] * b.fy[q] * m[5]);
        }
    });
    return summed_rows(found, offsets, out_columns, out_values);
}

// Solves A x = right for the systems first[m] ... first[m + 1] - 1 of compressed rows, whose diagonal stands apart.
TM_EXPORT void tm_rows_solve(const std::int64_t* offsets, const std::int64_t* columns, const double* values,
                             const double* diagonal, const std::int64_t* first, std::int64_t systems,
                             const double* right, double tolerance, std::int64_t max_iterations, int threads, double* x,
                             std::int64_t* iterations, std::uint8_t* converged) {
    torchmesh::in_threads(systems, threads, [&](std::int64_t m) {
        const std::int64_t begin = first[m], n = first[m + 1] - begin;
        const auto product = [&](const double* u, double* image) {
            for (std::int64_t i = 0; i < n; ++i) {
                double sum = diagonal[begin + i] * u[i];
                for (std::int64_t k = offsets[begin + i]; k < offsets[begin + i + 1]; ++k)
                    sum += values[k] * u[columns[k] - begin];
                image[i] = sum;
            }
        };
        const torchmesh::Solution found = torchmesh::conjugate_gradients(
            n, n, product, torchmesh::Diagonal(n, diagonal + begin), right + begin, tolerance, max_iterations, x + begin);
        iterations[m] = found.iterations;
        converged[m] = found.converged;
    });
}
