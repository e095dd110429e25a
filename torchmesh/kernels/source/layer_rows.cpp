// The walk that finds layers: the twin of `_Walk` in torchmesh/layering/layers.py, where it is drawn.
#include "common.hpp"

namespace torchmesh {
namespace {

struct Point {
    double x, y;
};

TM_INLINE Point operator-(Point a, Point b) { return {a.x - b.x, a.y - b.y}; }
TM_INLINE double length(Point a) { return std::sqrt(a.x * a.x + a.y * a.y); }
TM_INLINE double cross(Point a, Point b) { return a.x * b.y - a.y * b.x; }
TM_INLINE double dot(Point a, Point b) { return a.x * b.x + a.y * b.y; }

TM_INLINE std::int64_t next(std::int64_t h) { return h % 3 == 2 ? h - 2 : h + 1; }
TM_INLINE std::int64_t previous(std::int64_t h) { return h % 3 == 0 ? h + 2 : h - 1; }

// The limits of `LayerOptions`, in its order.
struct Limits {
    double first, height, lean, turn, shrink, alike;
};

// A quadrilateral; `place` is its number on the front.
struct Quad {
    std::int64_t corner[4], pair[2], end[2], place;
    double height, column;
};

// The upper ends of the strips: half-edges, the walls below them and the lengths of these, the heights of the rows below.
struct Front {
    std::vector<std::int64_t> half_edge, wall;
    std::vector<double> length, below;

    void add(std::int64_t h, std::int64_t w, double l, double b) {
        half_edge.push_back(h);
        wall.push_back(w);
        length.push_back(l);
        below.push_back(b);
    }
};

struct Walk {
    const double* points;
    const std::int64_t *corners, *twin;
    const std::uint8_t* blocked;
    std::vector<std::uint8_t> free;
    Limits limits;
    Front front;

    Point at(std::int64_t vertex) const { return {points[2 * vertex], points[2 * vertex + 1]}; }

    // The quadrilateral over the half-edge h whose diagonal is the edge after h (falls), or the one before it (rises).
    // `below` is the height of the row below; false if it will not do.
    bool stands(std::int64_t h, bool rises, bool first, double wall, double below, Quad& quad) const {
        const std::int64_t diagonal = rises ? previous(h) : next(h), across = twin[diagonal];
        if (blocked[diagonal] || across < 0 || !free[h / 3] || !free[across / 3]) return false;
        const std::int64_t apex = corners[previous(h)], far = corners[previous(across)];
        quad = {{corners[h], corners[next(h)], rises ? apex : far, rises ? far : apex},
                {h / 3, across / 3},
                {corners[diagonal], corners[next(diagonal)]},
                0,
                0,
                0};
        const Point p = at(quad.corner[0]), q = at(quad.corner[1]), r = at(quad.corner[2]), s = at(quad.corner[3]);
        const Point lower = q - p, upper = r - s;
        const double a = length(lower), b = length(upper), left = length(s - p), right = length(r - q);
        quad.height = 0.5 * cross(r - p, s - q) / (0.5 * (a + b));
        quad.column = std::max(left, right);
        const double height = quad.height, column = quad.column;
        const double limit = first ? limits.first * wall : limits.height * std::min(wall, 0.5 * (a + b));
        if (!(height > 0 && height <= limit)) return false;
        if (!(column <= limits.lean * height && dot(lower, upper) >= limits.turn * a * b)) return false;
        return first ? column <= limits.alike * std::min(left, right) : height >= limits.shrink * below;
    }

    // As `_Walk.next_row`: the better of both that stand on each half-edge, where no other claims a triangle of it.
    std::vector<Quad> next_row(bool first) const {
        std::vector<Quad> quads;
        std::vector<std::uint8_t> claims(free.size(), 0);
        for (std::size_t i = 0; i < front.half_edge.size(); ++i) {
            Quad falling, rising;
            const std::int64_t h = front.half_edge[i];
            const bool falls = stands(h, false, first, front.length[i], front.below[i], falling),
                       rises = stands(h, true, first, front.length[i], front.below[i], rising);
            if (!falls && !rises) continue;
            quads.push_back(rises && (!falls || rising.column < falling.column) ? rising : falling);
            quads.back().place = std::int64_t(i);
            for (const std::int64_t t : quads.back().pair)
                if (claims[t] < 2) ++claims[t];
        }
        const auto shared = [&](const Quad& quad) { return claims[quad.pair[0]] != 1 || claims[quad.pair[1]] != 1; };
        quads.erase(std::remove_if(quads.begin(), quads.end(), shared), quads.end());
        return quads;
    }

