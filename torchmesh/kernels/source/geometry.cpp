// Loops over triangles, edges and segments: quality, angles, twins, and which segments meet.
#include "exact.hpp"

namespace torchmesh {
namespace {

constexpr double SQRT3 = 1.7320508075688772, PI = 3.141592653589793;

struct Corner {
    double x, y;
};

TM_INLINE Corner at(const double* points, std::int64_t row) { return {points[2 * row], points[2 * row + 1]}; }

// As `arctangent` in torchmesh/mesh/triangle.py: atan2(y, x) for y >= 0, by halving the angle and a short series.
TM_INLINE double arctangent(double y, double x) {
    constexpr int TERMS = 12;
    double size = std::max(std::abs(x), y);
    const bool zero = size == 0;
    size = zero ? 1.0 : size;
    const double across = y / size, along = zero ? 1.0 : std::abs(x / size);
    double tangent = across / (along + std::sqrt(across * across + along * along));
    for (int k = 0; k < 2; ++k) tangent = tangent / (1 + std::sqrt(1 + tangent * tangent));
    const double square = tangent * tangent;
    double series = 0;
    for (int k = TERMS - 1; k >= 0; --k) series = (k % 2 == 0 ? 1.0 : -1.0) / (2 * k + 1) + square * series;
    const double angle = (8 * tangent) * series;
    return x < 0 ? PI - angle : angle;
}

TM_INLINE double angle_at(Corner p, Corner q, Corner r) {
    const double ux = q.x - p.x, uy = q.y - p.y, vx = r.x - p.x, vy = r.y - p.y;
    return arctangent(std::abs(ux * vy - uy * vx), ux * vx + uy * vy);
}

// As `least_positive_root` in torchmesh/warping/boundary_path.py.
TM_INLINE double least_positive_root(double a, double b, double c) {
    double size = std::max(std::max(std::abs(a), std::abs(b)), std::abs(c));
    if (std::isnan(a) || std::isnan(b) || std::isnan(c)) size = std::numeric_limits<double>::quiet_NaN();
    size = size > 0 ? size : 1.0;
    a /= size;
    b /= size;
    c /= size;
    const double discriminant = b * b - 4 * a * c;
    const double s = std::sqrt(std::max(discriminant, 0.0));
    const double falling = b > 0 ? -(b + s) : 2 * c, divisor = b > 0 ? 2 * a : s - b;
    const bool exists = discriminant >= 0 && (b > 0 ? a < 0 : divisor > 0);
    if (!(c > 0)) return 0.0;
    return exists ? falling / divisor : std::numeric_limits<double>::infinity();
}

// The sign of the rows a, b, c.
TM_INLINE int sign(const double* points, std::int64_t a, std::int64_t b, std::int64_t c) {
    const Corner p = at(points, a), q = at(points, b), r = at(points, c);
    return orientation(p.x, p.y, q.x, q.y, r.x, r.y);
}

// Do the segments meet other than in a vertex both have?  Their boxes overlap.
bool meet(const double* points, const std::int64_t* one, const std::int64_t* two) {
    const std::int64_t a = one[0], b = one[1], c = two[0], d = two[1];
    const int shared = (a == c || a == d) + (b == c || b == d);
    if (shared == 2) return true;
    if (shared == 0)
        return sign(points, a, b, c) * sign(points, a, b, d) <= 0 && sign(points, c, d, a) * sign(points, c, d, b) <= 0;
    // Two edges with one common vertex meet elsewhere only if they run the same way from it.
    const std::int64_t origin = a == c || a == d ? a : b, p = origin == a ? b : a, q = origin == c ? d : c;
    const Corner o = at(points, origin), u = at(points, p), v = at(points, q);
    const bool same_way = sign_of(u.x - o.x) == sign_of(v.x - o.x) && sign_of(u.y - o.y) == sign_of(v.y - o.y);
    return same_way && sign(points, origin, p, q) == 0;
}

}  // namespace
}  // namespace torchmesh

using torchmesh::at;

