// Points paired with points near them: the twin of torchmesh/mesh/matching.py, where it is explained.
#include "common.hpp"

namespace torchmesh {
namespace {

struct Coded {
    std::uint64_t code;
    std::int64_t row;
    bool operator<(const Coded& other) const { return code != other.code ? code < other.code : row < other.row; }
};

// The 26 bits of a number with a zero between each two of them.
std::uint64_t spread_bits(std::uint64_t v) {
    v = (v | (v << 16)) & 0x0000ffff0000ffffu;
    v = (v | (v << 8)) & 0x00ff00ff00ff00ffu;
    v = (v | (v << 4)) & 0x0f0f0f0f0f0f0f0fu;
    v = (v | (v << 2)) & 0x3333333333333333u;
    return (v | (v << 1)) & 0x5555555555555555u;
}

std::vector<Coded> coded(const std::int64_t* squares, std::int64_t count) {
    std::vector<Coded> found(count);
    for (std::int64_t i = 0; i < count; ++i)
        found[i] = {spread_bits(std::uint64_t(squares[2 * i])) | (spread_bits(std::uint64_t(squares[2 * i + 1])) << 1), i};
    std::sort(found.begin(), found.end());
    return found;
}

}  // namespace
}  // namespace torchmesh

// Squares of the finest level are given, (count, 2) each, of `bits` bits; the levels are gone through from `level`
// upwards.  For each of the `goals` the row of the one of `from` that it is paired with is put into `out`.
TM_EXPORT void tm_pairs_nearby(const std::int64_t* from, const std::int64_t* goals, std::int64_t count,
                               std::int64_t bits, std::int64_t level, std::int64_t* out) {
    using namespace torchmesh;
    std::vector<Coded> a = coded(from, count), b = coded(goals, count);
    for (; !a.empty(); --level) {
        const int shift = int(2 * (bits - level));
        std::size_t kept_a = 0, kept_b = 0;
        for (std::size_t i = 0, j = 0; i < a.size() || j < b.size();) {
            const std::uint64_t here_a = i < a.size() ? a[i].code >> shift : ~std::uint64_t(0),
                                here_b = j < b.size() ? b[j].code >> shift : ~std::uint64_t(0);
            if (here_a == here_b) {
                out[b[j++].row] = a[i++].row;
                continue;
            }
            if (here_a < here_b)
                a[kept_a++] = a[i++];
            else
                b[kept_b++] = b[j++];
        }
        a.resize(kept_a);
        b.resize(kept_b);
    }
}
