// Sparse matrices in compressed rows, from entries in any order.
#pragma once

#include "common.hpp"

namespace torchmesh {

struct Entry {
    std::int32_t column;
    double value;
};

// Adds up the entries of a row that have the same column, in the order in which they came: what is left are the first
// entries of each column, in the order of their appearance.
inline std::int64_t gathered(Entry* row, std::int64_t count) {
    // Where the entry of a column is: a table with open addressing, at most half of it in use.
    thread_local std::vector<std::int64_t> place;
    int bits = 4;
    while ((std::int64_t(1) << bits) < 2 * count) ++bits;
    place.assign(std::size_t(1) << bits, -1);
    const std::size_t last = place.size() - 1;
    std::int64_t different = 0;
    for (std::int64_t i = 0; i < count; ++i) {
        const Entry entry = row[i];
        // Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4).
        std::size_t at = (std::uint32_t(entry.column) * 2654435769u) >> (32 - std::min(bits, 32)) & last;
        while (place[at] >= 0 && row[place[at]].column != entry.column) at = (at + 1) & last;
        if (place[at] >= 0) {
            row[place[at]].value += entry.value;
        } else {
            place[at] = different;
            row[different++] = entry;
        }
    }
    return different;
}

// Sorts the entries of a row by column, those of one column in the order in which they came, and adds these up.
inline std::int64_t summed(Entry* row, std::int64_t count) {
    constexpr std::int64_t FEW = 48;
    if (count > FEW) {
        const std::int64_t different = gathered(row, count);
        std::sort(row, row + different, [](const Entry& a, const Entry& b) { return a.column < b.column; });
        return different;
    }
    for (std::int64_t i = 1; i < count; ++i) {
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

    // No entries yet: start[r + 1] is to become the number of those of row r, before `fill`.
    explicit Rows(std::int64_t size) : start(size + 1, 0) {}

    // each(take) calls take(row, column, value) for every entry, each time in the same order.
    template <class Each>
    Rows(std::int64_t size, const Each& each) : Rows(size) {
        each([&](std::int64_t row, std::int64_t, double) { ++start[row + 1]; });
        fill(each);
    }

    template <class Each>
    void fill(const Each& each) {
        for (std::size_t r = 0; r + 1 < start.size(); ++r) start[r + 1] += start[r];
        entries.resize(start.back());
        std::vector<std::int64_t> next(start.begin(), start.end() - 1);
        each([&](std::int64_t row, std::int64_t column, double value) {
            entries[next[row]++] = {std::int32_t(column), value};
        });
    }
};

}  // namespace torchmesh