    // As `_in_company`: what is left has neighbours of like height at both sides, or one that has.
    std::vector<Quad> in_company(std::vector<Quad> quads) const {
        struct Column {
            std::int64_t foot, top, quad;
            bool operator<(const Column& other) const {
                return foot != other.foot ? foot < other.foot : top != other.top ? top < other.top : quad < other.quad;
            }
        };
        const std::int64_t count = std::int64_t(quads.size());
        std::vector<Column> left;
        for (std::int64_t i = 0; i < count; ++i) left.push_back({quads[i].corner[0], quads[i].corner[3], i});
        std::sort(left.begin(), left.end());
        std::vector<std::int64_t> before(count, -1), after(count, -1);
        for (std::int64_t i = 0; i < count; ++i) {
            const Column right{quads[i].corner[1], quads[i].corner[2], -1};
            const auto found = std::lower_bound(left.begin(), left.end(), right);
            if (found == left.end() || found->foot != right.foot || found->top != right.top) continue;
            const double ratio = quads[found->quad].height / quads[i].height;
            if (!(ratio <= limits.alike && ratio * limits.alike >= 1)) continue;
            after[i] = found->quad;
            before[found->quad] = i;
        }
        const auto amid = [&](std::int64_t i) { return i >= 0 && before[i] >= 0 && after[i] >= 0; };
        std::vector<Quad> kept;
        for (std::int64_t i = 0; i < count; ++i)
            if (amid(i) || amid(before[i]) || amid(after[i])) kept.push_back(quads[i]);
        return kept;
    }

    // As `_Walk.go_on`.
    void go_on(const std::vector<Quad>& quads) {
        Front above;
        for (const Quad& quad : quads) {
            for (const std::int64_t t : quad.pair) free[t] = false;
            for (std::int64_t top = 3 * quad.pair[1]; top < 3 * quad.pair[1] + 3; ++top)
                if (corners[top] == quad.corner[2] && corners[next(top)] == quad.corner[3] && !blocked[top])
                    above.add(twin[top], front.wall[quad.place], front.length[quad.place], quad.height);
        }
        front = std::move(above);
    }
};

}  // namespace
}  // namespace torchmesh

// Walks from the half-edges `walls` (count,) of these lengths.  `free` (faces,) are the triangles that may be taken.  The
// quadrilaterals of all rows, of which the lowest `rows` must stand side by side, are put into `wall`, `row`, `corner`
// (.., 4), `diagonal` (.., 2), `pair` (.., 2) and `height`, which have room for half of the faces.  Their number is
// returned, and `begun` is that of the first row.
TM_EXPORT std::int64_t tm_walk_layers(const double* points, const std::int64_t* triangles, const std::int64_t* twin,
                                      const std::uint8_t* blocked, const std::uint8_t* free, std::int64_t faces,
                                      const double* limits, std::int64_t rows, const std::int64_t* walls,
                                      const double* lengths, std::int64_t count, std::int64_t* wall, std::int64_t* row,
                                      std::int64_t* corner, std::int64_t* diagonal, std::int64_t* pair, double* height,
                                      std::int64_t* begun) {
    using namespace torchmesh;
    Walk walk{points, triangles, twin, blocked, {free, free + faces},
              {limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]}, {}};
    for (std::int64_t i = 0; i < count; ++i)
        walk.front.add(walls[i], walls[i], lengths[i], std::numeric_limits<double>::infinity());
    std::int64_t found = 0;
    *begun = 0;
    for (std::int64_t done = 0; !walk.front.half_edge.empty(); ++done) {
        std::vector<Quad> quads = walk.next_row(done == 0);
        if (done < rows) quads = walk.in_company(std::move(quads));
        if (done == 0) *begun = std::int64_t(quads.size());
        for (const Quad& quad : quads) {
            wall[found] = walk.front.wall[quad.place];
            row[found] = done + 1;
            std::copy(quad.corner, quad.corner + 4, corner + 4 * found);
            std::copy(quad.end, quad.end + 2, diagonal + 2 * found);
            std::copy(quad.pair, quad.pair + 2, pair + 2 * found);
            height[found++] = quad.height;
        }
        walk.go_on(quads);
    }
    return found;
}
