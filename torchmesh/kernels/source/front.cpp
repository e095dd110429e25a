// A mesh of a boundary from nothing: a constrained Delaunay triangulation, and vertices placed by an advancing front.
//
// The front is that of Rebay (Efficient unstructured mesh generation by means of Delaunay triangulation and Bowyer-Watson
// algorithm, Journal of Computational Physics 106, 1993).  A triangle is done when its circle is small for the size wanted.
// The largest of those that are not, but have an edge on the boundary or on a triangle that is, gets a new vertex: on the
// bisector of that edge, where a triangle of the size wanted has its tip.
#include "delaunay.hpp"

#include <memory>
#include <queue>
#include <tuple>

namespace torchmesh {
namespace {

constexpr double SQRT3 = 1.7320508075688772;

// Must have the fields of kernels/meshing.py, `_Outline`, in the same order.
struct Outline {
    const double* points;     // (V, 2)
    std::int64_t vertices;
    const std::uint8_t* held;  // (V,) vertices that must be in the mesh; the others are in the background alone
    const std::int64_t* boundary;  // (N, 2), with the domain on the left
    std::int64_t boundaries;
    const std::int64_t* segments;  // (M, 2) edges inside that must be in the mesh
    std::int64_t inner;
};

// Must have the fields of kernels/meshing.py, `_Front`, in the same order.
struct FrontOptions {
    double done, room;  // circumradius over size below which a triangle is done; distance of vertices over size
    double low;  // least height of a new vertex above a locked edge over the length of that edge
};

std::uint64_t mixed(std::uint64_t i) {
    i = (i + 0x9e3779b97f4a7c15u) * 0xbf58476d1ce4e5b9u;
    i ^= i >> 27;
    return i * 0x94d049bb133111ebu;
}

struct Candidate {
    double radius;
    Row triangle, stamp;

    // The priority queue gives the largest first, and the lower row of equal ones.
    bool operator<(const Candidate& other) const {
        if (radius != other.radius) return radius < other.radius;
        return triangle > other.triangle;
    }
};

class Mesher {
  public:
    enum Fault : std::int32_t { NONE = 0, VERTEX = 1, SEGMENT = 2, BOUNDARY = 3 };

    std::int32_t fault = NONE;
    Row vertices;  // of the outline
    std::unique_ptr<Delaunay> mesh, background;
    std::vector<std::uint8_t> in_background;  // (V,)

    explicit Mesher(const Outline& o) : vertices(Row(o.vertices)) {
        std::vector<double> px(o.vertices), py(o.vertices);
        for (std::int64_t i = 0; i < o.vertices; ++i) px[i] = o.points[2 * i], py[i] = o.points[2 * i + 1];
        mesh = std::make_unique<Delaunay>(px.data(), py.data(), vertices);
        fault = build(o);
        if (fault) return;
        background = std::make_unique<Delaunay>(*mesh);
        in_background.assign(o.held, o.held + o.vertices);
        Row last = 0;
        for (const Row v : in_good_order(o, false)) {
            const Row t = background->locate(px[v], py[v], last, false);
            if (t < 0) continue;
            last = t;
            if (!background->inside[t] || !background->insert(v, t)) continue;
            in_background[v] = 1;
            last = background->made[0];
        }
    }

    // Begins the front; size (V,) is read at the vertices that are in the background.
    void begin(const double* given, const FrontOptions& given_options) {
        options = given_options;
        size.assign(given, given + vertices);
        size.resize(mesh->x.size(), 0);
        near.assign(mesh->x.size(), 0);
        for (Row h = 0; h < Row(background->vertex.size()); ++h)
            if (background->inside[h / 3]) near[background->vertex[h]] = h / 3;
        for (Row t = 0; t < mesh->triangles(); ++t) measure(t);
        for (Row t = 0; t < mesh->triangles(); ++t) ask(t);
    }

    // Places vertices for so many steps; true when nothing is left to do.
    bool advance(std::int64_t steps) {
        while (!waiting.empty()) {
            if (steps-- <= 0) return false;
            const Candidate c = waiting.top();
            waiting.pop();
            if (stamp[c.triangle] != c.stamp || !active(c.triangle)) continue;
            place(c.triangle);
        }
        return true;
    }

