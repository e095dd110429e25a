// Conjugate gradients with the diagonal as preconditioner, in the steps of torchmesh/optimising/conjugate_gradients.py.
#pragma once

#include "common.hpp"

namespace torchmesh {

struct Solution {
    std::int64_t iterations;
    bool converged;
};

TM_INLINE double inner_product(std::int64_t n, const double* TM_RESTRICT u, const double* TM_RESTRICT v) {
    double sum[LANES] = {};
    std::int64_t i = 0;
    for (; i + LANES <= n; i += LANES)
        for (int k = 0; k < LANES; ++k) sum[k] += u[i + k] * v[i + k];
    for (; i < n; ++i) sum[i % LANES] += u[i] * v[i];
    double total = 0;
    for (double part : sum) total += part;
    return total;
}

// Compiled once, so that the processor's own instructions may be chosen when the library is loaded.
double dot(std::int64_t n, const double* u, const double* v);

// Solves A x = right, both (n,), until the preconditioned residual has fallen to `tolerance` of what it was.
// product(u, image) puts A u into image; both have `length` numbers, of which those beyond n are 0 in u, and are read by
// nobody in image.  The absolute value of `diagonal` (n,) is the preconditioner; where it is zero there is padding.
template <class Product>
Solution conjugate_gradients(std::int64_t n, std::int64_t length, const Product& product, const double* diagonal,
                             const double* right, double tolerance, std::int64_t max_iterations, double* x) {
    const auto size = static_cast<std::size_t>(n), whole = static_cast<std::size_t>(length);
    std::vector<double> residual(right, right + n), direction(whole, 0.0), image(whole), inverse(size), shorter(size);
    for (std::int64_t i = 0; i < n; ++i) {
        x[i] = 0;
        const double d = std::abs(diagonal[i]);
        inverse[i] = d > 0 ? 1 / d : 0;
        direction[i] = residual[i] * inverse[i];
    }
    double power = dot(n, residual.data(), direction.data());
    const double goal = power * tolerance * tolerance;
    Solution found{0, !(power > 0)};
    while (!found.converged && found.iterations < max_iterations) {
        product(direction.data(), image.data());
        const double curvature = dot(n, direction.data(), image.data());
        if (!(curvature > 0)) break;
        const double step = power / curvature;
        if (!(step > 0)) break;
        for (std::int64_t i = 0; i < n; ++i) {
            x[i] += step * direction[i];
            residual[i] -= step * image[i];
            shorter[i] = residual[i] * inverse[i];
        }
        const double before = power;
        power = dot(n, residual.data(), shorter.data());
        ++found.iterations;
        found.converged = power <= goal;
        const double again = before > 0 ? power / before : 0;
        for (std::int64_t i = 0; i < n; ++i) direction[i] = shorter[i] + again * direction[i];
    }
    return found;
}

}  // namespace torchmesh
