// Which boxes of two sets touch, and what two triangles share: the twins of torchmesh/transferring/pairs.py and
// overlaps.py, where both are explained.
#include "common.hpp"

#include <memory>

namespace torchmesh {
namespace {

struct Box {
    double low[2], high[2];

    bool touches(const Box& other) const {
        return low[0] <= other.high[0] && other.low[0] <= high[0] && low[1] <= other.high[1] && other.low[1] <= high[1];
    }

    void include(const Box& other) {
        for (int k = 0; k < 2; ++k) {
            low[k] = std::min(low[k], other.low[k]);
            high[k] = std::max(high[k], other.high[k]);
        }
    }
};

constexpr double NEVER = std::numeric_limits<double>::infinity();
constexpr Box NOWHERE{{NEVER, NEVER}, {-NEVER, -NEVER}};

// The bits of x at the even places, so that those of y fit between them (Morton 1966).
std::uint64_t apart(std::uint64_t x) {
    x = (x | x << 16) & 0x0000ffff0000ffffULL;
    x = (x | x << 8) & 0x00ff00ff00ff00ffULL;
    x = (x | x << 4) & 0x0f0f0f0f0f0f0f0fULL;
    x = (x | x << 2) & 0x3333333333333333ULL;
    return (x | x << 1) & 0x5555555555555555ULL;
}

// A binary tree over the boxes of one mesh, which stand in the order of their Morton codes, LEAF of them in each leaf.
class Tree {
  public:
    static constexpr std::size_t LEAF = 4;

    Tree(const double* low, const double* high, std::int64_t first, std::int64_t last) {
        Box all = NOWHERE;
        for (std::int64_t i = first; i < last; ++i) all.include(box_of(low, high, i));
        double scale[2];
        for (int k = 0; k < 2; ++k) {
            const double extent = all.high[k] - all.low[k];
            scale[k] = extent > 0 && extent < NEVER ? 4294967295.0 / extent : 0.0;
        }
        std::vector<std::pair<std::uint64_t, std::int64_t>> codes;
        codes.reserve(std::size_t(last - first));
        for (std::int64_t i = first; i < last; ++i) {
            std::uint64_t code = 0;
            for (int k = 0; k < 2; ++k) {
                const double middle = 0.5 * low[2 * i + k] + 0.5 * high[2 * i + k];
                const double at = std::max(0.0, std::min(4294967295.0, (middle - all.low[k]) * scale[k]));
                code |= apart(std::uint64_t(at)) << k;
            }
            codes.emplace_back(code, i);
        }
        std::sort(codes.begin(), codes.end());
        for (const auto& pair : codes) {
            row.push_back(pair.second);
            box.push_back(box_of(low, high, pair.second));
        }
        leaves = 1;
        while (leaves * LEAF < row.size()) leaves *= 2;
        node.assign(2 * leaves, NOWHERE);
        for (std::size_t i = 0; i < row.size(); ++i) node[leaves + i / LEAF].include(box[i]);
        for (std::size_t i = leaves; i-- > 1;) {
            node[i] = node[2 * i];
            node[i].include(node[2 * i + 1]);
        }
    }

    // The rows of the boxes that touch `wanted`, ascending.
    void find(const Box& wanted, std::vector<std::int64_t>& found) const {
        found.clear();
        std::size_t stack[130], depth = 0;
        stack[depth++] = 1;
        while (depth) {
            const std::size_t i = stack[--depth];
            if (!node[i].touches(wanted)) continue;
            if (i < leaves) {
                stack[depth++] = 2 * i + 1;
                stack[depth++] = 2 * i;
                continue;
            }
            const std::size_t start = (i - leaves) * LEAF, end = std::min(start + LEAF, row.size());
            for (std::size_t j = start; j < end; ++j)
                if (box[j].touches(wanted)) found.push_back(row[j]);
        }
        std::sort(found.begin(), found.end());
    }

  private:
    static Box box_of(const double* low, const double* high, std::int64_t i) {
        return {{low[2 * i], low[2 * i + 1]}, {high[2 * i], high[2 * i + 1]}};
    }

