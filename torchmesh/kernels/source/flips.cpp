// Edge flips in conflict-free rounds: the loop of torchmesh/flipping/rounds.py by the rules of rules.py, where both are
// explained; the same edges flip, in the same order.
#include "exact.hpp"

#include <memory>

namespace torchmesh {
namespace {

enum Rule : std::int32_t { SAFE = 0, KIM = 1, SHAPE = 2, METRIC = 3 };

constexpr double LEAST_GAIN = 1e-10, NEARLY_NOT_DELAUNAY = -0.5, SQRT3 = 1.7320508075688772;

// Must have the fields of kernels/flips.py, `_Rounds`, in the same order.
struct RoundsArgument {
    const double *x, *y;
    const double* metric;  // (V, 3), or null
    std::int64_t *vertex, *twin;  // (3T,), read and written
    std::uint8_t* locked;         // (3T,), read and written
    std::int64_t half_edges;
    const std::int64_t* queue;  // lower half-edges, ascending
    std::int64_t queued, max_rounds, vertices;  // queued is -1 for all
    std::int32_t rule, once;
};

struct Point {
    double x, y;
};

struct Quad {
    Point u, w, s, r;
};

struct Answer {
    bool wanted;
    double rank;
};

double clamp(double value, double low, double high) { return value < low ? low : value > high ? high : value; }

int sign(Point a, Point b, Point c) { return orientation(a.x, a.y, b.x, b.y, c.x, c.y); }

double double_area(Point a, Point b, Point c) { return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x); }

bool inside_circle(const Quad& q) {
    return incircle(q.u.x, q.u.y, q.w.x, q.w.y, q.s.x, q.s.y, q.r.x, q.r.y) > 0;
}

double square(double x) { return x * x; }

double finite_energy(Point a, Point b, Point c) {
    const double ab = square(b.x - a.x) + square(b.y - a.y), bc = square(c.x - b.x) + square(c.y - b.y),
                 ca = square(a.x - c.x) + square(a.y - c.y), area = std::abs(0.5 * double_area(a, b, c));
    const double ratio = area > 0 ? (ab + bc + ca) / (4 * SQRT3 * area) : 1e30;
    return square(ratio > 1e30 ? 1e30 : ratio);
}

struct Corners {
    double dot_s, cross_s, dot_r, cross_r;

