// From a batch to one vector of unknowns: `pack` of torchmesh/optimising/objective.py, where the layout is drawn.
#include "common.hpp"

namespace torchmesh {
namespace {

// Must have the fields of kernels/packing.py, `_Batch`, in the same order.
struct BatchArgument {
    const double* points;             // (V, 2)
    const std::int64_t* triangles;    // (T, 3)
    const std::uint8_t* free;         // (V,)
    const std::int64_t *point_offsets, *triangle_offsets;  // (B+1,)
    const double *centre, *unit;      // (B, 2) and (B,)
    std::int64_t vertices, meshes, block;
};

// Must have the fields of kernels/packing.py, `_Packing`, in the same order.  What is null is not written.
struct PackingArgument {
    void *unknowns, *anchored;  // double, or zeros of float where edges are given
    std::int32_t* rows;         // (6, K)
    std::int64_t *x_rows, *y_rows, *vertices, *triangles, *point_mesh;
    float* edges;               // (4, K), or null
    std::int64_t size, kept, anchors;
};

struct Place {
    double x, y;
};

Place packed(const BatchArgument& batch, std::int64_t mesh, std::int64_t v) {
    const double unit = batch.unit[mesh];
    return {(batch.points[2 * v] - batch.centre[2 * mesh]) / unit,
            (batch.points[2 * v + 1] - batch.centre[2 * mesh + 1]) / unit};
}

}  // namespace
}  // namespace torchmesh

// Counts free vertices and triangles with a free corner of each mesh (B,), and marks the anchors: the corners of such
// triangles that are not free.  Returns the number of anchors.
TM_EXPORT std::int64_t tm_pack_counts(const torchmesh::BatchArgument* batch, std::int64_t* free_counts,
                                      std::int64_t* kept_counts, std::uint8_t* anchor) {
    std::int64_t anchors = 0;
    for (std::int64_t b = 0; b < batch->meshes; ++b) {
        std::int64_t count = 0;
        for (std::int64_t v = batch->point_offsets[b]; v < batch->point_offsets[b + 1]; ++v) count += batch->free[v] != 0;
        free_counts[b] = count;
        count = 0;
        for (std::int64_t t = batch->triangle_offsets[b]; t < batch->triangle_offsets[b + 1]; ++t) {
            const std::int64_t* corner = batch->triangles + 3 * t;
            if (!(batch->free[corner[0]] || batch->free[corner[1]] || batch->free[corner[2]])) continue;
            ++count;
            for (int k = 0; k < 3; ++k)
                if (!batch->free[corner[k]] && !anchor[corner[k]]) {
                    anchor[corner[k]] = 1;
                    ++anchors;
                }
        }
        kept_counts[b] = count;
    }
    return anchors;
}

TM_EXPORT void tm_pack(const torchmesh::BatchArgument* batch, const std::int64_t* block_offsets,
                       const std::uint8_t* anchor, const torchmesh::PackingArgument* out) {
    using namespace torchmesh;
    std::vector<std::int32_t> row_x(static_cast<std::size_t>(batch->vertices)), row_y(row_x.size());
    const std::int64_t size = out->size;
    std::int64_t free = 0, ordinal = 0, kept = 0;
    for (std::int64_t b = 0; b < batch->meshes; ++b) {
        const std::int64_t first = block_offsets[b] * batch->block,
                           half = (block_offsets[b + 1] - block_offsets[b]) / 2 * batch->block;
        std::int64_t own = 0;
        for (std::int64_t v = batch->point_offsets[b]; v < batch->point_offsets[b + 1]; ++v) {
            if (batch->free[v]) {
                const std::int64_t x = first + own++, y = x + half;
                row_x[v] = std::int32_t(x), row_y[v] = std::int32_t(y);
                out->x_rows[free] = x, out->y_rows[free] = y;
                out->vertices[free] = v, out->point_mesh[free++] = b;
                if (out->edges) continue;
                const Place p = packed(*batch, b, v);
                static_cast<double*>(out->unknowns)[x] = p.x, static_cast<double*>(out->unknowns)[y] = p.y;
            } else if (anchor[v]) {
                row_x[v] = std::int32_t(size + ordinal), row_y[v] = std::int32_t(size + out->anchors + ordinal);
                if (!out->edges) {
                    const Place p = packed(*batch, b, v);
                    static_cast<double*>(out->anchored)[ordinal] = p.x;
                    static_cast<double*>(out->anchored)[out->anchors + ordinal] = p.y;
                }
                ++ordinal;
            }
        }
        for (std::int64_t t = batch->triangle_offsets[b]; t < batch->triangle_offsets[b + 1]; ++t) {
            const std::int64_t* corner = batch->triangles + 3 * t;
            if (!(batch->free[corner[0]] || batch->free[corner[1]] || batch->free[corner[2]])) continue;
            for (int k = 0; k < 3; ++k) {
                out->rows[(2 * k) * out->kept + kept] = row_x[corner[k]];
                out->rows[(2 * k + 1) * out->kept + kept] = row_y[corner[k]];
            }
            if (out->edges) {
                const Place a = packed(*batch, b, corner[0]);
                for (int k = 1; k < 3; ++k) {
                    const Place p = packed(*batch, b, corner[k]);
                    out->edges[(2 * k - 2) * out->kept + kept] = float(p.x - a.x);
                    out->edges[(2 * k - 1) * out->kept + kept] = float(p.y - a.y);
                }
            }
            out->triangles[kept++] = t;
        }
    }
}

