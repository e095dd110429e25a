// A constrained Delaunay triangulation under construction: vertices go in one by one, segments are recovered by flips,
// and every sign is exact.
//
// The whole plane round the vertices is triangulated, inside a box.  `inside` says which triangles are in the domain.
// Half-edges are those of torchmesh/mesh/connectivity.py: h = 3 * triangle + corner, from its corner to the next one.
#pragma once

#include "exact.hpp"

namespace torchmesh {

using Row = std::int32_t;

inline Row next_in_triangle(Row h) { return h % 3 == 2 ? h - 2 : h + 1; }
inline Row previous_in_triangle(Row h) { return h % 3 == 0 ? h + 2 : h - 1; }

class Delaunay {
  public:
    std::vector<double> x, y;
    std::vector<Row> vertex, twin;  // (3T,); vertex is -1 in triangles that are gone
    std::vector<std::uint8_t> locked;  // (3T,), of both half-edges of an edge that no step removes
    std::vector<std::uint8_t> inside;  // (T,)
    std::vector<Row> at;               // (V,) a half-edge that begins at the vertex
    std::vector<Row> made;             // the triangles that the last step made

    // A box round the points, far from all of them.  Its corners are the rows `count` to `count + 3`.
    Delaunay(const double* px, const double* py, Row count) : x(px, px + count), y(py, py + count) {
        double low[2] = {x[0], y[0]}, high[2] = {x[0], y[0]};
        for (Row i = 0; i < count; ++i) {
            low[0] = std::min(low[0], x[i]), high[0] = std::max(high[0], x[i]);
            low[1] = std::min(low[1], y[i]), high[1] = std::max(high[1], y[i]);
        }
        const double reach = 8 * std::max(high[0] - low[0], high[1] - low[1]);
        const double left = low[0] - reach, right = high[0] + reach, bottom = low[1] - reach, top = high[1] + reach;
        const double corner_x[4] = {left, right, right, left}, corner_y[4] = {bottom, bottom, top, top};
        x.insert(x.end(), corner_x, corner_x + 4);
        y.insert(y.end(), corner_y, corner_y + 4);
        vertex = {count, count + 1, count + 2, count, count + 2, count + 3};
        twin = {-1, -1, 3, 2, -1, -1};
        locked.assign(6, 0);
        inside.assign(2, 0);
        at.assign(x.size(), -1);
        for (Row h = 0; h < 6; ++h) at[vertex[h]] = h;
        mark.assign(2, 0);
    }

    Row triangles() const { return Row(vertex.size() / 3); }

    int side(Row a, Row b, Row c) const { return orientation(x[a], y[a], x[b], y[b], x[c], y[c]); }

    int side(Row a, Row b, double px, double py) const { return orientation(x[a], y[a], x[b], y[b], px, py); }

    // A triangle that the point is in or on, by walking from the triangle `start`; -1 where the walk would cross a
    // locked edge and `blocked` says that it must not, or where it does not end.
    Row locate(double px, double py, Row start, bool blocked) const {
        Row t = start, from = -1;
        for (Row steps = 0, limit = 4 * triangles() + 64; steps < limit; ++steps) {
            Row across = -1;
            // The edge that is asked first changes, so that a walk cannot go round in a circle.
            for (int k = 0, first = steps % 3; k < 3; ++k) {
                const Row h = 3 * t + (first + k) % 3;
                if (twin[h] >= 0 && twin[h] / 3 == from) continue;
                if (side(vertex[h], vertex[next_in_triangle(h)], px, py) < 0) {
                    across = h;
                    break;
                }
            }
            if (across < 0) return t;
            if (twin[across] < 0 || (blocked && locked[across])) return -1;
            from = t;
            t = twin[across] / 3;
        }
        return -1;
    }

    // Puts the vertex p in; `t` is a triangle that it is in or on.  False, and nothing has changed, where it lies on a
    // locked edge or on another vertex, or, if `room` is given, where a corner of its cavity is nearer than that.
    bool insert(Row p, Row t, double room = 0, double low = 0) {
        const double px = x[p], py = y[p];
        banned.clear();
        for (int tries = 0; tries < 32; ++tries) {
            if (!find_cavity(px, py, t)) return false;
            // Round the end of a segment the search may have come to triangles that p does not see.
            Row hidden = -1;
            for (const Row h : rim)
                if (side(vertex[h], vertex[next_in_triangle(h)], px, py) <= 0) hidden = h / 3;
            if (hidden < 0) break;
            if (hidden == t || tries == 31) return false;
            banned.push_back(hidden);
        }
        if (room > 0)
            for (const Row h : rim) {
                const double dx = px - x[vertex[h]], dy = py - y[vertex[h]];
                if (dx * dx + dy * dy < room * room) return false;
                if (!locked[h]) continue;
                const Row w = vertex[next_in_triangle(h)];
                const double ex = x[w] - x[vertex[h]], ey = y[w] - y[vertex[h]];
                if (ex * dy - ey * dx < low * (ex * ex + ey * ey)) return false;
            }
        fill_cavity(p);
        return true;
    }

