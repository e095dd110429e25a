// The next row of the walk that finds layers: the twin of `_Walk.next_row` in torchmesh/layering/layers.py, where the
// walk is drawn.
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

// A quadrilateral on the front.
struct Quad {
    std::int64_t corner[4], pair[2], end[2];
    double height, column;
};

struct Walk {
    const double* points;
    const std::int64_t *corners, *twin;
    const std::uint8_t *blocked, *free;
    Limits limits;

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
                0};
        const Point p = at(quad.corner[0]), q = at(quad.corner[1]), r = at(quad.corner[2]), s = at(quad.corner[3]);
        const Point lower = q - p, upper = r - s;
        const double a = length(lower), b = length(upper), left = length(s - p), right = length(r - q);
        quad.height = 0.5 * cross(r - p, s - q) / (0.5 * (a + b));
        quad.column = std::max(left, right);
        const double height = quad.height, column = quad.column;
        if (!(height > 0 && height <= (first ? limits.first : limits.height) * wall)) return false;
        if (!(column <= limits.lean * height && dot(lower, upper) >= limits.turn * a * b)) return false;
        return first ? column <= limits.alike * std::min(left, right) : height >= limits.shrink * below;
    }
};

}  // namespace
}  // namespace torchmesh

// `front` (count,) half-edges with the lengths of their walls and the heights of the rows below.  The quadrilaterals
// that stand on the front, but for those of which another claims a triangle, are put into `place` (count,), their row of
// the front; `corner` (count, 4), `diagonal` (count, 2), `pair` (count, 2) and `height` (count,).  Their number is
// returned.
TM_EXPORT std::int64_t tm_next_row(const double* points, const std::int64_t* triangles, const std::int64_t* twin,
                                   const std::uint8_t* blocked, const std::uint8_t* free, std::int64_t faces,
                                   const double* limits, std::int32_t first, const std::int64_t* front,
                                   const double* wall, const double* below, std::int64_t count, std::int64_t* place,
                                   std::int64_t* corner, std::int64_t* diagonal, std::int64_t* pair, double* height) {
    using namespace torchmesh;
    const Walk walk{points, triangles, twin, blocked, free,
                    {limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]}};
    std::vector<Quad> quads;
    std::vector<std::int64_t> at;
    std::vector<std::uint8_t> claims(faces, 0);
    for (std::int64_t i = 0; i < count; ++i) {
        Quad falling, rising;
        const bool falls = walk.stands(front[i], false, first != 0, wall[i], below[i], falling),
                   rises = walk.stands(front[i], true, first != 0, wall[i], below[i], rising);
        if (!falls && !rises) continue;
        quads.push_back(rises && (!falls || rising.column < falling.column) ? rising : falling);
        at.push_back(i);
        for (const std::int64_t t : quads.back().pair)
            if (claims[t] < 2) ++claims[t];
    }
    std::int64_t found = 0;
    for (std::size_t k = 0; k < quads.size(); ++k) {
        const Quad& quad = quads[k];
        if (claims[quad.pair[0]] != 1 || claims[quad.pair[1]] != 1) continue;
        place[found] = at[k];
        std::copy(quad.corner, quad.corner + 4, corner + 4 * found);
        std::copy(quad.end, quad.end + 2, diagonal + 2 * found);
        std::copy(quad.pair, quad.pair + 2, pair + 2 * found);
        height[found++] = quad.height;
    }
    return found;
}