    explicit Corners(const Quad& q)
        : dot_s((q.u.x - q.s.x) * (q.w.x - q.s.x) + (q.u.y - q.s.y) * (q.w.y - q.s.y)),
          cross_s(std::abs(double_area(q.u, q.w, q.s))),
          dot_r((q.u.x - q.r.x) * (q.w.x - q.r.x) + (q.u.y - q.r.y) * (q.w.y - q.r.y)),
          cross_r(std::abs(double_area(q.w, q.u, q.r))) {}
};

// Minus the sum of the cotangents of the opposite angles, and a bound on its rounding.
double cotangent_deficit(const Quad& q, double& rounding) {
    Corners c(q);
    c.cross_s = c.cross_s < 1e-300 ? 1e-300 : c.cross_s;
    c.cross_r = c.cross_r < 1e-300 ? 1e-300 : c.cross_r;
    const double cot_s = c.dot_s / c.cross_s, cot_r = c.dot_r / c.cross_r;
    rounding = 1e-13 * (square(1 + std::abs(cot_s)) + square(1 + std::abs(cot_r)));
    if (std::min(c.cross_s, c.cross_r) < 1e-290) rounding = std::numeric_limits<double>::infinity();
    return -clamp(cot_s + cot_r, -1e29, 1e29);
}

Answer kim(const Quad& q) {
    const Corners c(q);
    const double real = c.dot_s * c.dot_r - c.cross_s * c.cross_r, imaginary = c.dot_s * c.cross_r + c.cross_s * c.dot_r;
    const double size = std::abs(real) + std::abs(imaginary), slope = real / (size > 0 ? size : 1.0);
    const double total = imaginary >= 0 ? 1 - slope : 3 + slope;
    // Rounding may have lowered the rank by less than 1e-12; the exact signs below decide.
    if (!(total > 2 - 1e-12)) return {false, total};
    const bool upright = sign(q.u, q.w, q.s) > 0 && sign(q.w, q.u, q.r) > 0;
    const bool wanted = upright ? inside_circle(q) : total > 2;
    return {wanted && sign(q.u, q.r, q.s) > 0 && sign(q.r, q.w, q.s) > 0, total};
}

double inverted_area(double first, double second) {
    return -((first > 0 ? 0 : first) + (second > 0 ? 0 : second));
}

Answer safe(const Quad& q) {
    const int left = sign(q.u, q.w, q.s), right = sign(q.w, q.u, q.r);
    const bool upright = left > 0 && right > 0;
    double rounding;
    const double deficit = cotangent_deficit(q, rounding);
    if (upright && !(deficit > -rounding)) return {false, deficit};
    const int first = sign(q.u, q.r, q.s), second = sign(q.r, q.w, q.s);
    const bool made_upright = first > 0 && second > 0;
    if (upright) return {made_upright && inside_circle(q), deficit};
    const double before[2] = {double_area(q.u, q.w, q.s), double_area(q.w, q.u, q.r)},
                 after[2] = {double_area(q.u, q.r, q.s), double_area(q.r, q.w, q.s)};
    const double gain = inverted_area(before[0], before[1]) - inverted_area(after[0], after[1]);
    const double smallest =
        1e-14 * (((std::abs(before[0]) + std::abs(before[1])) + std::abs(after[0])) + std::abs(after[1]));
    const bool lower = gain > smallest && (first < 0) + (second < 0) <= (left < 0) + (right < 0);
    const bool unflattened = left >= 0 && right >= 0 && made_upright;
    return {lower || unflattened, 1e30 * (1 + gain / (smallest < 1e-300 ? 1e-300 : smallest))};
}

bool all_upright(const Quad& q) {
    return sign(q.u, q.w, q.s) > 0 && sign(q.w, q.u, q.r) > 0 && sign(q.u, q.r, q.s) > 0 && sign(q.r, q.w, q.s) > 0;
}

Answer shape(const Quad& q) {
    double rounding;
    if (!(cotangent_deficit(q, rounding) > NEARLY_NOT_DELAUNAY)) return {false, 0};
    const double gain = (finite_energy(q.u, q.w, q.s) + finite_energy(q.w, q.u, q.r)) -
                        (finite_energy(q.u, q.r, q.s) + finite_energy(q.r, q.w, q.s));
    return {gain > LEAST_GAIN && all_upright(q), gain};
}

// The energy of a triangle seen through the root of a metric, which is the sum of those of its corners.
double seen_energy(Point a, Point b, Point c, const double* ma, const double* mb, const double* mc) {
    double m[3];
    for (int k = 0; k < 3; ++k) m[k] = (ma[k] + mb[k]) + mc[k];
    const double root = std::sqrt(m[0] * m[2] - m[1] * m[1]);
    double h11 = m[0] + root, h12 = m[1], h22 = m[2] + root;
    const double size = std::sqrt(h11 * h22 - h12 * h12);
    h11 /= size, h12 /= size, h22 /= size;
    auto seen = [&](Point p) {
        const double x = p.x - a.x, y = p.y - a.y;
        return Point{h11 * x + h12 * y, h12 * x + h22 * y};
    };
    return finite_energy({0, 0}, seen(b), seen(c));
}

Answer by_metric(const Quad& q, const double* u, const double* w, const double* s, const double* r) {
    const double before = seen_energy(q.u, q.w, q.s, u, w, s) + seen_energy(q.w, q.u, q.r, w, u, r);
    const double after = seen_energy(q.u, q.r, q.s, u, r, s) + seen_energy(q.r, q.w, q.s, r, w, s);
    const double gain = before - after;
    return {gain > LEAST_GAIN * before && all_upright(q), gain};
}

class Rounds {
  public:
    using Row = std::int32_t;

    explicit Rounds(const RoundsArgument& given)
        : given_(given),
          vertex_(given.vertex, given.vertex + given.half_edges),
          twin_(given.twin, given.twin + given.half_edges),
          moved_(given.half_edges),
          best_(given.half_edges / 3, Row(given.half_edges)),
          marks_(given.half_edges, 0),
          pinched_(given.vertices, 0) {
        if (given.queued > 0) queue_.assign(given.queue, given.queue + given.queued);
        for (Row h = 0; h < Row(given.half_edges); ++h) {
            // Several fans meet in a vertex where more than one of its half-edges is on the boundary.
            if (twin_[h] < 0 && pinched_[vertex_[h]] < 2) ++pinched_[vertex_[h]];
            if (given.queued < 0 && twin_[h] > h) queue_.push_back(h);
        }
        for (std::size_t i = 0; i < moved_.size(); ++i) moved_[i] = Row(i);
    }