    std::vector<std::int64_t> row;
    std::vector<Box> box, node;
    std::size_t leaves = 1;
};

struct Join {
    std::vector<Tree> trees;
    std::vector<std::int64_t> here, there, found;
};

// --- clipping ---

struct Segments {
    int count;
    double ax[6], ay[6], bx[6], by[6];
};

// What is on the left of the line through p in the direction d; one segment more than before.
void cut(Segments& s, double px, double py, double dx, double dy) {
    double lx = 0, ly = 0, cx = 0, cy = 0;
    for (int k = 0; k < s.count; ++k) {
        const double ax = s.ax[k], ay = s.ay[k], bx = s.bx[k], by = s.by[k];
        const double at_a = dx * (ay - py) - dy * (ax - px), at_b = dx * (by - py) - dy * (bx - px);
        const bool in_a = at_a >= 0, in_b = at_b >= 0;
        if (in_a && in_b) continue;
        if (!in_a && !in_b) {
            s.ax[k] = s.ay[k] = s.bx[k] = s.by[k] = 0;
            continue;
        }
        const double share = at_a / (at_a - at_b);
        const double x = ax + share * (bx - ax), y = ay + share * (by - ay);
        if (in_a) {
            s.bx[k] = lx = x;
            s.by[k] = ly = y;
        } else {
            s.ax[k] = cx = x;
            s.ay[k] = cy = y;
        }
    }
    s.ax[s.count] = lx;
    s.ay[s.count] = ly;
    s.bx[s.count] = cx;
    s.by[s.count] = cy;
    ++s.count;
}

double area_of(const Segments& s) {
    double sum = 0;
    for (int k = 0; k < s.count; ++k) sum += s.ax[k] * s.by[k] - s.ay[k] * s.bx[k];
    return 0.5 * sum;
}

// Integrals of 1, x, y, x^2, xy and y^2.
void moments_of(const Segments& s, double* out) {
    for (int i = 0; i < 6; ++i) out[i] = 0;
    for (int k = 0; k < s.count; ++k) {
        const double ax = s.ax[k], ay = s.ay[k], bx = s.bx[k], by = s.by[k];
        const double area = 0.5 * (ax * by - ay * bx), third = area / 3;
        const double x[3] = {0.5 * ax, 0.5 * bx, 0.5 * (ax + bx)}, y[3] = {0.5 * ay, 0.5 * by, 0.5 * (ay + by)};
        out[0] += area;
        out[1] += third * (x[0] + x[1] + x[2]);
        out[2] += third * (y[0] + y[1] + y[2]);
        out[3] += third * (x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
        out[4] += third * (x[0] * y[0] + x[1] * y[1] + x[2] * y[2]);
        out[5] += third * (y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
    }
}

// The area of one pair; `t` and `s` are x and y of the corners after and before, counter-clockwise.
double shared_area(const double* t, const double* s, double* moments) {
    if (moments) std::fill(moments, moments + 6, 0.0);
    const double ux = s[1] - s[0], uy = s[4] - s[3], vx = s[2] - s[0], vy = s[5] - s[3];
    const double line[3][4] = {{0, 0, ux, uy}, {ux, uy, vx - ux, vy - uy}, {0, 0, -vx, -vy}};
    Segments polygon;
    polygon.count = 3;
    for (int k = 0; k < 3; ++k) {
        polygon.ax[k] = t[k] - s[0];
        polygon.ay[k] = t[3 + k] - s[3];
    }
    bool cuts[3];
    for (int k = 0; k < 3; ++k) {
        double least = NEVER, most = -NEVER;
        for (int i = 0; i < 3; ++i) {
            const double left =
                line[k][2] * (polygon.ay[i] - line[k][1]) - line[k][3] * (polygon.ax[i] - line[k][0]);
            least = std::min(least, left);
            most = std::max(most, left);
        }
        if (most <= 0) return 0;
        cuts[k] = least < 0;
    }
    for (int k = 0; k < 3; ++k) {
        polygon.bx[k] = polygon.ax[(k + 1) % 3];
        polygon.by[k] = polygon.ay[(k + 1) % 3];
    }
    for (int k = 0; k < 3; ++k)
        if (cuts[k]) cut(polygon, line[k][0], line[k][1], line[k][2], line[k][3]);
    if (moments) moments_of(polygon, moments);
    return area_of(polygon);
}

}  // namespace
}  // namespace torchmesh

// Boxes `low`, `high` (M, 2), mesh by mesh: those of mesh b are the rows offsets[b] to offsets[b + 1].
TM_EXPORT void* tm_boxes_start(const double* low, const double* high, const std::int64_t* offsets, std::int64_t meshes) {
    auto join = std::make_unique<torchmesh::Join>();
    for (std::int64_t b = 0; b < meshes; ++b) join->trees.emplace_back(low, high, offsets[b], offsets[b + 1]);
    return join.release();
}

// Finds the boxes that touch those of the rows first to last of other boxes, of the meshes `mesh`; the number so far.
TM_EXPORT std::int64_t tm_boxes_find(void* join, const double* low, const double* high, const std::int64_t* mesh,
                                     std::int64_t first, std::int64_t last) {
    auto& of = *static_cast<torchmesh::Join*>(join);
    for (std::int64_t i = first; i < last; ++i) {
        of.trees[std::size_t(mesh[i])].find({{low[2 * i], low[2 * i + 1]}, {high[2 * i], high[2 * i + 1]}}, of.found);
        of.here.insert(of.here.end(), of.found.size(), i);
        of.there.insert(of.there.end(), of.found.begin(), of.found.end());
    }
    return std::int64_t(of.here.size());
}

TM_EXPORT void tm_boxes_pairs(void* join, std::int64_t* here, std::int64_t* there) {
    const auto& of = *static_cast<torchmesh::Join*>(join);
    std::copy(of.here.begin(), of.here.end(), here);
    std::copy(of.there.begin(), of.there.end(), there);
}

TM_EXPORT void tm_boxes_end(void* join) { delete static_cast<torchmesh::Join*>(join); }

// The areas (P,) that the triangles i of `after` share with the triangles j of `before`, both (6, T); and `moments`
// (P, 6), or null.
TM_EXPORT void tm_shared_areas(const double* after, std::int64_t count_after, const std::int64_t* i,
                               const double* before, std::int64_t count_before, const std::int64_t* j,
                               std::int64_t pairs, double* area, double* moments) {
    for (std::int64_t p = 0; p < pairs; ++p) {
        double t[6], s[6];
        for (int k = 0; k < 6; ++k) {
            t[k] = after[k * count_after + i[p]];
            s[k] = before[k * count_before + j[p]];
        }
        area[p] = torchmesh::shared_area(t, s, moments ? moments + 6 * p : nullptr);
    }
}