    // The half-edge from u to w; -1 if there is none.
    Row edge(Row u, Row w) const {
        const Row first = at[u];
        for (Row h = first; h >= 0;) {
            if (vertex[next_in_triangle(h)] == w) return h;
            h = twin[previous_in_triangle(h)];
            if (h == first) break;
        }
        return -1;
    }

    // Makes the segment from u to w an edge, and locks it; false where a vertex or a locked edge is in its way.
    bool recover(Row u, Row w) {
        Row h = edge(u, w);
        if (h < 0) {
            if (!collect_crossed(u, w) || !flip_crossed(u, w)) return false;
            h = edge(u, w);
        }
        locked[h] = locked[twin[h]] = 1;
        restore();
        return true;
    }

    // Labels the triangles of the domain: those on the left of the boundary edges, and what they reach without crossing
    // another one.  False where the boundary does not close.
    bool label(const Row* edges, Row count) {
        std::vector<std::uint8_t> wall(vertex.size(), 0);
        std::vector<Row> stack;
        std::fill(inside.begin(), inside.end(), std::uint8_t(0));
        for (Row i = 0; i < count; ++i) {
            const Row h = edge(edges[2 * i], edges[2 * i + 1]);
            if (h < 0 || wall[h]) return false;
            wall[h] = wall[twin[h]] = 1;
            stack.push_back(h / 3);
        }
        while (!stack.empty()) {
            const Row t = stack.back();
            stack.pop_back();
            if (inside[t]) continue;
            inside[t] = 1;
            for (Row h = 3 * t; h < 3 * t + 3; ++h) {
                if (twin[h] < 0) return false;
                if (!wall[h]) stack.push_back(twin[h] / 3);
            }
        }
        for (Row i = 0; i < count; ++i)
            if (inside[twin[edge(edges[2 * i], edges[2 * i + 1])] / 3]) return false;
        return true;
    }

  private:
    std::vector<Row> mark;  // (T,) the number of the last search that met the triangle
    Row searches = 0;
    std::vector<Row> cavity, rim, banned, crossed, changed;

    void new_triangle(Row t) {
        if (t < triangles()) return;
        vertex.resize(3 * (t + 1), -1), twin.resize(3 * (t + 1), -1), locked.resize(3 * (t + 1), 0);
        inside.resize(t + 1, 0), mark.resize(t + 1, 0);
    }

    bool in_circle(Row t, double px, double py) const {
        const Row *v = &vertex[3 * t];
        return incircle(x[v[0]], y[v[0]], x[v[1]], y[v[1]], x[v[2]], y[v[2]], px, py) > 0;
    }

    // The triangles whose circles the point is in, from t on, and the half-edges round them.
    bool find_cavity(double px, double py, Row t) {
        ++searches;
        cavity.assign(1, t);
        rim.clear();
        mark[t] = searches;
        for (const Row b : banned) mark[b] = -searches;
        for (std::size_t i = 0; i < cavity.size(); ++i)
            for (Row h = 3 * cavity[i]; h < 3 * cavity[i] + 3; ++h) {
                const Row g = twin[h];
                if (g < 0 || locked[h]) {
                    if (i == 0 && side(vertex[h], vertex[next_in_triangle(h)], px, py) == 0) return false;
                    rim.push_back(h);
                    continue;
                }
                const Row other = g / 3;
                if (mark[other] == searches) continue;
                bool taken = mark[other] != -searches && in_circle(other, px, py);
                // A point on an edge is in the triangles of both sides.
                if (!taken && i == 0) taken = side(vertex[h], vertex[next_in_triangle(h)], px, py) == 0;
                if (taken) {
                    mark[other] = searches;
                    cavity.push_back(other);
                } else {
                    rim.push_back(h);
                }
            }
        // What was met before its neighbour had been taken in is not on the rim.
        std::size_t kept = 0;
        for (const Row h : rim)
            if (twin[h] < 0 || locked[h] || mark[twin[h] / 3] != searches) rim[kept++] = h;
        rim.resize(kept);
        for (const Row h : rim)
            if (x[vertex[h]] == px && y[vertex[h]] == py) return false;
        return true;
    }

    void fill_cavity(Row p) {
        made.clear();
        struct Side {
            Row tail, head, outer;
            std::uint8_t locked;
        };
        std::vector<Side> sides;
        sides.reserve(rim.size());
        for (const Row h : rim) sides.push_back({vertex[h], vertex[next_in_triangle(h)], twin[h], locked[h]});
        const std::uint8_t label = inside[cavity[0]];
        // A cavity that is a star has two sides more than triangles.
        Row slot = 0;
        for (const Side& s : sides) {
            const Row t = slot < Row(cavity.size()) ? cavity[slot] : triangles();
            ++slot;
            new_triangle(t);
            made.push_back(t);
            vertex[3 * t] = s.tail, vertex[3 * t + 1] = s.head, vertex[3 * t + 2] = p;
            twin[3 * t] = s.outer;
            if (s.outer >= 0) twin[s.outer] = 3 * t;
            locked[3 * t] = s.locked, locked[3 * t + 1] = locked[3 * t + 2] = 0;
            inside[t] = label;
            at[s.tail] = 3 * t;
        }
        for (const Row t : made) {
            const Row g = at[vertex[3 * t + 1]] + 2;
            twin[3 * t + 1] = g;
            twin[g] = 3 * t + 1;
        }
        at[p] = 3 * made[0] + 2;
    }

