// Products with the Hessian of a mesh's energy, and linear systems with it.
//
// The formulas are those of torchmesh/optimising/hessian.py, the steps those of optimising/conjugate_gradients.py.
#pragma once

#include "conjugate_gradients.hpp"

namespace torchmesh {

// The triangles of one mesh at one point.  A stride is 0 for one number for all triangles, and 1 for one each.
// Rows are those of a vector of n unknowns and of numbers beyond, which stay zero.
struct HessianTriangles {
    std::int64_t count = 0;
    const std::int32_t* rows[6] = {};
    const double *edges[4] = {}, *slopes[2] = {}, *curvatures[3] = {}, *target[4] = {};
    std::int64_t stride[4] = {};
};

// Solves H x = right by `conjugate_gradients`, whose arguments these are; `length` is that of the vectors that `rows`
// point into.
Solution solve_with_hessian(const HessianTriangles& of, std::int64_t n, std::int64_t length, const double* diagonal,
                            const double* right, double tolerance, std::int64_t max_iterations, double* x);

}  // namespace torchmesh
