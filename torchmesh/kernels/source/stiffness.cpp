// The stiffness matrix of linear elements, cut into the block of the unknown vertices and that of their known neighbours.
#include "rows.hpp"

// The weights of the edges at the unknown vertices: compressed rows, one for each, with the columns in order.  An edge
// has the sum of the weights (count,) that its triangles (count, 3) give it, and none where the sum is 0.  There is
// room for 6 count entries.  The result is their number.
TM_EXPORT std::int64_t tm_edge_weights(const std::int64_t* triangles, std::int64_t count, const double* at_a,
                                       const double* at_b, const double* at_c, const std::uint8_t* known,
                                       std::int64_t vertices, std::int32_t* offsets, std::int32_t* columns,
                                       double* values) {
    using torchmesh::Entry, torchmesh::Rows, torchmesh::summed;
    std::vector<std::int32_t> number(vertices);
    std::int32_t size = 0;
    for (std::int64_t v = 0; v < vertices; ++v) number[v] = known[v] ? -1 : size++;
    const double* weights[3] = {at_a, at_b, at_c};
    const auto edges = [&](bool turned, const auto& take) {
        for (int corner = 0; corner < 3; ++corner) {
            for (std::int64_t t = 0; t < count; ++t) {
                std::int64_t i = triangles[3 * t + (corner + 1) % 3], j = triangles[3 * t + (corner + 2) % 3];
                if (turned) std::swap(i, j);
                if (number[i] >= 0) take(number[i], j, weights[corner][t]);
            }
        }
    };
    Rows ahead(size, [&](const auto& take) { edges(false, take); });
    Rows back(size, [&](const auto& take) { edges(true, take); });
    std::int64_t used = 0;
    offsets[0] = 0;
    for (std::int32_t r = 0; r < size; ++r) {
        Entry *a = ahead.entries.data() + ahead.start[r], *b = back.entries.data() + back.start[r];
        const Entry *a_end = a + summed(a, ahead.start[r + 1] - ahead.start[r]),
                    *b_end = b + summed(b, back.start[r + 1] - back.start[r]);
        while (a < a_end || b < b_end) {
            const bool one = b == b_end || (a < a_end && a->column <= b->column);
            const bool two = a == a_end || (b < b_end && b->column <= a->column);
            const std::int32_t column = one ? a->column : b->column;
            const double value = one && two ? a->value + b->value : one ? a->value : b->value;
            a += one;
            b += two;
            if (value != 0) {
                columns[used] = column;
                values[used++] = value;
            }
        }
        offsets[r + 1] = std::int32_t(used);
    }
    return used;
}

// The blocks K_II, with the diagonal `total` (rows,), and minus K_IB, from the rows of tm_edge_weights: compressed rows
// again, whose columns count the unknown vertices, and the known ones.
TM_EXPORT void tm_split_stiffness(const std::int32_t* offsets, const std::int32_t* columns, const double* values,
                                  std::int64_t rows, const double* total, const std::uint8_t* known,
                                  std::int64_t vertices, std::int32_t* inner_offsets, std::int32_t* inner_columns,
                                  double* inner_values, std::int32_t* outer_offsets, std::int32_t* outer_columns,
                                  double* outer_values) {
    std::vector<std::int32_t> place(vertices);
    std::int32_t unknown = 0, fixed = 0;
    for (std::int64_t v = 0; v < vertices; ++v) place[v] = known[v] ? fixed++ : unknown++;
    std::int32_t in = 0, out = 0;
    inner_offsets[0] = outer_offsets[0] = 0;
    for (std::int32_t r = 0; r < rows; ++r) {
        bool before = true;
        const auto diagonal = [&] {
            before = false;
            if (total[r] == 0) return;
            inner_columns[in] = r;
            inner_values[in++] = total[r];
        };
        for (std::int32_t k = offsets[r]; k < offsets[r + 1]; ++k) {
            const std::int32_t column = place[columns[k]];
            if (known[columns[k]]) {
                outer_columns[out] = column;
                outer_values[out++] = values[k];
            } else {
                if (before && column > r) diagonal();
                inner_columns[in] = column;
                inner_values[in++] = -values[k];
            }
        }
        if (before) diagonal();
        inner_offsets[r + 1] = in;
        outer_offsets[r + 1] = out;
    }
}

