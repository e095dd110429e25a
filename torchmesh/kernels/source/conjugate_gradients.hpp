// Conjugate gradients in the steps of torchmesh/optimising/conjugate_gradients.py.
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
// nobody in image.  precondition(residual, shorter) puts what stands for A^-1 residual into shorter, both (n,).
template <class Product, class Precondition>
Solution conjugate_gradients(std::int64_t n, std::int64_t length, const Product& product,
                             const Precondition& precondition, const double* right, double tolerance,
                             std::int64_t max_iterations, double* x) {
    const auto size = static_cast<std::size_t>(n), whole = static_cast<std::size_t>(length);
    std::vector<double> residual(right, right + n), direction(whole, 0.0), image(whole), shorter(size);
    std::fill(x, x + n, 0.0);
    precondition(residual.data(), direction.data());
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
        }
        precondition(residual.data(), shorter.data());
        const double before = power;
        power = dot(n, residual.data(), shorter.data());
        ++found.iterations;
        found.converged = power <= goal;
        const double again = before > 0 ? power / before : 0;
        for (std::int64_t i = 0; i < n; ++i) direction[i] = shorter[i] + again * direction[i];
    }
    return found;
}

// The absolute value of a diagonal (n,) as preconditioner; where it is zero there is padding.
class Diagonal {
  public:
    Diagonal(std::int64_t n, const double* diagonal) : inverse_(static_cast<std::size_t>(n)) {
        for (std::int64_t i = 0; i < n; ++i) {
            const double d = std::abs(diagonal[i]);
            inverse_[i] = d > 0 ? 1 / d : 0;
        }
    }
    void operator()(const double* residual, double* shorter) const {
        for (std::size_t i = 0; i < inverse_.size(); ++i) shorter[i] = residual[i] * inverse_[i];
    }

  private:
    std::vector<double> inverse_;
};

}  // namespace torchmesh
