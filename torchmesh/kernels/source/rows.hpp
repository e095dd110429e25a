// Sparse matrices in compressed rows, from entries in any order.
#pragma once

#include "common.hpp"

namespace torchmesh {

struct Entry {
    std::int32_t column;
    double value;
};

// Sorts the entries of a row by column, those of one column in the order in which they came, and adds these up.
inline std::int64_t summed(Entry* row, std::int64_t count) {
    constexpr std::int64_t FEW = 48;
    if (count > FEW)
        std::stable_sort(row, row + count, [](const Entry& a, const Entry& b) { return a.column < b.column; });
    for (std::int64_t i = 1; count <= FEW && i < count; ++i) {
        const Entry entry = row[i];
        std::int64_t k = i;
        for (; k > 0 && row[k - 1].column > entry.column; --k) row[k] = row[k - 1];
        row[k] = entry;
    }
    std::int64_t last = 0;
    for (std::int64_t i = 1; i < count; ++i) {
        if (row[i].column == row[last].column)
            row[last].value += row[i].value;
        else
            row[++last] = row[i];
    }
    return count ? last + 1 : 0;
}

// Compressed rows of entries that come in any order, for the rows whose number is not negative.
struct Rows {
    std::vector<std::int64_t> start;
    std::vector<Entry> entries;

    // each(take) calls take(row, column, value) for every entry, each time in the same order.
    template <class Each>
    Rows(std::int64_t size, const Each& each) : start(size + 1, 0) {
        each([&](std::int64_t row, std::int64_t, double) { ++start[row + 1]; });
        for (std::int64_t r = 0; r < size; ++r) start[r + 1] += start[r];
        entries.resize(start[size]);
        std::vector<std::int64_t> next(start.begin(), start.end() - 1);
        each([&](std::int64_t row, std::int64_t column, double value) {
            entries[next[row]++] = {std::int32_t(column), value};
        });
    }
};

}  // namespace torchmesh
