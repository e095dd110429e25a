// The order in which a sparse symmetric matrix is eliminated, so that its factors stay sparse.
//
// Nested dissection (George, Nested dissection of a regular finite element mesh, SIAM Journal on Numerical Analysis 10,
// 1973), with the separators of level structures from a vertex at the end of the graph (George & Liu, An automatic
// nested dissection algorithm for irregular finite element problems, SIAM Journal on Numerical Analysis 15, 1978).
#pragma once

#include "common.hpp"

namespace torchmesh {

// Rows and columns of matrices, and vertices of graphs.
using Index = std::int32_t;

// The neighbours of each vertex: columns[offsets[v]] ... columns[offsets[v + 1] - 1]; v itself may be among them.
struct Graph {
    const Index* offsets;
    const Index* columns;
    Index size;
};

// Parts of so many vertices are not cut any more.
constexpr Index WHOLE = 12;

class Dissection {
  public:
    explicit Dissection(const Graph& k) : k_(k), level_(k.size, 0), order_(k.size), set_(k.size) {
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

    const Graph k_;
    // Each search gives levels above those of all searches before, so that none need be taken back.
    std::vector<Index> level_, order_, set_, reached_;
    std::vector<Task> tasks_;
    Index low_ = 0, zero_ = 1;
};

// Graphs of more vertices than this are dissected, others are ordered by minimum degree.
constexpr Index SMALL_GRAPH = 1500;

// The order by minimum degree (Tinney & Walker, Direct solutions of sparse network equations by optimally ordered
// triangular factorization, Proceedings of the IEEE 55, 1967): the vertex with the fewest neighbours is next, and its
// neighbours become neighbours of each other.  They are kept as bits.
std::vector<Index> minimum_degree(const Graph& of);

}  // namespace torchmesh
