// Direct solution of the sparse symmetric systems of many meshes: K = L D L^T, each in an order of its own.
//
// The order is by nested dissection (George, Nested dissection of a regular finite element mesh, SIAM Journal on
// Numerical Analysis 10, 1973), with the separators of level structures from a vertex at the end of the graph (George &
// Liu, An automatic nested dissection algorithm for irregular finite element problems, SIAM Journal on Numerical
// Analysis 15, 1978).  The rows of L follow from the elimination tree (Davis, Direct methods for sparse linear systems,
// SIAM, 2006, chapter 4).  There are no pivots: the matrices are those of Laplacians.
#include "common.hpp"

namespace torchmesh {
namespace {

using Index = std::int32_t;

// A square symmetric matrix in compressed rows; `first` is taken off the columns.
struct Matrix {
    const Index* offsets;
    const Index* columns;
    const double* values;
    Index size;
};

// Parts of so many vertices are not cut any more.
constexpr Index WHOLE = 12;

class Dissection {
  public:
    explicit Dissection(const Matrix& k) : k_(k), level_(k.size, 0), order_(k.size), set_(k.size) {
        for (Index v = 0; v < k.size; ++v) set_[v] = v;
        tasks_.push_back({0, k.size, k.size});
    }

    // order[i] is the vertex that is eliminated as number i.
    std::vector<Index> order() {
        while (!tasks_.empty()) {
            const Task task = tasks_.back();
            tasks_.pop_back();
            cut(task);
        }
        return std::move(order_);
    }

  private:
    // The vertices set_[begin ... end) are eliminated as the numbers before `last`.
    struct Task {
        Index begin, end, last;
    };

    // Adds to `reached_` the vertices of the part that can be reached from `from`, level by level.  Those that were not
    // reached yet have levels from `low` to `zero_` - 1, and get levels from `zero_` on.
    void levels(Index from, Index low) {
        std::size_t next = reached_.size();
        reached_.push_back(from);
        level_[from] = zero_;
        for (; next < reached_.size(); ++next) {
            const Index v = reached_[next], deeper = level_[v] + 1;
            for (Index e = k_.offsets[v]; e < k_.offsets[v + 1]; ++e) {
                const Index w = k_.columns[e];
                if (level_[w] < low || level_[w] >= zero_) continue;
                level_[w] = deeper;
                reached_.push_back(w);
            }
        }
    }

    // Makes each component of the task a task, if there are several.  Otherwise `reached_` has all vertices.
    bool apart(const Task& task) {
        // No vertex of another part has a level as high as this.
        const Index low = zero_++;
        for (Index i = task.begin; i < task.end; ++i) level_[set_[i]] = low;
        std::vector<Index> ends;
        reached_.clear();
        for (Index i = task.begin; i < task.end; ++i) {
            if (level_[set_[i]] != low) continue;
            levels(set_[i], low);
            ends.push_back(Index(reached_.size()));
        }
        low_ = low + 1;
        zero_ = top() + 1;
        if (ends.size() == 1) return false;
        std::copy(reached_.begin(), reached_.end(), set_.begin() + task.begin);
        for (std::size_t i = 0; i < ends.size(); ++i) {
            const Index begin = i ? ends[i - 1] : 0, after = task.end - task.begin - ends[i];
            tasks_.push_back({task.begin + begin, task.begin + ends[i], task.last - after});
        }
        return true;
    }

    // The highest level that was given.
    Index top() const {
        Index most = zero_;
        for (const Index v : reached_) most = std::max(most, level_[v]);
        return most;
    }

    void cut(const Task& task) {
        const Index count = task.end - task.begin;
        if (count <= WHOLE) {
            for (Index i = 0; i < count; ++i) order_[task.last - count + i] = set_[task.begin + i];
            return;
        }
        if (apart(task)) return;
        const Index far_end = reached_.back();
        reached_.clear();
        levels(far_end, low_);
        // The level at which half of the vertices are passed is the separator, but for its vertices that have no
        // neighbour in the next one.
        const Index half = level_[reached_[count / 2]], deepest = level_[reached_.back()];
        zero_ = deepest + 1;
        if (half == deepest && half <= level_[far_end] + 1) {
            std::copy(reached_.begin(), reached_.end(), order_.begin() + (task.last - count));
            return;
        }
        const Index at = half == deepest ? half - 1 : half;
        Index near = task.begin, far = task.end, last = task.last;
        for (const Index v : reached_) {
            bool separates = false;
            if (level_[v] == at)
                for (Index e = k_.offsets[v]; e < k_.offsets[v + 1] && !separates; ++e)
                    separates = level_[k_.columns[e]] == at + 1;
            if (separates)
                order_[--last] = v;
            else if (level_[v] <= at)
                set_[near++] = v;
            else
                set_[--far] = v;
        }
        tasks_.push_back({task.begin, near, last - (task.end - far)});
        tasks_.push_back({far, task.end, last});
    }