    // Puts up to `count` more vertices at the centres of the circles that are largest for the size wanted, after the front.
    void fill(std::int64_t count) {
        waiting = {};
        for (Row t = 0; t < mesh->triangles(); ++t) measure(t);
        for (Row t = 0; t < mesh->triangles(); ++t)
            if (radius[t] > 0) waiting.push({radius[t], t, stamp[t]});
        while (count > 0 && !waiting.empty()) {
            const Candidate c = waiting.top();
            waiting.pop();
            double px, py;
            if (stamp[c.triangle] != c.stamp || !std::isfinite(circle(c.triangle, px, py))) continue;
            if (!place_at(px, py, c.triangle, mesh->vertex[3 * c.triangle], wanted(3 * c.triangle))) continue;
            --count;
            for (const Row m : mesh->made)
                if (radius[m] > 0) waiting.push({radius[m], m, stamp[m]});
        }
    }

    std::vector<double> size;  // (V + 4 + new,)

    // The triangle of the background that the new vertex p was placed in: its corners, and the weights with which a
    // linear function is read there.
    void home(Row p, std::int64_t* corners, double* weights) const {
        const Row* v = &background->vertex[3 * near[p]];
        double sum = 0;
        for (int k = 0; k < 3; ++k) {
            const Row a = v[(k + 1) % 3], b = v[(k + 2) % 3];
            const bool known = v[k] < vertices;
            corners[k] = known ? v[k] : -1;
            weights[k] = known ? std::max(0.0, doubled(a, b, mesh->x[p], mesh->y[p])) : 0.0;
            sum += weights[k];
        }
        for (int k = 0; k < 3; ++k) weights[k] = sum > 0 ? weights[k] / sum : 1.0 / 3;
    }

  private:
    FrontOptions options{};
    std::vector<double> radius;  // (T,) circumradius over size; -1: no vertex goes into it
    std::vector<Row> stamp, near;  // (T,) changes with the triangle; (V + 4 + new,) a triangle of the background
    std::priority_queue<Candidate> waiting;

    // Vertices in rounds, each of twice as many as all before it, and along a snake in each.
    std::vector<Row> in_good_order(const Outline& o, bool held) const {
        std::vector<Row> rows;
        double low[2] = {1e300, 1e300}, high[2] = {-1e300, -1e300};
        for (Row v = 0; v < vertices; ++v) {
            if (bool(o.held[v]) != held || (!held && !std::isfinite(o.points[2 * v] + o.points[2 * v + 1]))) continue;
            rows.push_back(v);
            for (int k = 0; k < 2; ++k) {
                low[k] = std::min(low[k], o.points[2 * v + k]);
                high[k] = std::max(high[k], o.points[2 * v + k]);
            }
        }
        const double width = std::max({high[0] - low[0], high[1] - low[1], 1e-300});
        struct Key {
            std::int32_t round, line, place;
            Row v;
        };
        std::vector<Key> keys;
        keys.reserve(rows.size());
        std::int32_t rounds = 0;
        while ((std::size_t(1) << rounds) < rows.size() / 32 + 1) ++rounds;
        for (const Row v : rows) {
            const std::uint64_t bits = mixed(std::uint64_t(v));
            std::int32_t round = rounds;
            while (round > 0 && (bits >> (63 - (rounds - round)) & 1)) --round;
            const double cells = 0.7 * std::sqrt(double(rows.size()) / double(std::int64_t(1) << (rounds - round))) + 1;
            const std::int32_t line = std::int32_t((o.points[2 * v + 1] - low[1]) / width * cells),
                               place = std::int32_t((o.points[2 * v] - low[0]) / width * cells);
            keys.push_back({round, line, line % 2 ? -place : place, v});
        }
        std::sort(keys.begin(), keys.end(), [](const Key& a, const Key& b) {
            return std::tie(a.round, a.line, a.place, a.v) < std::tie(b.round, b.line, b.place, b.v);
        });
        for (std::size_t i = 0; i < keys.size(); ++i) rows[i] = keys[i].v;
        return rows;
    }

    Fault build(const Outline& o) {
        Delaunay& d = *mesh;
        Row last = 0;
        for (const Row v : in_good_order(o, true)) {
            const Row t = d.locate(d.x[v], d.y[v], last, false);
            if (t < 0 || !d.insert(v, t)) return VERTEX;
            last = d.made[0];
        }
        std::vector<Row> edges(o.boundaries * 2);
        for (std::size_t i = 0; i < edges.size(); ++i) edges[i] = Row(o.boundary[i]);
        for (std::int64_t i = 0; i < o.boundaries; ++i)
            if (!d.recover(edges[2 * i], edges[2 * i + 1])) return SEGMENT;
        for (std::int64_t i = 0; i < o.inner; ++i)
            if (!d.recover(Row(o.segments[2 * i]), Row(o.segments[2 * i + 1]))) return SEGMENT;
        return d.label(edges.data(), Row(o.boundaries)) ? NONE : BOUNDARY;
    }

