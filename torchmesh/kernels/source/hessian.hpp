// Products with the Hessian of a mesh's energy, and linear systems with it.
//
// The formulas are those of torchmesh/optimising/hessian.py, the steps those of optimising/conjugate_gradients.py.
#pragma once

#include "conjugate_gradients.hpp"

namespace torchmesh {

// The second derivatives of a triangle's energy by its edges e1x, e1y, e2x, e2y: a symmetric matrix, whose upper half
// these ten numbers are, row by row.
//
// e        the edges
// g        the target's g11, g12, g22 and m
// s, d     the slopes of phi by stretch and by det; ss, sd, dd its curvatures
TM_INLINE void hessian_of_triangle(const double* e, const double* g, double s, double d, double ss, double sd,
                                   double dd, double* block) {
    // The first derivatives of stretch and det by the edges.
    const double p[4] = {2 * (g[0] * e[0] + g[1] * e[2]), 2 * (g[0] * e[1] + g[1] * e[3]),
                         2 * (g[2] * e[2] + g[1] * e[0]), 2 * (g[2] * e[3] + g[1] * e[1])};
    const double q[4] = {g[3] * e[3], -g[3] * e[2], -g[3] * e[1], g[3] * e[0]};
    int at = 0;
    for (int i = 0; i < 4; ++i)
        for (int j = i; j < 4; ++j)
            block[at++] = (ss * p[i] * p[j] + sd * (p[i] * q[j] + q[i] * p[j])) + dd * q[i] * q[j];
    const double two = 2 * s, area = g[3] * d;
    block[0] += two * g[0];
    block[4] += two * g[0];
    block[2] += two * g[1];
    block[6] += two * g[1];
    block[7] += two * g[2];
    block[9] += two * g[2];
    block[3] += area;
    block[5] -= area;
}

// The triangles of one mesh at one point, with their second derivatives.
struct HessianTriangles {
    explicit HessianTriangles(std::int64_t count) : count(count), blocks(std::size_t(10 * count)) {}

    double* column(int k) { return blocks.data() + k * count; }
    const double* column(int k) const { return blocks.data() + k * count; }

    std::int64_t count;
    const std::int32_t* rows[6] = {};  // into a vector of n unknowns and of numbers beyond, which stay zero
    std::vector<double> blocks;        // (10, count)
};

// The diagonal of the whole matrix, of the length of the vectors that `rows` point into.
void add_diagonal(const HessianTriangles& of, std::vector<double>& diagonal);

// Solves H x = right by `conjugate_gradients`, whose arguments these are, with the diagonal as preconditioner; `length` is
// that of the vectors that `rows` point into.
Solution solve_with_hessian(const HessianTriangles& of, std::int64_t n, std::int64_t length, const double* diagonal,
                            const double* right, double tolerance, std::int64_t max_iterations, double* x);

struct Elimination;
class BlockFactors;

// The same with factors as preconditioner: while they lead to the solution in a few steps those of `near`, of H at a point
// not far away, then those of H.  It is not solved where these do not exist, and without an `order`.  `near` may be null.
Solution solve_with_factors(const HessianTriangles& of, std::int64_t n, std::int64_t length, const double* right,
                            double tolerance, std::int64_t max_iterations, double* x, const Elimination* order,
                            const BlockFactors* near);

}  // namespace torchmesh
