// The energy of every triangle of a mesh and the gradient of their sum.
//
// The formulas are those of torchmesh/optimising/energies.py (phi and its slopes by stretch and det) and of
// torchmesh/optimising/jacobian.py (stretch and det by the edges).  Triangles are worked on in tiles: their corners are
// gathered, everything is computed in vectors, and the forces are scattered in the order of the triangles.
#pragma once

#include "common.hpp"

namespace torchmesh {

enum Kind : std::int32_t { INVERSE_MEAN_RATIO = 0, UNTANGLE_BETA = 1, REGULARISED = 2 };

// The arguments as Python passes them.  A stride is 0 for one number for all triangles, and 1 for one each.
// Must have the fields of kernels/minimiser.py, `_Triangles`, in the same order.
struct TrianglesArgument {
    std::int32_t kind, power;
    double ceiling;  // of the inverse mean ratio, 0 for none
    double theta;    // of the regularised functional
    const void* parameter;  // beta or epsilon
    const void* target[4];  // g11, g12, g22, m
    std::int64_t parameter_stride, target_stride[4];
    const std::int32_t* rows;  // (6, count): ax, ay, bx, by, cx, cy in the unknowns followed by the anchored ones
    std::int64_t count;
    const void* edges;  // (4, count), or null: e1x, e1y, e2x, e2y where all coordinates are zero
    const void* map[3];  // h11, h12, h22 of the edge map, or null
};

constexpr int TILE = 256;

template <class T>
struct Tile {
    T e[4][TILE];
    T det[TILE], stretch[TILE], phi[TILE], slope[TILE], by_area[TILE];
    T force[4][TILE];
};

// The triangles of one mesh, with rows into a vector of coordinates.
template <class T>
struct Triangles {
    std::int32_t kind = 0, power = 2;
    T ceiling = 0, theta = 0;
    std::int64_t count = 0;
    const std::int32_t* rows[6] = {};
    const T* edges[4] = {};
    const T* map[3] = {};
    const T* each[5] = {};  // the parameter and g11, g12, g22, m, where each triangle has its own
    T all[5][TILE];         // or a tile of the one of all

    Triangles(const TrianglesArgument& given, std::int64_t from, std::int64_t to)
        : kind(given.kind), power(given.power), ceiling(T(given.ceiling)), theta(T(given.theta)), count(to - from) {
        const void* sources[5] = {given.parameter, given.target[0], given.target[1], given.target[2], given.target[3]};
        const std::int64_t strides[5] = {given.parameter_stride, given.target_stride[0], given.target_stride[1],
                                         given.target_stride[2], given.target_stride[3]};
        for (int k = 0; k < 5; ++k) {
            const T* source = static_cast<const T*>(sources[k]);
            if (strides[k])
                each[k] = source + from;
            else
                std::fill_n(all[k], TILE, *source);
        }
        for (int k = 0; k < 6; ++k) rows[k] = given.rows + k * given.count + from;
        for (int k = 0; k < 4; ++k)
            if (given.edges) edges[k] = static_cast<const T*>(given.edges) + k * given.count + from;
        for (int k = 0; k < 3; ++k)
            if (given.map[k]) map[k] = static_cast<const T*>(given.map[k]) + from;
    }

