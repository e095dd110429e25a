// The order of elimination of small graphs.
#include "dissection.hpp"

namespace torchmesh {
namespace {

// The number of bits that are one.
TM_INLINE Index ones(std::uint64_t x) {
#if defined(__GNUC__)
    return Index(__builtin_popcountll(x));
#else
    x -= (x >> 1) & 0x5555555555555555;
    x = (x & 0x3333333333333333) + ((x >> 2) & 0x3333333333333333);
    return Index((((x + (x >> 4)) & 0x0f0f0f0f0f0f0f0f) * 0x0101010101010101) >> 56);
#endif
}

// The vertices by degree, in lists.
class ByDegree {
  public:
    explicit ByDegree(Index n) : first_(n + 1, -1), before_(n), after_(n), degree_(n, -1) {}

    void put(Index v, Index degree) {
        if (degree_[v] >= 0) take(v);
        degree_[v] = degree;
        before_[v] = -1;
        after_[v] = first_[degree];
        if (first_[degree] >= 0) before_[first_[degree]] = v;
        first_[degree] = v;
        least_ = std::min(least_, degree);
    }

    void take(Index v) {
        (before_[v] >= 0 ? after_[before_[v]] : first_[degree_[v]]) = after_[v];
        if (after_[v] >= 0) before_[after_[v]] = before_[v];
    }

    Index least() {
        while (first_[least_] < 0) ++least_;
        return first_[least_];
    }

    Index degree(Index v) const { return degree_[v]; }

  private:
    std::vector<Index> first_, before_, after_, degree_;
    Index least_ = 0;
};

TM_INLINE void order_vertices(const Graph& of, Index* order) {
    const Index n = of.size;
    const auto words = std::size_t(n + 63) / 64;
    std::vector<std::uint64_t> bits(std::size_t(n) * words, 0);
    std::vector<Index> near, some;
    ByDegree left(n);
    const auto row = [&](Index v) { return bits.data() + std::size_t(v) * words; };
    // A vertex is a neighbour of itself as long as it is there.
    for (Index v = 0; v < n; ++v) {
        row(v)[v / 64] |= std::uint64_t(1) << (v % 64);
        for (Index e = of.offsets[v]; e < of.offsets[v + 1]; ++e)
            row(v)[of.columns[e] / 64] |= std::uint64_t(1) << (of.columns[e] % 64);
        Index degree = 0;
        for (std::size_t k = 0; k < words; ++k) degree += ones(row(v)[k]);
        left.put(v, degree);
    }
    for (Index i = 0; i < n; ++i) {
        const Index v = left.least();
        order[i] = v;
        left.take(v);
        std::uint64_t* own = row(v);
        own[v / 64] &= ~(std::uint64_t(1) << (v % 64));
        near.clear();
        some.clear();
        for (Index k = 0; k < Index(words); ++k) {
            if (own[k]) some.push_back(k);
            for (std::uint64_t rest = own[k]; rest; rest &= rest - 1)
                near.push_back(64 * k + ones((rest & (~rest + 1)) - 1));
        }
        for (const Index u : near) {
            std::uint64_t* to = row(u);
            to[v / 64] &= ~(std::uint64_t(1) << (v % 64));
            Index more = -1;
            for (const Index k : some) {
                more += ones(own[k] & ~to[k]);
                to[k] |= own[k];
            }
            left.put(u, left.degree(u) + more);
        }
    }
}

TM_DISPATCH void ordered_vertices(const Graph& of, Index* order) { order_vertices(of, order); }

}  // namespace

std::vector<Index> minimum_degree(const Graph& of) {
    std::vector<Index> order(std::size_t(of.size));
    ordered_vertices(of, order.data());
    return order;
}

}  // namespace torchmesh
