// Direct solution of the sparse symmetric systems of many meshes: K = L D L^T, each in an order of its own.
//
// The order is by nested dissection.  The rows of L follow from the elimination tree (Davis, Direct methods for sparse
// linear systems, SIAM, 2006, chapter 4).  There are no pivots: the matrices are those of Laplacians.
#include "dissection.hpp"

#include <array>
#include <memory>
#include <mutex>
#include <tuple>

namespace torchmesh {
namespace {

// A square symmetric matrix in compressed rows; `first` is taken off the columns.
struct Matrix {
    const Index* offsets;
    const Index* columns;
    const double* values;
    Index size;
};

// What the factors of a matrix owe to its pattern alone.
struct Analysis {
    std::vector<Index> offsets, columns;  // the pattern
    std::vector<Index> order, number;     // number[order[i]] = i
    std::vector<std::int64_t> start;      // column j of L has the entries start[j] ... start[j + 1] - 1
    std::vector<Index> rows;              // their rows
    std::vector<std::int64_t> reached;    // row i of L has the entries reached[i] ... reached[i + 1] - 1
    std::vector<Index> pattern;           // their columns, each after those that it depends on
    std::vector<Index> last;              // the last column of the supernode of each: below it, all have the same rows

    explicit Analysis(const Matrix& k)
        : offsets(k.offsets, k.offsets + k.size + 1), columns(k.columns, k.columns + k.offsets[k.size]),
          order(Dissection({k.offsets, k.columns, k.size}).order()), number(k.size), start(k.size + 1, 0), reached(k.size + 1, 0) {
        const Index n = k.size;
        for (Index i = 0; i < n; ++i) number[order[i]] = i;
        std::vector<Index> parent(n, -1), mark(n, -1), way(n), row(n);
        pattern.reserve(16 * std::size_t(n));
        // Row i of L has an entry in each column from which the elimination tree leads up to i from one of row i of K.
        for (Index i = 0; i < n; ++i) {
            Index top = n;
            mark[i] = i;
            for (Index e = offsets[order[i]]; e < offsets[order[i] + 1]; ++e) {
                Index j = number[columns[e]], length = 0;
                if (j > i) continue;
                for (; mark[j] != i; j = parent[j]) {
                    if (parent[j] < 0) parent[j] = i;
                    way[length++] = j;
                    mark[j] = i;
                    ++start[j + 1];
                }
                while (length > 0) row[--top] = way[--length];
            }
            pattern.insert(pattern.end(), row.begin() + top, row.end());
            reached[i + 1] = std::int64_t(pattern.size());
        }
        last.resize(n);
        for (Index j = n; j-- > 0;) {
            const bool same = parent[j] == j + 1 && start[j + 1] == start[j + 2] + 1;
            last[j] = same ? last[j + 1] : j;
        }
        for (Index i = 0; i < n; ++i) start[i + 1] += start[i];
        rows.resize(pattern.size());
        std::vector<std::int64_t> next(start.begin(), start.end() - 1);
        for (Index i = 0; i < n; ++i)
            for (std::int64_t r = reached[i]; r < reached[i + 1]; ++r) rows[next[pattern[r]]++] = i;
    }

    bool fits(const Matrix& k) const {
        return Index(order.size()) == k.size && std::equal(offsets.begin(), offsets.end(), k.offsets) &&
               std::equal(columns.begin(), columns.end(), k.columns);
    }
};

using Analysed = std::shared_ptr<const Analysis>;

// In the time loop of a simulation a mesh has the same pattern in each step: that of the last matrix is kept.
class Last {
  public:
    // Matrices of more rows are not kept, so that what is kept has a few megabytes at most.
    static constexpr Index ROWS = 20000;

    Analysed of(const Matrix& k) {
        if (k.size > ROWS) return std::make_shared<Analysis>(k);
        Analysed found = get();
        if (found && found->fits(k)) return found;
        found = std::make_shared<Analysis>(k);
        const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
        if (lock) kept_ = found;
        return found;
    }

  private:
    Analysed get() {
        // Nobody waits: a process that is forked while a thread holds the lock would wait for ever.
        const std::unique_lock<std::mutex> lock(mutex_, std::try_to_lock);
        return lock ? kept_ : nullptr;
    }

    std::mutex mutex_;
    Analysed kept_;
};

Last last_analysis;

// So many columns of a supernode eliminate a row at once.
constexpr std::int64_t WIDEST = 8;

// The factors of one mesh.
struct Factors {
    Analysed analysed;
    std::vector<double> lower, diagonal;
    bool singular = false;

    Factors(const Matrix& k, Analysed of) : analysed(std::move(of)), lower(analysed->rows.size()), diagonal(k.size) {
        const Analysis& a = *analysed;
        std::vector<double> y(k.size, 0.0);
        std::vector<std::int64_t> end(a.start.begin(), a.start.end() - 1);
        // Row by row: L_i D y = K_i, over the columns that the tree reaches from the entries of K_i.
        for (Index i = 0; i < k.size; ++i) {
            for (Index e = k.offsets[a.order[i]]; e < k.offsets[a.order[i] + 1]; ++e) {
                const Index j = a.number[k.columns[e]];
                if (j <= i) y[j] += k.values[e];
            }
            double pivot = y[i];
            y[i] = 0;
            for (std::int64_t r = a.reached[i]; r < a.reached[i + 1];) {
                const Index j = a.pattern[r];
                const std::int64_t most = std::min<std::int64_t>({a.last[j] - j + 1, a.reached[i + 1] - r, WIDEST});
                Index count = 1;
                while (count < most && a.pattern[r + count] == j + count) ++count;
                count = count == WIDEST ? WIDEST : count >= 4 ? 4 : count >= 2 ? 2 : 1;
                const auto eliminate = count == WIDEST ? &Factors::eliminated<WIDEST>
                                       : count == 4    ? &Factors::eliminated<4>
                                       : count == 2    ? &Factors::eliminated<2>
                                                       : &Factors::eliminated<1>;
                pivot = (this->*eliminate)(j, y.data(), end.data(), pivot);
                r += count;
            }
            diagonal[i] = pivot;
            if (pivot == 0) {
                singular = true;
                return;
            }
        }
    }