    // Goes on for so many questions; has it ended?
    bool advance(std::int64_t work) {
        while (rounds_ < given_.max_rounds) {
            if (work <= 0) return false;
            work -= std::int64_t(queue_.size());
            ++rounds_;
            if (!round()) break;
        }
        std::copy(vertex_.begin(), vertex_.end(), given_.vertex);
        std::copy(twin_.begin(), twin_.end(), given_.twin);
        return true;
    }

    std::vector<std::int64_t> log;

  private:
    struct Flip {
        double rank;
        Row h;
    };

    static Row next(Row h) { return h % 3 == 2 ? h - 2 : h + 1; }
    static Row previous(Row h) { return h % 3 == 0 ? h + 2 : h - 1; }

    bool round() {
        collect();
        if (flips_.empty()) return false;
        // Equal ranks stay in the order of their index.
        std::sort(flips_.begin(), flips_.end(),
                  [](const Flip& a, const Flip& b) { return a.rank > b.rank || (a.rank == b.rank && a.h < b.h); });
        choose();
        waiting_ = barred_;
        touched_.clear();
        diagonals_.clear();
        for (std::size_t i = 0; i < flips_.size(); ++i) {
            if (!chosen_[i])
                waiting_.push_back(flips_[i].h);
            else
                flip(flips_[i].h);
        }
        for (Row& h : waiting_) h = moved_[h];
        for (Row d : diagonals_) moved_[d] = d;
        waiting_.insert(waiting_.end(), touched_.begin(), touched_.end());
        each_edge_once();
        return true;
    }

    // The flips that the rule wants and that may be done, and those whose new edge exists already.
    void collect() {
        flips_.clear();
        barred_.clear();
        for (Row h : queue_) {
            if (given_.locked[h]) continue;
            const Row g = twin_[h], last_h = previous(h), last_g = previous(g);
            const Row u = vertex_[h], w = vertex_[g], s = vertex_[last_h], r = vertex_[last_g];
            const Answer answer = ask(u, w, s, r);
            if (!answer.wanted || s == r) continue;
            // Of two pinched vertices neither can be trusted to show all its edges.
            const bool from_r = pinched_[s] > 1;
            const bool exists = edge_exists(from_r ? last_g : last_h, from_r ? s : r) || (from_r && pinched_[r] > 1);
            if (exists)
                barred_.push_back(h);
            else
                flips_.push_back({answer.rank, h});
        }
    }

    Answer ask(Row u, Row w, Row s, Row r) const {
        const double *x = given_.x, *y = given_.y;
        const Quad q{{x[u], y[u]}, {x[w], y[w]}, {x[s], y[s]}, {x[r], y[r]}};
        switch (given_.rule) {
            case SAFE: return safe(q);
            case KIM: return kim(q);
            case SHAPE: return shape(q);
            default: {
                const double* m = given_.metric;
                return by_metric(q, m + 3 * u, m + 3 * w, m + 3 * s, m + 3 * r);
            }
        }
    }

    // Does the vertex that `start` leaves have an edge to `goal`, as far as one fan shows?
    bool edge_exists(Row start, Row goal) const {
        Row here = start;
        while (true) {
            const Row behind = previous(here);
            if (vertex_[next(here)] == goal || vertex_[behind] == goal) return true;
            here = twin_[behind];
            if (here == start) return false;
            if (here < 0) break;
        }
        for (here = twin_[start]; here >= 0; here = twin_[here]) {
            here = next(here);
            if (vertex_[next(here)] == goal || vertex_[previous(here)] == goal) return true;
        }
        return false;
    }