    // The half-edges between u and w that the segment crosses, in order.
    bool collect_crossed(Row u, Row w) {
        crossed.clear();
        const Row first = at[u];
        Row h = first;
        for (;;) {
            const Row a = vertex[next_in_triangle(h)], b = vertex[previous_in_triangle(h)];
            const int right = side(u, w, a), left = side(u, w, b);
            // A vertex on the segment, on this side of u, is in its way.
            if (right == 0 && ahead(u, w, a)) return false;
            if (right < 0 && left > 0) break;
            h = twin[previous_in_triangle(h)];
            if (h < 0 || h == first) return false;
        }
        Row across = next_in_triangle(h);
        for (;;) {
            if (locked[across] || twin[across] < 0) return false;
            crossed.push_back(across);
            const Row g = twin[across], tip = vertex[previous_in_triangle(g)];
            if (tip == w) return true;
            const int where = side(u, w, tip);
            if (where == 0) return false;
            across = where > 0 ? next_in_triangle(g) : previous_in_triangle(g);
        }
    }

    bool ahead(Row u, Row w, Row a) const {
        return (x[w] - x[u]) * (x[a] - x[u]) + (y[w] - y[u]) * (y[a] - y[u]) > 0;
    }

    // Flips crossed edges until none is left (Sloan, A fast algorithm for generating constrained Delaunay
    // triangulations, Computers & Structures 47, 1993).
    bool flip_crossed(Row u, Row w) {
        std::vector<std::pair<Row, Row>> waiting;
        for (const Row h : crossed) waiting.emplace_back(vertex[h], vertex[next_in_triangle(h)]);
        changed.clear();
        std::size_t limit = 64 + waiting.size() * waiting.size() * 4, steps = 0;
        for (std::size_t i = 0; i < waiting.size(); ++i) {
            if (++steps > limit) return false;
            const Row h = edge(waiting[i].first, waiting[i].second);
            if (h < 0) continue;
            const Row g = twin[h], a = vertex[h], b = vertex[g], c = vertex[previous_in_triangle(h)],
                      d = vertex[previous_in_triangle(g)];
            if (side(c, a, d) <= 0 || side(d, b, c) <= 0) {
                waiting.emplace_back(a, b);
                continue;
            }
            const Row made_edge = flip(h);
            const int one = side(u, w, c), other = side(u, w, d);
            if (c != u && c != w && d != u && d != w && one * other < 0)
                waiting.emplace_back(c, d);
            else
                changed.push_back(made_edge / 3), changed.push_back(twin[made_edge] / 3);
        }
        return edge(u, w) >= 0;
    }

    // Turns the edge h inside its quadrilateral; the new half-edge, which the first triangle has.
    Row flip(Row h) {
        const Row g = twin[h], t = h / 3, s = g / 3;
        const Row h1 = next_in_triangle(h), h2 = previous_in_triangle(h), g1 = next_in_triangle(g),
                  g2 = previous_in_triangle(g);
        const Row a = vertex[h], b = vertex[g], c = vertex[h2], d = vertex[g2];
        const Row old[4] = {h2, g1, g2, h1};
        Row outer[4];
        std::uint8_t lock[4];
        for (int k = 0; k < 4; ++k) outer[k] = twin[old[k]], lock[k] = locked[old[k]];
        // The triangles are now c a d and d b c.
        const Row fresh[4] = {3 * t, 3 * t + 1, 3 * s, 3 * s + 1};
        vertex[3 * t] = c, vertex[3 * t + 1] = a, vertex[3 * t + 2] = d;
        vertex[3 * s] = d, vertex[3 * s + 1] = b, vertex[3 * s + 2] = c;
        for (int k = 0; k < 4; ++k) {
            twin[fresh[k]] = outer[k];
            if (outer[k] >= 0) twin[outer[k]] = fresh[k];
            locked[fresh[k]] = lock[k];
        }
        twin[3 * t + 2] = 3 * s + 2, twin[3 * s + 2] = 3 * t + 2;
        locked[3 * t + 2] = locked[3 * s + 2] = 0;
        at[c] = 3 * t, at[a] = 3 * t + 1, at[d] = 3 * s, at[b] = 3 * s + 1;
        return 3 * t + 2;
    }

    // Flips the edges of the changed triangles, and what follows from that, until they are Delaunay.
    void restore() {
        while (!changed.empty()) {
            const Row t = changed.back();
            changed.pop_back();
            for (Row h = 3 * t; h < 3 * t + 3; ++h) {
                const Row g = twin[h];
                if (g < 0 || locked[h]) continue;
                const Row d = vertex[previous_in_triangle(g)];
                if (!in_circle(t, x[d], y[d])) continue;
                const Row made_edge = flip(h);
                changed.push_back(made_edge / 3), changed.push_back(twin[made_edge] / 3);
                break;
            }
        }
    }
};

}  // namespace torchmesh