    const Matrix& k_;
    // Each search gives levels above those of all searches before, so that none need be taken back.
    std::vector<Index> level_, order_, set_, reached_;
    std::vector<Task> tasks_;
    Index low_ = 0, zero_ = 1;
};

// The factors of one mesh.
struct Factors {
    std::vector<Index> order, rows;
    std::vector<std::int64_t> start;
    std::vector<double> lower, diagonal;
    bool singular = false;

    explicit Factors(const Matrix& k) : order(Dissection(k).order()), start(k.size + 1, 0), diagonal(k.size) {
        const Index n = k.size;
        std::vector<Index> number(n), parent(n), mark(n), filled(n), pattern(n), way(n);
        for (Index i = 0; i < n; ++i) number[order[i]] = i;
        // The elimination tree, and how many entries the columns of L have.
        for (Index i = 0; i < n; ++i) {
            parent[i] = -1;
            mark[i] = i;
            for (Index e = k.offsets[order[i]]; e < k.offsets[order[i] + 1]; ++e)
                for (Index j = number[k.columns[e]]; j < i && mark[j] != i; j = parent[j]) {
                    if (parent[j] < 0) parent[j] = i;
                    mark[j] = i;
                    ++start[j + 1];
                }
        }
        for (Index i = 0; i < n; ++i) start[i + 1] += start[i];
        rows.resize(start[n]);
        lower.resize(start[n]);
        std::vector<double> y(n, 0.0);
        std::fill(mark.begin(), mark.end(), -1);
        // Row by row: L_i D y = K_i, over the columns that the tree reaches from the entries of K_i.
        for (Index i = 0; i < n; ++i) {
            Index top = n;
            mark[i] = i;
            for (Index e = k.offsets[order[i]]; e < k.offsets[order[i] + 1]; ++e) {
                Index j = number[k.columns[e]], length = 0;
                if (j > i) continue;
                y[j] += k.values[e];
                for (; mark[j] != i; j = parent[j]) {
                    way[length++] = j;
                    mark[j] = i;
                }
                while (length > 0) pattern[--top] = way[--length];
            }
            double pivot = y[i];
            y[i] = 0;
            for (; top < n; ++top) {
                const Index j = pattern[top];
                const double value = y[j], entry = value / diagonal[j];
                y[j] = 0;
                const std::int64_t begin = start[j], end = begin + filled[j];
                for (std::int64_t p = begin; p < end; ++p) y[rows[p]] -= lower[p] * value;
                pivot -= entry * value;
                rows[end] = i;
                lower[end] = entry;
                ++filled[j];
            }
            diagonal[i] = pivot;
            if (pivot == 0) {
                singular = true;
                return;
            }
        }
    }

    // x = K^-1 b for `columns` right-hand sides, both (size, columns).
    void solve(const double* b, Index columns, double* x, std::vector<double>& y) const {
        const Index n = Index(order.size());
        y.resize(std::size_t(n) * columns);
        for (Index i = 0; i < n; ++i)
            for (Index c = 0; c < columns; ++c) y[i * columns + c] = b[std::int64_t(order[i]) * columns + c];
        for (Index j = 0; j < n; ++j)
            for (std::int64_t p = start[j]; p < start[j + 1]; ++p)
                for (Index c = 0; c < columns; ++c) y[std::size_t(rows[p]) * columns + c] -= lower[p] * y[j * columns + c];
        for (Index j = n; j-- > 0;)
            for (Index c = 0; c < columns; ++c) {
                double sum = y[j * columns + c] / diagonal[j];
                for (std::int64_t p = start[j]; p < start[j + 1]; ++p)
                    sum -= lower[p] * y[std::size_t(rows[p]) * columns + c];
                y[j * columns + c] = sum;
            }
        for (Index i = 0; i < n; ++i)
            for (Index c = 0; c < columns; ++c) x[std::int64_t(order[i]) * columns + c] = y[i * columns + c];
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
        systems->factors[m] = new Factors({own.data(), inside.data(), values + begin, size});
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
        std::vector<double> scratch;
        const std::int64_t at = systems.first[m] * columns;
        systems.factors[m]->solve(right + at, columns, out + at, scratch);
    });
}

TM_EXPORT void tm_end_factorised(void* handle) { delete static_cast<torchmesh::Systems*>(handle); }