    // Centre and radius of the circle round a triangle; the radius is infinite where it has no area in floating point.
    double circle(Row t, double& cx, double& cy) const {
        const Row* v = &mesh->vertex[3 * t];
        const double ax = mesh->x[v[0]], ay = mesh->y[v[0]];
        const double bx = mesh->x[v[1]] - ax, by = mesh->y[v[1]] - ay, dx = mesh->x[v[2]] - ax, dy = mesh->y[v[2]] - ay;
        const double area = 2 * (bx * dy - by * dx), b = bx * bx + by * by, d = dx * dx + dy * dy;
        if (!(area > 0)) return std::numeric_limits<double>::infinity();
        const double ux = (dy * b - by * d) / area, uy = (bx * d - dx * b) / area;
        cx = ax + ux, cy = ay + uy;
        return std::sqrt(ux * ux + uy * uy);
    }

    void measure(Row t) {
        if (Row(radius.size()) <= t) radius.resize(t + 1, -1), stamp.resize(t + 1, 0);
        ++stamp[t];
        radius[t] = -1;
        if (mesh->vertex[3 * t] < 0 || !mesh->inside[t]) return;
        double cx, cy;
        const Row* v = &mesh->vertex[3 * t];
        radius[t] = 3 * circle(t, cx, cy) / (size[v[0]] + size[v[1]] + size[v[2]]);
    }

    bool is_front(Row h) const { return mesh->locked[h] || radius[mesh->twin[h] / 3] <= options.done; }

    bool active(Row t) const {
        if (!(radius[t] > options.done)) return false;
        return is_front(3 * t) || is_front(3 * t + 1) || is_front(3 * t + 2);
    }

    void ask(Row t) {
        if (mesh->inside[t] && active(t)) waiting.push({radius[t], t, stamp[t]});
    }

    void place(Row t) {
        // Of several edges on the front the one that is nearest to its size comes first.
        for (int tries = 0; tries < 3; ++tries) {
            Row best = -1;
            double least = std::numeric_limits<double>::infinity();
            for (Row h = 3 * t; h < 3 * t + 3; ++h) {
                if (!is_front(h) || (refused >> (h - 3 * t) & 1)) continue;
                const double off = std::abs(std::log(length(h) / wanted(h)));
                if (off < least) least = off, best = h;
            }
            if (best < 0) break;
            if (place_on(best)) {
                refused = 0;
                return;
            }
            refused |= 1 << (best - 3 * t);
        }
        refused = 0;
        radius[t] = -1;
        ++stamp[t];
        // What is given up counts as done for its neighbours.
        for (Row h = 3 * t; h < 3 * t + 3; ++h)
            if (mesh->twin[h] >= 0) ask(mesh->twin[h] / 3);
    }

    int refused = 0;

    double length(Row h) const {
        const Row u = mesh->vertex[h], w = mesh->vertex[next_in_triangle(h)];
        const double dx = mesh->x[w] - mesh->x[u], dy = mesh->y[w] - mesh->y[u];
        return std::sqrt(dx * dx + dy * dy);
    }

    double wanted(Row h) const { return 0.5 * (size[mesh->vertex[h]] + size[mesh->vertex[next_in_triangle(h)]]); }

    bool place_on(Row h) {
        const Row u = mesh->vertex[h], w = mesh->vertex[next_in_triangle(h)], t = h / 3;
        const double mx = 0.5 * (mesh->x[u] + mesh->x[w]), my = 0.5 * (mesh->y[u] + mesh->y[w]), edge = length(h);
        // The normal to the left.
        const double nx = -(mesh->y[w] - mesh->y[u]) / edge, ny = (mesh->x[w] - mesh->x[u]) / edge;
        double cx, cy;
        if (!std::isfinite(circle(t, cx, cy))) return false;
        const double depth = (cx - mx) * nx + (cy - my) * ny, height = 0.5 * SQRT3 * wanted(h);
        const double far = std::min(height, depth);
        if (!(far > 0)) return false;
        if (!place_at(mx + far * nx, my + far * ny, t, u, wanted(h))) return false;
        for (const Row m : mesh->made) {
            ask(m);
            const Row across = mesh->twin[3 * m];
            if (across >= 0) ask(across / 3);
        }
        return true;
    }