// Which half-edges (count,) lie on the edges (number, 2), whichever way they run.
TM_EXPORT void tm_half_edges_on(const std::int64_t* triangles, std::int64_t count, const std::int64_t* edges,
                                std::int64_t number, std::int64_t vertices, std::uint8_t* out) {
    // The edges of each vertex that is their lower end: other[start[v]] ... other[start[v + 1] - 1].
    std::vector<std::int64_t> start(vertices + 1, 0), other(number);
    for (std::int64_t i = 0; i < number; ++i) ++start[std::min(edges[2 * i], edges[2 * i + 1]) + 1];
    for (std::int64_t v = 0; v < vertices; ++v) start[v + 1] += start[v];
    std::vector<std::int64_t> next(start.begin(), start.end() - 1);
    for (std::int64_t i = 0; i < number; ++i) {
        const auto ends = std::minmax(edges[2 * i], edges[2 * i + 1]);
        other[next[ends.first]++] = ends.second;
    }
    for (std::int64_t h = 0; h < count; ++h) {
        const std::int64_t u = triangles[h], v = triangles[h % 3 == 2 ? h - 2 : h + 1], low = std::min(u, v);
        const std::int64_t* end = other.data() + start[low + 1];
        out[h] = std::find(static_cast<const std::int64_t*>(other.data()) + start[low], end, std::max(u, v)) != end;
    }
}

// The half-edges `among` (count,) whose triangle is at most `share` times as high above them as they are long; their
// number is returned.
TM_EXPORT std::int64_t tm_low_half_edges(const double* points, const std::int64_t* triangles, const std::uint8_t* among,
                                         std::int64_t count, double share, std::int64_t* out) {
    std::int64_t found = 0;
    for (std::int64_t h = 0; h < count; ++h) {
        if (!among[h]) continue;
        const std::int64_t first = h - h % 3;
        const auto p = at(points, triangles[h]), q = at(points, triangles[first + (h + 1) % 3]),
                   apex = at(points, triangles[first + (h + 2) % 3]);
        const double ex = q.x - p.x, ey = q.y - p.y;
        if (ex * (apex.y - p.y) - ey * (apex.x - p.x) <= share * (ex * ex + ey * ey)) out[found++] = h;
    }
    return found;
}

TM_EXPORT void tm_row_signs(const double* points, const std::int64_t* a, const std::int64_t* b, const std::int64_t* c,
                            std::int64_t count, std::int8_t* out) {
    for (std::int64_t i = 0; i < count; ++i) out[i] = std::int8_t(torchmesh::sign(points, a[i], b[i], c[i]));
}

// Area, inverse mean ratio, and whether upright, of triangles (count, 3).
TM_EXPORT void tm_measure(const double* points, const std::int64_t* triangles, std::int64_t count, double* area,
                          double* ratio, std::uint8_t* upright) {
    using torchmesh::Corner;
    for (std::int64_t i = 0; i < count; ++i) {
        const Corner a = at(points, triangles[3 * i]), b = at(points, triangles[3 * i + 1]),
                     c = at(points, triangles[3 * i + 2]);
        const double abx = b.x - a.x, aby = b.y - a.y, acx = c.x - a.x, acy = c.y - a.y, bcx = c.x - b.x, bcy = c.y - b.y;
        area[i] = 0.5 * (abx * acy - aby * acx);
        const double size = std::abs(area[i]);
        const double squares = ((abx * abx + aby * aby) + (bcx * bcx + bcy * bcy)) + (acx * acx + acy * acy);
        ratio[i] = size > 0 ? squares / ((4 * torchmesh::SQRT3) * size) : std::numeric_limits<double>::infinity();
        upright[i] = torchmesh::orientation(a.x, a.y, b.x, b.y, c.x, c.y) > 0;
    }
}

// When each triangle is first flat on the straight way from points to target, both about the centres of the meshes and
// in their units.
TM_EXPORT void tm_first_flat(const double* points, const double* target, const double* centre, const double* unit,
                             const std::int64_t* triangles, const std::int64_t* offsets, std::int64_t meshes,
                             double* flat) {
    using torchmesh::Corner;
    for (std::int64_t m = 0; m < meshes; ++m) {
        const double x = centre[2 * m], y = centre[2 * m + 1], scale = unit[m];
        for (std::int64_t t = offsets[m]; t < offsets[m + 1]; ++t) {
            Corner p[3], w[3];
            for (int k = 0; k < 3; ++k) {
                const Corner from = at(points, triangles[3 * t + k]), to = at(target, triangles[3 * t + k]);
                p[k] = {(from.x - x) / scale, (from.y - y) / scale};
                w[k] = {(to.x - from.x) / scale, (to.y - from.y) / scale};
            }
            const double px = p[1].x - p[0].x, py = p[1].y - p[0].y, qx = p[2].x - p[0].x, qy = p[2].y - p[0].y;
            const double dx = w[1].x - w[0].x, dy = w[1].y - w[0].y, ex = w[2].x - w[0].x, ey = w[2].y - w[0].y;
            flat[t] = torchmesh::least_positive_root(dx * ey - dy * ex, px * ey - py * ex + dx * qy - dy * qx,
                                                     px * qy - py * qx);
        }
    }
}