    // Eliminates the row y by COUNT columns of a supernode, from j on, of which end[j] is the end of what is known of
    // column j, and gives back what is left of the pivot of the row.  Each number of y is what it is when the columns
    // come one by one: it is only read and written once for all.
    template <Index COUNT>
    double eliminated(Index j, double* y, std::int64_t* end, double pivot) {
        const Analysis& a = *analysed;
        double value[COUNT];
        const double* column[COUNT];
        for (Index c = 0; c < COUNT; ++c) {
            value[c] = y[j + c];
            for (Index d = 0; d < c; ++d) value[c] -= column[d][c - d - 1] * value[d];
            y[j + c] = 0;
            column[c] = lower.data() + a.start[j + c];
        }
        const std::int64_t length = end[j] - a.start[j] - (COUNT - 1);
        const Index* rows = a.rows.data() + a.start[j] + (COUNT - 1);
        for (Index c = 0; c < COUNT; ++c) column[c] += COUNT - 1 - c;
        for (std::int64_t p = 0; p < length; ++p) {
            double sum = y[rows[p]];
            for (Index c = 0; c < COUNT; ++c) sum -= column[c][p] * value[c];
            y[rows[p]] = sum;
        }
        for (Index c = 0; c < COUNT; ++c) {
            const double entry = value[c] / diagonal[j + c];
            pivot -= entry * value[c];
            lower[end[j + c]++] = entry;
        }
        return pivot;
    }

    // x = K^-1 b for `columns` right-hand sides, both (size, columns).
    void solve(const double* b, Index columns, double* x) const {
        Index c = 0;
        for (; c + 1 < columns; c += 2) solve_some<2>(b + c, columns, x + c);
        if (c < columns) solve_some<1>(b + c, columns, x + c);
    }

    // The same for the first COUNT of these columns.
    template <Index COUNT>
    void solve_some(const double* b, Index columns, double* x) const {
        using Row = std::array<double, COUNT>;
        const auto& [order, start, rows] = std::tie(analysed->order, analysed->start, analysed->rows);
        const Index n = Index(order.size());
        std::vector<Row> y(n);
        for (Index i = 0; i < n; ++i)
            for (Index c = 0; c < COUNT; ++c) y[i][c] = b[std::int64_t(order[i]) * columns + c];
        for (Index j = 0; j < n; ++j) {
            const Row value = y[j];
            for (std::int64_t p = start[j]; p < start[j + 1]; ++p)
                for (Index c = 0; c < COUNT; ++c) y[rows[p]][c] -= lower[p] * value[c];
        }
        for (Index j = n; j-- > 0;) {
            Row sum = y[j];
            for (Index c = 0; c < COUNT; ++c) sum[c] /= diagonal[j];
            for (std::int64_t p = start[j]; p < start[j + 1]; ++p)
                for (Index c = 0; c < COUNT; ++c) sum[c] -= lower[p] * y[rows[p]][c];
            y[j] = sum;
        }
        for (Index i = 0; i < n; ++i)
            for (Index c = 0; c < COUNT; ++c) x[std::int64_t(order[i]) * columns + c] = y[i][c];
    }
};

struct Systems {
    std::vector<std::int64_t> first;
    std::vector<Factors*> factors;
    ~Systems() {
        for (Factors* one : factors) delete one;
    }
};

}  // namespace
}  // namespace torchmesh

// Factorises the blocks of `meshes` meshes, whose rows are first[m] ... last[m] - 1 of the compressed rows.  singular[m]
// says which have none.  The result is for the functions below.
TM_EXPORT void* tm_factorise(const std::int32_t* offsets, const std::int32_t* columns, const double* values,
                             const std::int64_t* first, const std::int64_t* last, std::int64_t meshes, int threads,
                             std::uint8_t* singular) {
    using namespace torchmesh;
    auto* systems = new Systems{{first, first + meshes}, std::vector<Factors*>(meshes, nullptr)};
    in_threads(meshes, threads, [&](std::int64_t m) {
        const std::int32_t begin = offsets[first[m]], size = std::int32_t(last[m] - first[m]);
        std::vector<std::int32_t> own(size + 1), inside(offsets[last[m]] - begin);
        for (std::int32_t i = 0; i <= size; ++i) own[i] = offsets[first[m] + i] - begin;
        for (std::size_t i = 0; i < inside.size(); ++i) inside[i] = columns[begin + i] - std::int32_t(first[m]);
        const Matrix k{own.data(), inside.data(), values + begin, size};
        systems->factors[m] = new Factors(k, meshes == 1 ? last_analysis.of(k) : std::make_shared<Analysis>(k));
        singular[m] = systems->factors[m]->singular;
    });
    return systems;
}

// Puts the solutions for the right-hand sides (rows, columns) into the rows of the meshes.
TM_EXPORT void tm_solve_factorised(const void* handle, const double* right, std::int32_t columns, int threads,
                                   double* out) {
    using namespace torchmesh;
    const auto& systems = *static_cast<const Systems*>(handle);
    in_threads(std::int64_t(systems.factors.size()), threads, [&](std::int64_t m) {
        const std::int64_t at = systems.first[m] * columns;
        systems.factors[m]->solve(right + at, columns, out + at);
    });
}

TM_EXPORT void tm_end_factorised(void* handle) { delete static_cast<torchmesh::Systems*>(handle); }