    // Which flips rank first in both their triangles and make no edge that a better one makes.
    void choose() {
        for (std::size_t i = 0; i < flips_.size(); ++i)
            for (Row h : {flips_[i].h, twin_[flips_[i].h]}) best_[h / 3] = std::min(best_[h / 3], Row(i));
        chosen_.assign(flips_.size(), 0);
        keys_.clear();
        for (std::size_t i = 0; i < flips_.size(); ++i) {
            const Row h = flips_[i].h, g = twin_[h];
            if (best_[h / 3] != Row(i) || best_[g / 3] != Row(i)) continue;
            chosen_[i] = 1;
            const std::int64_t s = vertex_[previous(h)], r = vertex_[previous(g)];
            keys_.push_back({(std::min(s, r) << 32) + std::max(s, r), Row(i)});
        }
        for (const Flip& f : flips_)
            for (Row h : {f.h, twin_[f.h]}) best_[h / 3] = Row(given_.half_edges);
        std::sort(keys_.begin(), keys_.end());
        for (std::size_t k = 1; k < keys_.size(); ++k)
            if (keys_[k].first == keys_[k - 1].first) chosen_[keys_[k].second] = 0;
    }

    // The new diagonal takes the slots after h and its twin; what was there moves to those of the two.
    void flip(Row h) {
        const Row g = twin_[h], last_h = previous(h), last_g = previous(g), on_h = next(h), on_g = next(g);
        log.push_back(std::min(h / 3, g / 3));
        vertex_[on_h] = vertex_[last_g];
        vertex_[on_g] = vertex_[last_h];
        const Row a = twin_[on_h], b = twin_[on_g];
        twin_[g] = a;
        if (a >= 0) twin_[a] = g;
        twin_[h] = b;
        if (b >= 0) twin_[b] = h;
        twin_[on_h] = on_g;
        twin_[on_g] = on_h;
        given_.locked[g] = given_.locked[on_h];
        given_.locked[h] = given_.locked[on_g];
        given_.locked[on_h] = given_.locked[on_g] = std::uint8_t(given_.once);
        moved_[on_h] = g;
        moved_[on_g] = h;
        diagonals_.push_back(on_h);
        diagonals_.push_back(on_g);
        for (Row t : {h, g, last_h, last_g}) touched_.push_back(t);
    }

    // The queue of the next round: the interior edges of `waiting_`, by their lower half-edges, ascending.
    void each_edge_once() {
        queue_.clear();
        ++mark_;
        for (Row h : waiting_) {
            const Row other = twin_[h], lower = std::min(h, other);
            if (other < 0 || marks_[lower] == mark_) continue;
            marks_[lower] = mark_;
            queue_.push_back(lower);
        }
        std::sort(queue_.begin(), queue_.end());
    }

    const RoundsArgument given_;
    std::vector<Row> vertex_, twin_, moved_, best_, queue_, waiting_, barred_, touched_, diagonals_;
    std::vector<std::uint32_t> marks_;
    std::vector<std::uint8_t> pinched_;
    std::uint32_t mark_ = 0;
    std::vector<Flip> flips_;
    std::vector<char> chosen_;
    std::vector<std::pair<std::int64_t, Row>> keys_;
    std::int64_t rounds_ = 0;
};

}  // namespace
}  // namespace torchmesh

TM_EXPORT void* tm_flips_start(const torchmesh::RoundsArgument* given) { return new torchmesh::Rounds(*given); }

// Has it ended?
TM_EXPORT std::int32_t tm_flips_advance(void* rounds, std::int64_t work) {
    return static_cast<torchmesh::Rounds*>(rounds)->advance(work);
}

// How many flips were done; with `out`, the lower triangle of each.
TM_EXPORT std::int64_t tm_flips_log(void* rounds, std::int64_t* out) {
    const auto& log = static_cast<torchmesh::Rounds*>(rounds)->log;
    if (out) std::copy(log.begin(), log.end(), out);
    return std::int64_t(log.size());
}

TM_EXPORT void tm_flips_end(void* rounds) { delete static_cast<torchmesh::Rounds*>(rounds); }

// The lower half-edges of the interior edges of the triangles whose flag is set, ascending, if `out` is given; returns
// how many they are.
TM_EXPORT std::int64_t tm_edges_of(const std::uint8_t* triangles, const std::int64_t* twin, std::int64_t half_edges,
                                   std::int64_t* out) {
    std::int64_t count = 0;
    for (std::int64_t t = 0; 3 * t < half_edges; ++t)
        for (std::int64_t h = 3 * t; h < 3 * t + 3; ++h) {
            const std::int64_t g = twin[h];
            if (g <= h || !(triangles[t] || triangles[g / 3])) continue;
            if (out) out[count] = h;
            ++count;
        }
    return count;
}