// The smallest unsigned angle of each triangle in radians, 0 for a flat one; and its inverse mean ratio.
TM_EXPORT void tm_shapes(const double* points, const std::int64_t* triangles, std::int64_t count, double* angle,
                         double* ratio) {
    using torchmesh::Corner, torchmesh::angle_at;
    for (std::int64_t i = 0; i < count; ++i) {
        const Corner a = at(points, triangles[3 * i]), b = at(points, triangles[3 * i + 1]),
                     c = at(points, triangles[3 * i + 2]);
        const double abx = b.x - a.x, aby = b.y - a.y, acx = c.x - a.x, acy = c.y - a.y, bcx = c.x - b.x,
                     bcy = c.y - b.y, cax = a.x - c.x, cay = a.y - c.y;
        const double area = 0.5 * (abx * acy - aby * acx), size = std::abs(area);
        const double squares = ((abx * abx + aby * aby) + (bcx * bcx + bcy * bcy)) + (cax * cax + cay * cay);
        ratio[i] = size > 0 ? squares / ((4 * torchmesh::SQRT3) * size) : std::numeric_limits<double>::infinity();
        const double at_a = angle_at(a, b, c), at_b = angle_at(b, c, a), at_c = angle_at(c, a, b);
        const double least = std::min(at_a, std::min(at_b, at_c));
        angle[i] = area == 0 ? 0.0 : std::isnan((at_a + at_b) + at_c) ? std::nan("") : least;
    }
}

// The twin of each half-edge of triangles (count, 3), -1 on the boundary: the half-edges of each lower end are compared.
TM_EXPORT void tm_twins(const std::int64_t* triangles, std::int64_t count, std::int64_t vertices, std::int64_t* twin) {
    const std::int64_t total = 3 * count;
    std::vector<std::int64_t> start(std::size_t(vertices) + 1, 0), bucket(static_cast<std::size_t>(total));
    auto tail = [&](std::int64_t h) { return triangles[h]; };
    auto head = [&](std::int64_t h) { return triangles[h % 3 == 2 ? h - 2 : h + 1]; };
    for (std::int64_t h = 0; h < total; ++h) ++start[std::min(tail(h), head(h)) + 1];
    for (std::int64_t v = 0; v < vertices; ++v) start[v + 1] += start[v];
    std::vector<std::int64_t> next(start.begin(), start.end() - 1);
    for (std::int64_t h = 0; h < total; ++h) {
        const std::int64_t low = std::min(tail(h), head(h)), high = std::max(tail(h), head(h));
        twin[h] = -1;
        for (std::int64_t k = start[low]; k < next[low]; ++k) {
            const std::int64_t other = bucket[k];
            if (std::max(tail(other), head(other)) != high || twin[other] >= 0) continue;
            twin[h] = other;
            twin[other] = h;
            break;
        }
        if (twin[h] < 0) bucket[next[low]++] = h;
    }
}

namespace torchmesh {
namespace {

// The pairs that the last search of this thread has found.
thread_local std::vector<std::pair<std::int64_t, std::int64_t>> pairs_found;

}  // namespace
}  // namespace torchmesh

// Writes the pairs that the last search of this thread has found, and forgets them.
TM_EXPORT void tm_pairs_found(std::int64_t* out) {
    for (const auto& pair : torchmesh::pairs_found) {
        *out++ = pair.first;
        *out++ = pair.second;
    }
    torchmesh::pairs_found = {};
}