// The root mean square edge length round each vertex, 0 for unused ones: `vertex_size` of torchmesh/mesh/means.py.
TM_EXPORT void tm_vertex_size(const double* points, const std::int64_t* triangles, std::int64_t count,
                              std::int64_t vertices, double* size) {
    // As in torch, every first corner is added before every second one, and these before the third ones.
    std::vector<double> lengths(static_cast<std::size_t>(3 * count));
    std::vector<std::int64_t> number(static_cast<std::size_t>(vertices), 0);
    std::fill_n(size, vertices, 0.0);
    for (std::int64_t t = 0; t < count; ++t)
        for (int k = 0; k < 3; ++k) {
            const std::int64_t u = triangles[3 * t + k], w = triangles[3 * t + (k + 1) % 3];
            const double x = points[2 * w] - points[2 * u], y = points[2 * w + 1] - points[2 * u + 1];
            lengths[3 * t + k] = x * x + y * y;
            ++number[u];
        }
    constexpr int FIRST[3] = {0, 0, 1}, SECOND[3] = {2, 1, 2};  // ab + ca, ab + bc, bc + ca
    for (int k = 0; k < 3; ++k)
        for (std::int64_t t = 0; t < count; ++t)
            size[triangles[3 * t + k]] += lengths[3 * t + FIRST[k]] + lengths[3 * t + SECOND[k]];
    for (std::int64_t v = 0; v < vertices; ++v)
        size[v] = std::sqrt(size[v] / double(2 * std::max<std::int64_t>(number[v], 1)));
}

// The middle of each mesh's bounding box (B, 2), and the power of two at or below its half extent (B,).
TM_EXPORT void tm_centre_and_unit(const double* points, const std::int64_t* offsets, std::int64_t meshes,
                                  double* centre, double* unit) {
    for (std::int64_t b = 0; b < meshes; ++b) {
        double extent = 0;
        bool odd = false;
        for (int axis = 0; axis < 2; ++axis) {
            double low = std::numeric_limits<double>::infinity(), high = -low;
            for (std::int64_t v = offsets[b]; v < offsets[b + 1]; ++v) {
                const double value = points[2 * v + axis];
                odd |= std::isnan(value);
                low = value < low ? value : low;
                high = value > high ? value : high;
            }
            const double half = odd ? std::nan("") : 0.5 * high - 0.5 * low;
            centre[2 * b + axis] = low + half;
            extent = half > extent ? half : extent;
        }
        int exponent;
        std::frexp(extent, &exponent);
        unit[b] = !odd && extent > 0 && std::isfinite(extent) ? std::ldexp(1.0, exponent - 1) : 1.0;
    }
}

namespace torchmesh {
namespace {

// The value of each free vertex in the rows of both its coordinates.
template <class Real>
void scatter(const double* values, const std::int64_t* vertices, const std::int64_t* x_rows, const std::int64_t* y_rows,
             std::int64_t count, Real* out) {
    for (std::int64_t i = 0; i < count; ++i) out[x_rows[i]] = out[y_rows[i]] = Real(values[vertices[i]]);
}

// The free vertices where the unknowns say, in `points` (V, 2); those whose unknowns stayed keep their digits.
template <class Real>
void unpack(const Real* before, const Real* now, const std::int64_t* vertices, const std::int64_t* x_rows,
            const std::int64_t* y_rows, const std::int64_t* mesh, const double* centre, const double* unit,
            bool displacements, std::int64_t count, double* points) {
    for (std::int64_t i = 0; i < count; ++i)
        for (int axis = 0; axis < 2; ++axis) {
            const std::int64_t row = (axis ? y_rows : x_rows)[i];
            if (now[row] == before[row]) continue;
            double& at = points[2 * vertices[i] + axis];
            at = (displacements ? at : centre[2 * mesh[i] + axis]) + double(now[row]) * unit[mesh[i]];
        }
}

}  // namespace
}  // namespace torchmesh

#define TM_SCATTER(name, Real)                                                                                    \
    TM_EXPORT void name(const double* values, const std::int64_t* vertices, const std::int64_t* x_rows,           \
                        const std::int64_t* y_rows, std::int64_t count, Real* out) {                              \
        torchmesh::scatter(values, vertices, x_rows, y_rows, count, out);                                         \
    }
#define TM_UNPACK(name, Real)                                                                                     \
    TM_EXPORT void name(const Real* before, const Real* now, const std::int64_t* vertices,                        \
                        const std::int64_t* x_rows, const std::int64_t* y_rows, const std::int64_t* mesh,         \
                        const double* centre, const double* unit, int displacements, std::int64_t count,          \
                        double* points) {                                                                         \
        torchmesh::unpack(before, now, vertices, x_rows, y_rows, mesh, centre, unit, displacements != 0, count,   \
                          points);                                                                                \
    }
TM_SCATTER(tm_scatter, double)
TM_SCATTER(tm_scatter_single, float)
TM_UNPACK(tm_unpack, double)
TM_UNPACK(tm_unpack_single, float)