    const T* values(int which, std::int64_t start) const { return each[which] ? each[which] + start : all[which]; }
};

template <class T>
TM_INLINE T clamp_min(T x, T least) {
    return x < least ? least : x;
}

template <class T>
TM_INLINE T whole_power(T x, int power) {
    T result = 1;
    for (; power > 0; power /= 2, x = x * x)
        if (power % 2) result = result * x;
    return result;
}

template <class T, int POWER, bool CEILING>
TM_INLINE void inverse_mean_ratio(Tile<T>& tile, int n, int power, T ceiling, const T* TM_RESTRICT m) {
    const T least = sizeof(T) == 8 ? T(1e-160) : T(1e-30), inverse_ceiling = CEILING ? 1 / ceiling : 0;
    for (int i = 0; i < n; ++i) {
        // A det that is not positive becomes tiny: its phi overflows the line search's test.
        T inverse = 1 / clamp_min(tile.det[i], least);
        T ratio = (tile.stretch[i] * inverse) * T(0.5);
        T lower = POWER == 1 ? T(1) : POWER == 2 ? ratio : whole_power(ratio, power - 1);
        T phi = lower * ratio;
        T half = POWER == 2 ? lower : (T(0.5) * power) * lower;
        if (CEILING) {
            T excess = ratio * inverse_ceiling;
            T fourth = (excess * excess) * (excess * excess), eighth = fourth * fourth;
            phi += eighth;
            half += (4 * eighth) / ratio;
        }
        T slope = half * inverse;
        tile.phi[i] = phi;
        tile.slope[i] = 2 * slope;
        tile.by_area[i] = ((ratio * slope) * T(-2)) * m[i];
    }
}

template <class T>
TM_INLINE void untangle_beta(Tile<T>& tile, int n, const T* TM_RESTRICT beta, const T* TM_RESTRICT m) {
    for (int i = 0; i < n; ++i) {
        T lack = clamp_min(beta[i] - T(0.5) * tile.det[i], T(0));
        tile.phi[i] = lack * lack;
        tile.by_area[i] = -lack * m[i];
    }
}

template <class T>
TM_INLINE void regularised(Tile<T>& tile, int n, T theta, const T* TM_RESTRICT eps, const T* TM_RESTRICT m) {
    for (int i = 0; i < n; ++i) {
        T det = tile.det[i], square = eps[i] * eps[i];
        T root = std::sqrt(square + det * det);
        T large = T(0.5) * (root + std::abs(det));
        T chi = det > 0 ? large : (T(0.25) * square) / large;
        T inverse = 1 / chi;
        T phi = ((1 - theta) * tile.stretch[i] + theta * (1 + det * det)) * inverse;
        tile.phi[i] = phi;
        tile.slope[i] = 2 * ((1 - theta) * inverse);
        tile.by_area[i] = (2 * theta * det * inverse - phi / root) * m[i];
    }
}

template <class T, int KIND, int POWER, bool CEILING>
TM_INLINE void energy_of_tile(Tile<T>& tile, const Triangles<T>& of, std::int64_t start, int n) {
    constexpr bool stretches = KIND != UNTANGLE_BETA;
    const T* TM_RESTRICT parameter = of.values(0, start);
    const T* TM_RESTRICT g11 = of.values(1, start);
    const T* TM_RESTRICT g12 = of.values(2, start);
    const T* TM_RESTRICT g22 = of.values(3, start);
    const T* TM_RESTRICT m = of.values(4, start);
    T *TM_RESTRICT e1x = tile.e[0], *TM_RESTRICT e1y = tile.e[1], *TM_RESTRICT e2x = tile.e[2],
      *TM_RESTRICT e2y = tile.e[3];
    T *TM_RESTRICT f1x = tile.force[0], *TM_RESTRICT f1y = tile.force[1], *TM_RESTRICT f2x = tile.force[2],
      *TM_RESTRICT f2y = tile.force[3];
    for (int i = 0; i < n; ++i) tile.det[i] = (e1x[i] * e2y[i] - e1y[i] * e2x[i]) * m[i];
    if (stretches)
        for (int i = 0; i < n; ++i) {
            f1x[i] = g11[i] * e1x[i] + g12[i] * e2x[i];
            f1y[i] = g11[i] * e1y[i] + g12[i] * e2y[i];
            f2x[i] = g22[i] * e2x[i] + g12[i] * e1x[i];
            f2y[i] = g22[i] * e2y[i] + g12[i] * e1y[i];
            tile.stretch[i] = ((f1x[i] * e1x[i] + f1y[i] * e1y[i]) + f2x[i] * e2x[i]) + f2y[i] * e2y[i];
        }
    if (KIND == INVERSE_MEAN_RATIO)
        inverse_mean_ratio<T, POWER, CEILING>(tile, n, of.power, of.ceiling, m);
    else if (KIND == UNTANGLE_BETA)
        untangle_beta<T>(tile, n, parameter, m);
    else
        regularised<T>(tile, n, of.theta, parameter, m);
    for (int i = 0; i < n; ++i) {
        T by = tile.by_area[i], s = stretches ? tile.slope[i] : T(0);
        f1x[i] = stretches ? f1x[i] * s + by * e2y[i] : by * e2y[i];
        f1y[i] = stretches ? f1y[i] * s - by * e2x[i] : -(by * e2x[i]);
        f2x[i] = stretches ? f2x[i] * s - by * e1y[i] : -(by * e1y[i]);
        f2y[i] = stretches ? f2y[i] * s + by * e1x[i] : by * e1x[i];
    }
}

// A symmetric matrix times each of two vectors, in place.
template <class T>
TM_INLINE void seen(T (*e)[TILE], const T* const* map, std::int64_t start, int n) {
    const T *TM_RESTRICT h11 = map[0] + start, *TM_RESTRICT h12 = map[1] + start, *TM_RESTRICT h22 = map[2] + start;
    for (int side = 0; side < 4; side += 2)
        for (int i = 0; i < n; ++i) {
            T x = e[side][i], y = e[side + 1][i];
            e[side][i] = h11[i] * x + h12[i] * y;
            e[side + 1][i] = h12[i] * x + h22[i] * y;
        }
}

// Adds the gradient to `gradient`; the sum of phi, and the least det.
template <class T, int KIND, int POWER, bool CEILING>
TM_INLINE double add_energy(const Triangles<T>& of, const T* TM_RESTRICT x, T* TM_RESTRICT gradient, double* least) {
    Tile<T> tile;
    double sum[LANES] = {};
    T lowest = std::numeric_limits<T>::infinity();
    const std::int64_t count = of.count;
    const std::int32_t *TM_RESTRICT ax = of.rows[0], *TM_RESTRICT ay = of.rows[1], *TM_RESTRICT bx = of.rows[2],
                       *TM_RESTRICT by = of.rows[3], *TM_RESTRICT cx = of.rows[4], *TM_RESTRICT cy = of.rows[5];
    for (std::int64_t start = 0; start < count; start += TILE) {
        const int n = int(std::min<std::int64_t>(TILE, count - start));
        for (int i = 0; i < n; ++i) {
            const std::int64_t t = start + i;
            T x0 = x[ax[t]], y0 = x[ay[t]];
            tile.e[0][i] = x[bx[t]] - x0;
            tile.e[1][i] = x[by[t]] - y0;
            tile.e[2][i] = x[cx[t]] - x0;
            tile.e[3][i] = x[cy[t]] - y0;
        }
        if (of.edges[0])
            for (int k = 0; k < 4; ++k) {
                const T* TM_RESTRICT edge = of.edges[k] + start;
                for (int i = 0; i < n; ++i) tile.e[k][i] += edge[i];
            }
        if (of.map[0]) seen(tile.e, of.map, start, n);
        energy_of_tile<T, KIND, POWER, CEILING>(tile, of, start, n);
        if (of.map[0]) seen(tile.force, of.map, start, n);
        int i = 0;
        for (; i + LANES <= n; i += LANES)
            for (int k = 0; k < LANES; ++k) sum[k] += double(tile.phi[i + k]);
        for (; i < n; ++i) sum[i % LANES] += double(tile.phi[i]);
        if (least)
            for (int j = 0; j < n; ++j) lowest = !(tile.det[j] >= lowest) ? tile.det[j] : lowest;
        for (int j = 0; j < n; ++j) {
            const std::int64_t t = start + j;
            const T f1x = tile.force[0][j], f1y = tile.force[1][j], f2x = tile.force[2][j], f2y = tile.force[3][j];
            gradient[ax[t]] -= f1x + f2x;
            gradient[ay[t]] -= f1y + f2y;
            gradient[bx[t]] += f1x;
            gradient[by[t]] += f1y;
            gradient[cx[t]] += f2x;
            gradient[cy[t]] += f2y;
        }
    }
    if (least) *least = double(lowest);
    double total = 0;
    for (double part : sum) total += part;
    return total;
}

template <class T>
using Energy = double (*)(const Triangles<T>&, const T*, T*, double*);

// The function above for the energy of these triangles.
template <class T>
Energy<T> energy_for(const Triangles<T>& of);

}  // namespace torchmesh