// The pairs i < j of `segments` (count, 2) of one group that meet other than in a vertex both have, in order; a line is
// swept over them.  Returns how many there are, which are written if there is `room` for them, and are kept for
// `tm_pairs_found` if not; -1 where more than `most` pairs overlap in x.
TM_EXPORT std::int64_t tm_crossing_pairs(const double* points, const std::int64_t* segments, const std::int64_t* group,
                                         std::int64_t count, std::int64_t most, std::int64_t room, std::int64_t* out) {
    struct Box {
        double left, right, low, high;
        std::int64_t row;
    };
    std::vector<Box> boxes(static_cast<std::size_t>(count));
    for (std::int64_t i = 0; i < count; ++i) {
        const auto p = at(points, segments[2 * i]), q = at(points, segments[2 * i + 1]);
        boxes[i] = {std::min(p.x, q.x), std::max(p.x, q.x), std::min(p.y, q.y), std::max(p.y, q.y), i};
    }
    std::sort(boxes.begin(), boxes.end(), [](const Box& a, const Box& b) {
        return a.left < b.left || (a.left == b.left && a.row < b.row);
    });
    auto& found = torchmesh::pairs_found;
    found.clear();
    std::int64_t looked = 0;
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        const Box& a = boxes[i];
        for (std::size_t j = i + 1; j < boxes.size() && boxes[j].left <= a.right; ++j) {
            const Box& b = boxes[j];
            if (++looked > most) return -1;
            if (a.low > b.high || b.low > a.high) continue;
            if (group && group[a.row] != group[b.row]) continue;
            const std::int64_t first = std::min(a.row, b.row), second = std::max(a.row, b.row);
            if (torchmesh::meet(points, segments + 2 * first, segments + 2 * second)) found.emplace_back(first, second);
        }
    }
    std::sort(found.begin(), found.end());
    const std::int64_t pairs = std::int64_t(found.size());
    if (pairs <= room) tm_pairs_found(out);
    return pairs;
}

// The component of each triangle, neighbours across edges; edges that are blocked on both sides part.  Numbered by their
// first triangles.  `stack` has room for all triangles.
TM_EXPORT void tm_triangle_components(const std::int64_t* twin, const std::uint8_t* blocked, std::int64_t count,
                                      std::int64_t* stack, std::int64_t* out) {
    std::fill(out, out + count, std::int64_t(-1));
    std::int64_t components = 0;
    for (std::int64_t first = 0; first < count; ++first) {
        if (out[first] >= 0) continue;
        std::int64_t waiting = 0;
        stack[waiting++] = first;
        out[first] = components;
        while (waiting) {
            const std::int64_t t = stack[--waiting];
            for (std::int64_t h = 3 * t; h < 3 * t + 3; ++h) {
                const std::int64_t g = twin[h];
                if (g < 0 || out[g / 3] >= 0 || (blocked && blocked[h] && blocked[g])) continue;
                out[g / 3] = components;
                stack[waiting++] = g / 3;
            }
        }
        ++components;
    }
}

// The closed walks along directed edges (count, 2): their vertices one walk after the other, the number of vertices of
// each, and how many there are; -1 if a walk does not close.
TM_EXPORT std::int64_t tm_boundary_loops(const std::int64_t* edges, std::int64_t count, std::int64_t* order,
                                         std::int64_t* sizes) {
    std::vector<std::int64_t> names(edges, edges + 2 * count);
    std::sort(names.begin(), names.end());
    names.erase(std::unique(names.begin(), names.end()), names.end());
    const std::size_t vertices = names.size();
    std::vector<std::size_t> tail(std::size_t(count), 0), head(tail), start(vertices + 1, 0), onward(tail);
    const auto named = [&](std::int64_t v) {
        return std::size_t(std::lower_bound(names.begin(), names.end(), v) - names.begin());
    };
    for (std::size_t e = 0; e < tail.size(); ++e) {
        tail[e] = named(edges[2 * e]);
        head[e] = named(edges[2 * e + 1]);
        ++start[tail[e] + 1];
    }
    for (std::size_t v = 0; v < vertices; ++v) start[v + 1] += start[v];
    // The edges from v that are left are onward[start[v]] ... onward[left[v] - 1]; the last one is taken first.
    std::vector<std::size_t> left(start.begin(), start.end() - 1), walk;
    for (std::size_t e = 0; e < tail.size(); ++e) onward[left[tail[e]]++] = head[e];
    std::vector<std::int64_t> position(vertices, -1);
    std::int64_t loops = 0;
    for (const std::size_t first : tail) {
        if (left[first] == start[first]) continue;
        walk.assign(1, first);
        position[first] = 0;
        while (!walk.empty()) {
            const std::size_t u = walk.back();
            if (left[u] == start[u]) return -1;
            const std::size_t v = onward[--left[u]];
            if (position[v] < 0) {
                position[v] = std::int64_t(walk.size());
                walk.push_back(v);
                continue;
            }
            const auto from = std::size_t(position[v]);
            for (std::size_t i = from; i < walk.size(); ++i) {
                *order++ = names[walk[i]];
                if (i > from) position[walk[i]] = -1;
            }
            sizes[loops++] = std::int64_t(walk.size() - from);
            walk.resize(from + 1);
            if (left[v] > start[v]) continue;
            position[v] = -1;
            walk.pop_back();
        }
    }
    return loops;
}
