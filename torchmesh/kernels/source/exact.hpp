// Signs that are facts: orientation and in-circle, exact for every finite input.
//
// The filters are those of torchmesh/mesh/predicates.py.  What they cannot decide is computed in expansions (Shewchuk,
// Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates, 1997), or, where the exponents of
// the coordinates lie so far apart that a product could underflow, in integers of any length.
#pragma once

#include "common.hpp"

#include <array>

namespace torchmesh {

constexpr double EPSILON = 1.1102230246251565e-16;  // 2^-53
constexpr double ORIENTATION_BOUND = (3 + 16 * EPSILON) * EPSILON;
constexpr double INCIRCLE_BOUND = (10 + 96 * EPSILON) * EPSILON;
// In sums below this a product may have lost bits to underflow, and the filter's bound does not hold.
constexpr double UNDERFLOW_BOUND = 1e-270;

int exact_orientation(const double* xy);  // ax, ay, bx, by, cx, cy
int exact_incircle(const double* xy);     // the same, and dx, dy

inline int sign_of(double value) { return (value > 0) - (value < 0); }

// The sign of a value whose error is less than `bound`; 0 where that is not enough to tell.
TM_INLINE int filtered_sign(double value, double bound) {
    // Not where anything has overflowed, as no number is above infinity; NaN is above none.
    return std::abs(value) > (bound < UNDERFLOW_BOUND ? UNDERFLOW_BOUND : bound) ? sign_of(value) : 0;
}

inline bool all_finite(const double* xy, int count) {
    for (int i = 0; i < count; ++i)
        if (!std::isfinite(xy[i])) return false;
    return true;
}

// The sign of twice the signed area of abc: 1 counter-clockwise, -1 clockwise, 0 flat, or where a coordinate is not
// finite.
TM_INLINE int orientation(double ax, double ay, double bx, double by, double cx, double cy) {
    const double left = (bx - ax) * (cy - ay), right = (by - ay) * (cx - ax), determinant = left - right;
    const double bound = (std::abs(left) + std::abs(right)) * ORIENTATION_BOUND;
    const int known = filtered_sign(determinant, bound);
    if (known != 0) return known;
    const double xy[6] = {ax, ay, bx, by, cx, cy};
    return all_finite(xy, 6) ? exact_orientation(xy) : 0;
}

// 1 when d lies inside the circle through the counter-clockwise abc.
TM_INLINE int incircle(double ax, double ay, double bx, double by, double cx, double cy, double dx, double dy) {
    const double xy[8] = {ax, ay, bx, by, cx, cy, dx, dy};
    ax -= dx, ay -= dy, bx -= dx, by -= dy, cx -= dx, cy -= dy;
    const double bc_l = bx * cy, bc_r = by * cx, ca_l = cx * ay, ca_r = cy * ax, ab_l = ax * by, ab_r = ay * bx;
    const double a2 = ax * ax + ay * ay, b2 = bx * bx + by * by, c2 = cx * cx + cy * cy;
    const double determinant = (a2 * (bc_l - bc_r) + b2 * (ca_l - ca_r)) + c2 * (ab_l - ab_r);
    const double magnitude = (a2 * (std::abs(bc_l) + std::abs(bc_r)) + b2 * (std::abs(ca_l) + std::abs(ca_r))) +
                             c2 * (std::abs(ab_l) + std::abs(ab_r));
    const double bound = magnitude * INCIRCLE_BOUND;
    const int known = filtered_sign(determinant, bound);
    if (known != 0) return known;
    return all_finite(xy, 8) ? exact_incircle(xy) : 0;
}

}  // namespace torchmesh