    // Puts a vertex at a point near the triangle t and its corner u, and measures the triangles that this makes; `usual` is
    // the size where the background knows none.
    bool place_at(double px, double py, Row t, Row u, double usual) {
        const Row where = mesh->locate(px, py, t, true);
        if (where < 0 || !mesh->inside[where]) return false;
        Row hint = background->locate(px, py, near[u], false);
        if (hint < 0 || !background->inside[hint]) hint = near[u];
        double here = size_in_background(hint, px, py);
        if (!(here > 0)) here = usual;
        const Row p = Row(mesh->x.size());
        mesh->x.push_back(px), mesh->y.push_back(py), mesh->at.push_back(-1);
        if (!mesh->insert(p, where, options.room * here, options.low)) {
            mesh->x.pop_back(), mesh->y.pop_back(), mesh->at.pop_back();
            return false;
        }
        size.push_back(here), near.push_back(hint);
        for (const Row m : mesh->made) measure(m);
        return true;
    }

    // Twice the area of the triangle of two vertices of the background and a point.
    double doubled(Row a, Row b, double px, double py) const {
        return (background->x[a] - px) * (background->y[b] - py) - (background->y[a] - py) * (background->x[b] - px);
    }

    double size_in_background(Row t, double px, double py) const {
        const Row* v = &background->vertex[3 * t];
        double sum = 0, weights = 0;
        for (int k = 0; k < 3; ++k) {
            if (v[k] >= vertices) return -1;
            const double area = std::max(0.0, doubled(v[(k + 1) % 3], v[(k + 2) % 3], px, py));
            sum += area * size[v[k]], weights += area;
        }
        return weights > 0 ? sum / weights : -1;
    }
};

// The triangles of the domain as (T, 3) int64; returns their number.  `out` may be null.
std::int64_t triangles_of(const Delaunay& d, std::int64_t* out) {
    std::int64_t count = 0;
    for (Row t = 0; t < d.triangles(); ++t) {
        if (d.vertex[3 * t] < 0 || !d.inside[t]) continue;
        if (out)
            for (int k = 0; k < 3; ++k) out[3 * count + k] = d.vertex[3 * t + k];
        ++count;
    }
    return count;
}

}  // namespace
}  // namespace torchmesh

// Triangulates an outline; the mesher is freed by tm_mesher_end.  `fault` says what stands in the way, 0 for nothing.
TM_EXPORT void* tm_mesher_start(const torchmesh::Outline* outline, std::int32_t* fault) {
    auto* mesher = new torchmesh::Mesher(*outline);
    *fault = mesher->fault;
    return mesher;
}

// The triangles of the background; vertices keep their rows.
TM_EXPORT std::int64_t tm_mesher_background(const torchmesh::Mesher* mesher, std::int64_t* triangles) {
    return torchmesh::triangles_of(*mesher->background, triangles);
}

TM_EXPORT void tm_mesher_begin(torchmesh::Mesher* mesher, const double* size, const torchmesh::FrontOptions* options) {
    mesher->begin(size, *options);
}

TM_EXPORT std::int32_t tm_mesher_advance(torchmesh::Mesher* mesher, std::int64_t steps) { return mesher->advance(steps); }

TM_EXPORT void tm_mesher_fill(torchmesh::Mesher* mesher, std::int64_t count) { mesher->fill(count); }

// The triangles of the mesh; of the new vertices, whose rows follow those of the outline, the positions (N, 2), sizes
// (N,), and corners and weights (N, 3) in the background.  Returns the number of triangles, and writes that of new
// vertices in `added`.
TM_EXPORT std::int64_t tm_mesher_mesh(const torchmesh::Mesher* mesher, std::int64_t* triangles, double* points,
                                      double* sizes, std::int64_t* corners, double* weights, std::int64_t* added) {
    using namespace torchmesh;
    const Delaunay& d = *mesher->mesh;
    const Row first = mesher->vertices + 4, last = Row(d.x.size());
    *added = last - first;
    const std::int64_t count = triangles_of(d, triangles);
    if (!triangles) return count;
    for (std::int64_t i = 0; i < 3 * count; ++i)
        if (triangles[i] >= first) triangles[i] -= 4;
    for (Row v = first; v < last; ++v) {
        points[2 * (v - first)] = d.x[v], points[2 * (v - first) + 1] = d.y[v];
        sizes[v - first] = mesher->size[v];
        mesher->home(v, corners + 3 * (v - first), weights + 3 * (v - first));
    }
    return count;
}

TM_EXPORT void tm_mesher_end(torchmesh::Mesher* mesher) { delete mesher; }