// The weights (count,) of the edges opposite the corners of triangles (count, 3), half the cotangents of the angles there,
// as `cotangent_weights` in torchmesh/optimising/laplacian.py.  Where `power` is not 0, each triangle's are multiplied by
// this power of the mean area of its mesh over its own, which counts as at most `stiffest` and at least one over it.
TM_EXPORT void tm_edge_stiffness(const double* points, const std::int64_t* triangles, const std::int64_t* offsets,
                                 std::int64_t meshes, double power, double stiffest, double* at_a, double* at_b,
                                 double* at_c, double* area) {
    for (std::int64_t t = offsets[0]; t < offsets[meshes]; ++t) {
        const double *a = points + 2 * triangles[3 * t], *b = points + 2 * triangles[3 * t + 1],
                     *c = points + 2 * triangles[3 * t + 2];
        const double ux = b[0] - a[0], uy = b[1] - a[1], vx = c[0] - a[0], vy = c[1] - a[1], wx = c[0] - b[0],
                     wy = c[1] - b[1];
        area[t] = 0.5 * (ux * vy - uy * vx);
        const double quarter = 1.0 / (4.0 * area[t]);
        at_a[t] = (ux * vx + uy * vy) * quarter;
        at_b[t] = -(ux * wx + uy * wy) * quarter;
        at_c[t] = (vx * wx + vy * wy) * quarter;
    }
    if (power == 0) return;
    for (std::int64_t m = 0; m < meshes; ++m) {
        double sum = 0;
        for (std::int64_t t = offsets[m]; t < offsets[m + 1]; ++t) sum += area[t];
        const double mean = sum / double(std::max<std::int64_t>(offsets[m + 1] - offsets[m], 1));
        for (std::int64_t t = offsets[m]; t < offsets[m + 1]; ++t) {
            const double ratio = std::min(std::max(mean / area[t], 1 / stiffest), stiffest);
            const double factor = power == 1 ? ratio : std::pow(ratio, power);
            at_a[t] = factor * at_a[t];
            at_b[t] = factor * at_b[t];
            at_c[t] = factor * at_c[t];
        }
    }
}

// The affine displacement of each part that fits the displacement (vertices, 2) of its fixed vertices best, at all its
// vertices, as `affine_fit` in torchmesh/warping/stiffened.py.
TM_EXPORT void tm_affine_fit(const double* points, const std::uint8_t* fixed, const double* displacement,
                             const std::int64_t* offsets, std::int64_t parts, double on_a_line, double* out) {
    for (std::int64_t m = 0; m < parts; ++m) {
        double count = 0, x = 0, y = 0, u = 0, v = 0;
        for (std::int64_t i = offsets[m]; i < offsets[m + 1]; ++i) {
            if (!fixed[i]) continue;
            count += 1;
            x += points[2 * i];
            y += points[2 * i + 1];
            u += displacement[2 * i];
            v += displacement[2 * i + 1];
        }
        count = std::max(count, 1.0);
        x /= count;
        y /= count;
        u /= count;
        v /= count;
        double xx = 0, xy = 0, yy = 0, xu = 0, xv = 0, yu = 0, yv = 0;
        for (std::int64_t i = offsets[m]; i < offsets[m + 1]; ++i) {
            if (!fixed[i]) continue;
            const double px = points[2 * i] - x, py = points[2 * i + 1] - y, du = displacement[2 * i] - u,
                         dv = displacement[2 * i + 1] - v;
            xx += px * px;
            xy += px * py;
            yy += py * py;
            xu += px * du;
            xv += px * dv;
            yu += py * du;
            yv += py * dv;
        }
        const double sum = xx + yy, trace = sum > 0 ? sum : 1.0;
        for (double* moment : {&xx, &xy, &yy, &xu, &xv, &yu, &yv}) *moment /= trace;
        const double determinant = xx * yy - xy * xy, inverse = determinant > on_a_line ? 1.0 / determinant : 0.0;
        const double ux = (yy * xu - xy * yu) * inverse, vx = (yy * xv - xy * yv) * inverse,
                     uy = (xx * yu - xy * xu) * inverse, vy = (xx * yv - xy * xv) * inverse;
        for (std::int64_t i = offsets[m]; i < offsets[m + 1]; ++i) {
            const double px = points[2 * i] - x, py = points[2 * i + 1] - y;
            out[2 * i] = u + px * ux + py * uy;
            out[2 * i + 1] = v + px * vx + py * vy;
        }
    }
}
