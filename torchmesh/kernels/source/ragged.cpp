// Loops over the rows of many meshes that lie end to end: found, taken, put, spread and counted.
#include <cstring>

#include "common.hpp"

namespace torchmesh {
namespace {

// Calls task(width) with the number of bytes of a row, as a constant where rows have a usual size.
template <class Task>
void for_width(std::int64_t width, const Task& task) {
    switch (width) {
        case 1: return task(std::integral_constant<std::int64_t, 1>());
        case 4: return task(std::integral_constant<std::int64_t, 4>());
        case 8: return task(std::integral_constant<std::int64_t, 8>());
        case 16: return task(std::integral_constant<std::int64_t, 16>());
        case 24: return task(std::integral_constant<std::int64_t, 24>());
        default: return task(width);
    }
}

bool within(const std::int64_t* rows, std::int64_t count, std::int64_t size) {
    bool all = true;
    for (std::int64_t i = 0; i < count; ++i) all &= std::uint64_t(rows[i]) < std::uint64_t(size);
    return all;
}

}  // namespace
}  // namespace torchmesh

TM_EXPORT TM_DISPATCH std::int64_t tm_count_true(const std::uint8_t* flags, std::int64_t size) {
    std::int64_t count = 0;
    for (std::int64_t i = 0; i < size; ++i) count += flags[i];
    return count;
}

// The rows whose flag is set; `out` has room for these and one more.
TM_EXPORT void tm_true_rows(const std::uint8_t* flags, std::int64_t size, std::int64_t* out) {
    constexpr std::int64_t WORD = 8;
    std::int64_t i = 0;
    // Without a branch a flag: where flags are set at random, half of all guesses would be wrong.
    for (; i + WORD <= size; i += WORD) {
        std::uint64_t word;
        std::memcpy(&word, flags + i, WORD);
        if (word == 0) continue;
        for (std::int64_t k = 0; k < WORD; ++k) {
            *out = i + k;
            out += flags[i + k];
        }
    }
    for (; i < size; ++i) {
        *out = i;
        out += flags[i];
    }
}

// The rows (count,) of values (size, width bytes); false, and nothing taken, if one of them is not there.
TM_EXPORT bool tm_take(const char* values, std::int64_t size, std::int64_t width, const std::int64_t* rows,
                       std::int64_t count, char* out) {
    if (!torchmesh::within(rows, count, size)) return false;
    torchmesh::for_width(width, [&](auto bytes) {
        for (std::int64_t i = 0; i < count; ++i) std::memcpy(out + i * bytes, values + rows[i] * bytes, bytes);
    });
    return true;
}

// Writes part (count, width bytes) to the rows (count,) of values; false, and nothing written, if one is not there.
TM_EXPORT bool tm_put(char* values, std::int64_t size, std::int64_t width, const std::int64_t* rows,
                      std::int64_t count, const char* part) {
    if (!torchmesh::within(rows, count, size)) return false;
    torchmesh::for_width(width, [&](auto bytes) {
        for (std::int64_t i = 0; i < count; ++i) std::memcpy(values + rows[i] * bytes, part + i * bytes, bytes);
    });
    return true;
}

// Copies the value of each mesh (meshes, width bytes) to its rows.
TM_EXPORT void tm_spread(const char* values, std::int64_t width, const std::int64_t* offsets, std::int64_t meshes,
                         char* out) {
    torchmesh::for_width(width, [&](auto bytes) {
        for (std::int64_t b = 0; b < meshes; ++b)
            for (std::int64_t i = offsets[b]; i < offsets[b + 1]; ++i)
                std::memcpy(out + i * bytes, values + b * bytes, bytes);
    });
}

// How many rows the `chosen` meshes have.
TM_EXPORT std::int64_t tm_count_of_each(const std::int64_t* chosen, std::int64_t count, const std::int64_t* offsets) {
    std::int64_t rows = 0;
    for (std::int64_t i = 0; i < count; ++i) rows += offsets[chosen[i] + 1] - offsets[chosen[i]];
    return rows;
}

// The rows of the `chosen` meshes, one mesh after the other.
TM_EXPORT void tm_rows_of_each(const std::int64_t* chosen, std::int64_t count, const std::int64_t* offsets,
                               std::int64_t* out) {
    for (std::int64_t i = 0; i < count; ++i)
        for (std::int64_t row = offsets[chosen[i]]; row < offsets[chosen[i] + 1]; ++row) *out++ = row;
}

// Adds the shift of each mesh to the numbers in its rows, of `width` numbers each; negative numbers stay.
TM_EXPORT TM_DISPATCH void tm_shifted(const std::int64_t* numbers, std::int64_t width, const std::int64_t* by,
                                      const std::int64_t* offsets, std::int64_t meshes, std::int64_t* out) {
    for (std::int64_t b = 0; b < meshes; ++b)
        for (std::int64_t i = width * offsets[b]; i < width * offsets[b + 1]; ++i)
            out[i] = numbers[i] < 0 ? numbers[i] : numbers[i] + by[b];
}

// How many flags are set in each mesh.
TM_EXPORT TM_DISPATCH void tm_segment_count(const std::uint8_t* flags, const std::int64_t* offsets,
                                            std::int64_t meshes, std::int64_t* out) {
    for (std::int64_t b = 0; b < meshes; ++b) {
        std::int64_t count = 0;
        for (std::int64_t i = offsets[b]; i < offsets[b + 1]; ++i) count += flags[i];
        out[b] = count;
    }
}

// The triangles that have a corner among the vertices whose flag is set.
TM_EXPORT void tm_touching(const std::int64_t* triangles, std::int64_t count, const std::uint8_t* flags,
                           std::uint8_t* out) {
    for (std::int64_t t = 0; t < count; ++t)
        out[t] = flags[triangles[3 * t]] | flags[triangles[3 * t + 1]] | flags[triangles[3 * t + 2]];
}

// Sets the flags of the corners of `these` triangles.
TM_EXPORT void tm_corners_of(const std::int64_t* triangles, std::int64_t count, const std::uint8_t* these,
                             std::uint8_t* out) {
    for (std::int64_t t = 0; t < count; ++t)
        if (these[t])
            for (std::int64_t k = 3 * t; k < 3 * t + 3; ++k) out[triangles[k]] = 1;
}

// The mean of each triangle's corners.
TM_EXPORT void tm_means_of_corners(const std::int64_t* triangles, std::int64_t count, const double* values,
                                   double* out) {
    for (std::int64_t t = 0; t < count; ++t)
        out[t] = (values[triangles[3 * t]] + values[triangles[3 * t + 1]] + values[triangles[3 * t + 2]]) / 3;
}

// The mean of the triangles round each vertex, 0 for a vertex without any; `number` counts them, and is at least 1.
TM_EXPORT void tm_means_round_vertices(const std::int64_t* triangles, std::int64_t count, const double* values,
                                       const std::int64_t* number, std::int64_t vertices, double* out) {
    std::fill(out, out + vertices, 0.0);
    for (int corner = 0; corner < 3; ++corner)
        for (std::int64_t t = 0; t < count; ++t) out[triangles[3 * t + corner]] += values[t];
    for (std::int64_t v = 0; v < vertices; ++v) out[v] /= double(number[v]);
}
