// The coordinates that one mesh of many needs, as a vector of its own.
#pragma once

#include "common.hpp"

namespace torchmesh {

// Rows of triangles into a mesh's own coordinates: its n unknowns, then what it needs of the anchored ones.
struct OwnRows {
    std::vector<std::int32_t> rows;  // (6, count)
    std::int64_t low[2], extra[2];   // of the anchored x and y: the first that is needed, and how many

    // given   (6, count) rows into the unknowns of all meshes, `size` in number, followed by all anchored coordinates
    // first   the mesh's first unknown
    OwnRows(const std::int32_t* const* given, std::int64_t count, std::int64_t first, std::int64_t n,
            std::int64_t size) {
        // The anchored coordinates of one mesh stand together, those of x and those of y.
        std::int64_t high[2] = {0, 0};
        low[0] = low[1] = std::numeric_limits<std::int64_t>::max();
        rows.resize(std::size_t(6 * count));
        for (int k = 0; k < 6; ++k)
            for (std::int64_t t = 0; t < count; ++t) {
                const std::int64_t row = given[k][t] - size;
                if (row < 0) continue;
                low[k % 2] = std::min(low[k % 2], row);
                high[k % 2] = std::max(high[k % 2], row + 1);
            }
        for (int axis = 0; axis < 2; ++axis) extra[axis] = std::max<std::int64_t>(0, high[axis] - low[axis]);
        for (int k = 0; k < 6; ++k) {
            const std::int64_t shift = n + (k % 2 ? extra[0] : 0) - (high[k % 2] ? low[k % 2] : 0);
            for (std::int64_t t = 0; t < count; ++t) {
                const std::int64_t row = given[k][t];
                rows[std::size_t(k * count + t)] = std::int32_t(row < size ? row - first : row - size + shift);
            }
        }
    }

    std::int64_t anchored() const { return extra[0] + extra[1]; }

    // Writes the anchored coordinates that the mesh needs, which follow its unknowns.
    template <class T>
    void copy_anchored(const T* from, T* to) const {
        for (int axis = 0; axis < 2; ++axis)
            for (std::int64_t i = 0; i < extra[axis]; ++i) *to++ = from[low[axis] + i];
    }
};

}  // namespace torchmesh
