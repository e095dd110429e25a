// Newton steps with the Hessian of each triangle made positive, and steps of Levenberg and Marquardt, for one mesh.
//
// The methods are those of torchmesh/optimising/projected_newton.py and levenberg.py, where they are explained; names
// are the same.  The matrix consists of blocks of 2 x 2 numbers, one for each pair of neighbours, in an order of few
// fill-ins that Python hands over.  Where its factors K = L D L^T have blocks follows from that order alone (Davis,
// Direct methods for sparse linear systems, SIAM, 2006, chapter 4), and is found once.
#include <memory>

#include "common.hpp"

namespace torchmesh {
namespace {

using Index = std::int32_t;

struct Vector {
    double x = 0, y = 0;
};

// Rows of a matrix of 2 x 2.
struct Block {
    double xx = 0, xy = 0, yx = 0, yy = 0;
};

TM_INLINE void add(Block& to, const Block& b, double factor) {
    to.xx += factor * b.xx;
    to.xy += factor * b.xy;
    to.yx += factor * b.yx;
    to.yy += factor * b.yy;
}

// to -= a b^T
TM_INLINE void subtract_by_transposed(Block& to, const Block& a, const Block& b) {
    to.xx -= a.xx * b.xx + a.xy * b.xy;
    to.xy -= a.xx * b.yx + a.xy * b.yy;
    to.yx -= a.yx * b.xx + a.yy * b.xy;
    to.yy -= a.yx * b.yx + a.yy * b.yy;
}

// a b^-1, with the inverse given
TM_INLINE Block times(const Block& a, const Block& b) {
    return {a.xx * b.xx + a.xy * b.yx, a.xx * b.xy + a.xy * b.yy, a.yx * b.xx + a.yy * b.yx, a.yx * b.xy + a.yy * b.yy};
}

// The blocks below and on the diagonal of a symmetric matrix, row by row, and its factors.
class Matrix {
  public:
    // neighbours  of each row, those of lower number, ascending
    explicit Matrix(const std::vector<std::vector<Index>>& neighbours) : size_(Index(neighbours.size())) {
        const Index n = size_;
        std::vector<Index> parent(n, -1), mark(n);
        row_.assign(n + 1, 0);
        start_.assign(n + 1, 0);
        for (Index i = 0; i < n; ++i) {
            mark[i] = i;
            std::vector<Index> reached;
            for (Index k : neighbours[i])
                for (Index j = k; mark[j] != i; j = parent[j]) {
                    if (parent[j] < 0) parent[j] = i;
                    mark[j] = i;
                    reached.push_back(j);
                }
            std::sort(reached.begin(), reached.end());
            column_.insert(column_.end(), reached.begin(), reached.end());
            row_[i + 1] = std::int64_t(column_.size());
            for (Index j : reached) ++start_[j + 1];
        }
        for (Index i = 0; i < n; ++i) start_[i + 1] += start_[i];
        below_.resize(column_.size());
        place_.resize(column_.size());
        std::vector<std::int64_t> next(start_.begin(), start_.end() - 1);
        for (Index i = 0; i < n; ++i)
            for (std::int64_t e = row_[i]; e < row_[i + 1]; ++e) {
                place_[e] = next[column_[e]]++;
                below_[place_[e]] = i;
            }
        lower_.resize(column_.size());
        inverse_.resize(n);
        work_.resize(n);
    }

    std::int64_t blocks() const { return std::int64_t(column_.size()); }

    // Where the block of row i and column j < i stands.
    std::int64_t find(Index i, Index j) const {
        return std::lower_bound(column_.begin() + row_[i], column_.begin() + row_[i + 1], j) - column_.begin();
    }

    // Factorises the matrix with these blocks off and on the diagonal; false where it is singular.
    bool factorise(const Block* off, const Block* diagonal) {
        for (Index i = 0; i < size_; ++i) {
            for (std::int64_t e = row_[i]; e < row_[i + 1]; ++e) work_[column_[e]] = off[e];
            Block pivot = diagonal[i];
            for (std::int64_t e = row_[i]; e < row_[i + 1]; ++e) {
                const Index j = column_[e];
                const Block value = work_[j], entry = times(value, inverse_[j]);
                const std::int64_t end = place_[e];
                for (std::int64_t p = start_[j]; p < end; ++p)
                    subtract_by_transposed(work_[below_[p]], value, lower_[p]);
                subtract_by_transposed(pivot, entry, value);
                lower_[end] = entry;
            }
            const double det = pivot.xx * pivot.yy - pivot.xy * pivot.yx;
            if (!(std::abs(det) > 0) || !std::isfinite(det)) return false;
            inverse_[i] = {pivot.yy / det, -pivot.xy / det, -pivot.yx / det, pivot.xx / det};
        }
        return true;
    }

    // b becomes K^-1 b.
    void solve(Vector* b) const {
        for (Index j = 0; j < size_; ++j)
            for (std::int64_t p = start_[j]; p < start_[j + 1]; ++p) {
                const Block& l = lower_[p];
                b[below_[p]].x -= l.xx * b[j].x + l.xy * b[j].y;
                b[below_[p]].y -= l.yx * b[j].x + l.yy * b[j].y;
            }
        for (Index j = size_; j-- > 0;) {
            const Block& d = inverse_[j];
            double x = d.xx * b[j].x + d.xy * b[j].y, y = d.yx * b[j].x + d.yy * b[j].y;
            for (std::int64_t p = start_[j]; p < start_[j + 1]; ++p) {
                const Block& l = lower_[p];
                const Vector& below = b[below_[p]];
                x -= l.xx * below.x + l.yx * below.y;
                y -= l.xy * below.x + l.yy * below.y;
            }
            b[j] = {x, y};
        }
    }

  private:
    Index size_;
    std::vector<std::int64_t> row_, start_, place_;
    std::vector<Index> column_, below_;
    std::vector<Block> lower_, inverse_, work_;
};

enum Kind : std::int32_t { REGULARISED = 0, LIFTED = 1 };

// Must have the fields of kernels/projected.py, `_Settings`, in the same order.
struct Settings {
    std::int32_t kind, enough;
    double parameter, theta;  // epsilon or alpha
    double slope_tolerance, energy_tolerance, decrease, shortest, floor, common_floor;
};

// Must have the fields of kernels/projected.py, `_Damping`, in the same order.
struct Damping {
    double damping, less, more, good, poor, most, least, energy_tolerance;
    std::int32_t fresh;
};

struct Curved {
    double phi, s, d, ss, sd, dd;
};

TM_INLINE double phi_of(const Settings& o, double stretch, double det) {
    if (o.kind == LIFTED) return std::sqrt(det * det + o.parameter * stretch + o.parameter * o.parameter);
    const double square = o.parameter * o.parameter, root = std::sqrt(square + det * det);
    const double large = 0.5 * (root + std::abs(det)), chi = det > 0 ? large : 0.25 * square / large;
    return ((1 - o.theta) * stretch + o.theta * (1 + det * det)) / chi;
}

TM_INLINE Curved curved_of(const Settings& o, double stretch, double det) {
    if (o.kind == LIFTED) {
        const double phi = phi_of(o, stretch, det), s = 0.5 * o.parameter / phi, d = det / phi;
        return {phi, s, d, -s * s / phi, -s * d / phi, (1 - d * d) / phi};
    }
    const double square = o.parameter * o.parameter, root = std::sqrt(square + det * det);
    const double large = 0.5 * (root + std::abs(det)), inverse = 1 / (det > 0 ? large : 0.25 * square / large);
    const double phi = ((1 - o.theta) * stretch + o.theta * (1 + det * det)) * inverse;
    const double s = (1 - o.theta) * inverse, d = 2 * o.theta * det * inverse - phi / root, part = det / root;
    const double dd = 2 * o.theta * inverse * (1 - part) + (phi * part / root - d) / root;
    return {phi, s, d, 0, -s / root, dd};
}

struct Mesh {
    Index vertices = 0, triangles = 0;
    std::vector<Index> corner;            // (T, 3) vertices
    std::vector<Index> row;               // (V,) of the matrix, or -1
    std::vector<double> parts;            // (T, 3, 2) the weights u and v of the corners in the columns of J
    std::vector<std::int64_t> place;      // (T, 3) blocks of the corner pairs 1-0, 2-0, 2-1, or -1
    std::vector<Vector> points, there, gradient, step;
    std::vector<Block> off, diagonal, held_off, held_diagonal, damped_off, damped_diagonal;
    std::vector<double> det, new_det;
    std::unique_ptr<Matrix> matrix;

    void parts_of(const std::vector<Vector>& at, Index t, double j[4]) const {
        // The conformal part a and the anticonformal part b of J.
        double ux = 0, uy = 0, vx = 0, vy = 0;
        for (int k = 0; k < 3; ++k) {
            const Vector& p = at[corner[3 * t + k]];
            const double u = parts[6 * t + 2 * k], v = parts[6 * t + 2 * k + 1];
            ux += u * p.x;
            uy += u * p.y;
            vx += v * p.x;
            vy += v * p.y;
        }
        j[0] = 0.5 * (ux + vy);
        j[1] = 0.5 * (uy - vx);
        j[2] = 0.5 * (ux - vy);
        j[3] = 0.5 * (uy + vx);
    }

    void clear() {
        std::fill(gradient.begin(), gradient.end(), Vector{});
        std::fill(off.begin(), off.end(), Block{});
        std::fill(diagonal.begin(), diagonal.end(), Block{});
    }

    // Adds the derivatives of a triangle by the parts of J: slope (4) and block (4, 4).
    void assemble(Index t, const double slope[4], const double block[4][4]) {
        double p[3][4][2], q[3][4][2];
        for (int k = 0; k < 3; ++k) {
            const double u = 0.5 * parts[6 * t + 2 * k], v = 0.5 * parts[6 * t + 2 * k + 1];
            const double of[4][2] = {{u, v}, {-v, u}, {u, -v}, {v, u}};
            for (int i = 0; i < 4; ++i)
                for (int c = 0; c < 2; ++c) p[k][i][c] = of[i][c];
            for (int i = 0; i < 4; ++i)
                for (int c = 0; c < 2; ++c)
                    q[k][i][c] = block[i][0] * of[0][c] + block[i][1] * of[1][c] + block[i][2] * of[2][c] +
                                 block[i][3] * of[3][c];
        }
        auto product = [&](int k, int l) {
            Block b;
            for (int i = 0; i < 4; ++i) {
                b.xx += p[k][i][0] * q[l][i][0];
                b.xy += p[k][i][0] * q[l][i][1];
                b.yx += p[k][i][1] * q[l][i][0];
                b.yy += p[k][i][1] * q[l][i][1];
            }
            return b;
        };
        for (int k = 0; k < 3; ++k) {
            const Index i = row[corner[3 * t + k]];
            if (i < 0) continue;
            for (int c = 0; c < 4; ++c) {
                gradient[i].x += slope[c] * p[k][c][0];
                gradient[i].y += slope[c] * p[k][c][1];
            }
            add(diagonal[i], product(k, k), 1);
        }
        constexpr int pair[3][2] = {{1, 0}, {2, 0}, {2, 1}};
        for (int e = 0; e < 3; ++e) {
            const std::int64_t at = place[3 * t + e];
            if (at < 0) continue;
            const int k = pair[e][0], l = pair[e][1];
            const bool ordered = row[corner[3 * t + k]] > row[corner[3 * t + l]];
            add(off[at], ordered ? product(k, l) : product(l, k), 1);
        }
    }

    // The sum of the energy, and det J of each triangle.
    double energy(const std::vector<Vector>& at, const double* weight, const Settings& o, std::vector<double>& dets) {
        double sum = 0;
        for (Index t = 0; t < triangles; ++t) {
            double j[4];
            parts_of(at, t, j);
            const double p = j[0] * j[0] + j[1] * j[1], q = j[2] * j[2] + j[3] * j[3];
            dets[t] = p - q;
            sum += weight[t] * phi_of(o, 2 * (p + q), dets[t]);
        }
        return sum;
    }

    // The sum of the squares of half of what det J lacks to `least`, and det J of each triangle.
    double lack(const std::vector<Vector>& at, const double* weight, double least, std::vector<double>& dets) {
        double sum = 0;
        for (Index t = 0; t < triangles; ++t) {
            double j[4];
            parts_of(at, t, j);
            dets[t] = j[0] * j[0] + j[1] * j[1] - (j[2] * j[2] + j[3] * j[3]);
            const double lacks = std::max(0.5 * (least - dets[t]), 0.0);
            sum += weight[t] * lacks * lacks;
        }
        return sum;
    }

    // The gradient and the positive Hessian.
    void derivatives(const double* weight, const Settings& o) {
        clear();
        if (o.common_floor > 0) {
            double top = 0;
            for (Index t = 0; t < triangles; ++t) top = std::max(top, positive(t, o, 0, 0, nullptr, nullptr));
            common_ = o.common_floor * top;
        } else {
            common_ = 0;
        }
        for (Index t = 0; t < triangles; ++t) {
            double slope[4], block[4][4];
            positive(t, o, o.floor, common_, slope, block);
            for (int i = 0; i < 4; ++i) {
                slope[i] *= weight[t];
                for (int k = 0; k < 4; ++k) block[i][k] *= weight[t];
            }
            assemble(t, slope, block);
        }
        // Where nothing holds a vertex, it stays.
        double greatest = 1e-300;
        for (const Block& d : diagonal) greatest = std::max(greatest, std::max(d.xx, d.yy));
        for (Block& d : diagonal) {
            d.xx += 1e-14 * (d.xx > 0 ? d.xx : greatest);
            d.yy += 1e-14 * (d.yy > 0 ? d.yy : greatest);
        }
    }

    // The gradient of `lack`, and the matrix of Gauss and Newton.
    void gauss_newton(const double* weight, double least) {
        clear();
        for (Index t = 0; t < triangles; ++t) {
            double j[4];
            parts_of(points, t, j);
            const double lacks = 0.5 * (least - (j[0] * j[0] + j[1] * j[1] - (j[2] * j[2] + j[3] * j[3])));
            if (!(lacks > 0)) continue;
            const double by[4] = {2 * j[0], 2 * j[1], -2 * j[2], -2 * j[3]};
            double slope[4], block[4][4];
            for (int i = 0; i < 4; ++i) {
                slope[i] = -lacks * by[i] * weight[t];
                for (int k = 0; k < 4; ++k) block[i][k] = 0.5 * by[i] * by[k] * weight[t];
            }
            assemble(t, slope, block);
        }
    }

    // step = - K^-1 gradient; false where K is singular.
    bool solve(const std::vector<Block>& o, const std::vector<Block>& d) {
        if (!matrix->factorise(o.data(), d.data())) return false;
        for (std::size_t i = 0; i < step.size(); ++i) step[i] = {-gradient[i].x, -gradient[i].y};
        matrix->solve(step.data());
        return true;
    }

    double slope_along() const {
        double sum = 0;
        for (std::size_t i = 0; i < step.size(); ++i) sum += gradient[i].x * step[i].x + gradient[i].y * step[i].y;
        return sum;
    }

    void move(double length) {
        for (Index v = 0; v < vertices; ++v) {
            there[v] = points[v];
            if (row[v] < 0) continue;
            there[v].x += length * step[row[v]].x;
            there[v].y += length * step[row[v]].y;
        }
    }

  private:
    // The derivatives of a triangle by the parts of J, the second ones made positive; its greatest eigenvalue.
    double positive(Index t, const Settings& o, double floor_part, double common, double* slope, double (*block)[4]) {
        double j[4];
        parts_of(points, t, j);
        const double p = j[0] * j[0] + j[1] * j[1], q = j[2] * j[2] + j[3] * j[3];
        const Curved c = curved_of(o, 2 * (p + q), p - q);
        const double f_p = 2 * c.s + c.d, f_q = 2 * c.s - c.d;
        double aa = 2 * f_p + 4 * p * (4 * (c.ss + c.sd) + c.dd), bb = 2 * f_q + 4 * q * (4 * (c.ss - c.sd) + c.dd);
        double ab = 4 * std::sqrt(p * q) * (4 * c.ss - c.dd);
        const double middle = (aa + bb) / 2, half = (aa - bb) / 2, radius = std::hypot(half, ab);
        const double values[4] = {2 * f_p, 2 * f_q, middle + radius, middle - radius};
        double top = 0;
        for (double value : values) top = std::max(top, std::abs(value));
        if (!block) return top;
        const double least = std::max(floor_part * top, common);
        const double across_a = std::max(values[0], least), across_b = std::max(values[1], least);
        const double high = std::max(values[2], least), low = std::max(values[3], least);
        const double part = radius > 0 ? (high - low) / (2 * radius) : 0, centre = (high + low) / 2;
        aa = centre + part * half;
        bb = centre - part * half;
        ab = part * ab;
        const double of_a = std::sqrt(p), of_b = std::sqrt(q);
        const double a[2] = {of_a > 0 ? j[0] / of_a : 1, of_a > 0 ? j[1] / of_a : 0};
        const double b[2] = {of_b > 0 ? j[2] / of_b : 1, of_b > 0 ? j[3] / of_b : 0};
        const double turned_a[2] = {-a[1], a[0]}, turned_b[2] = {-b[1], b[0]};
        for (int i = 0; i < 2; ++i)
            for (int k = 0; k < 2; ++k) {
                block[i][k] = aa * a[i] * a[k] + across_a * turned_a[i] * turned_a[k];
                block[2 + i][2 + k] = bb * b[i] * b[k] + across_b * turned_b[i] * turned_b[k];
                block[i][2 + k] = block[2 + k][i] = ab * a[i] * b[k];
            }
        for (int i = 0; i < 2; ++i) {
            slope[i] = 2 * f_p * j[i];
            slope[2 + i] = 2 * f_q * j[2 + i];
        }
        return top;
    }

    double common_ = 0;
};

bool all_upright(const std::vector<double>& det) {
    for (double d : det)
        if (!(d > 0)) return false;
    return true;
}

void set_points(Mesh& mesh, const double* points) {
    for (Index v = 0; v < mesh.vertices; ++v) mesh.points[v] = {points[2 * v], points[2 * v + 1]};
}

void get_points(const Mesh& mesh, double* points, double* det) {
    for (Index v = 0; v < mesh.vertices; ++v) {
        points[2 * v] = mesh.points[v].x;
        points[2 * v + 1] = mesh.points[v].y;
    }
    std::copy(mesh.det.begin(), mesh.det.end(), det);
}

}  // namespace
}  // namespace torchmesh

// corner (T, 3) are the vertices of the triangles, row (V,) the row of each in the matrix, or -1, and columns (T, 3, 2)
// the weights of the corners in the columns of J.
TM_EXPORT void* tm_projected(std::int32_t vertices, std::int32_t triangles, const std::int32_t* corner,
                             const std::int32_t* row, std::int32_t rows, const double* columns) {
    using namespace torchmesh;
    auto* mesh = new Mesh;
    mesh->vertices = vertices;
    mesh->triangles = triangles;
    mesh->corner.assign(corner, corner + 3 * std::int64_t(triangles));
    mesh->row.assign(row, row + vertices);
    mesh->parts.assign(columns, columns + 6 * std::int64_t(triangles));
    std::vector<std::vector<Index>> neighbours(rows);
    constexpr int pair[3][2] = {{1, 0}, {2, 0}, {2, 1}};
    for (Index t = 0; t < triangles; ++t)
        for (const auto& e : pair) {
            const Index i = row[corner[3 * t + e[0]]], j = row[corner[3 * t + e[1]]];
            if (i >= 0 && j >= 0 && i != j) neighbours[std::max(i, j)].push_back(std::min(i, j));
        }
    for (auto& some : neighbours) {
        std::sort(some.begin(), some.end());
        some.erase(std::unique(some.begin(), some.end()), some.end());
    }
    mesh->matrix = std::make_unique<Matrix>(neighbours);
    mesh->place.assign(3 * std::int64_t(triangles), -1);
    for (Index t = 0; t < triangles; ++t)
        for (int e = 0; e < 3; ++e) {
            const Index i = row[corner[3 * t + pair[e][0]]], j = row[corner[3 * t + pair[e][1]]];
            if (i >= 0 && j >= 0 && i != j) mesh->place[3 * t + e] = mesh->matrix->find(std::max(i, j), std::min(i, j));
        }
    mesh->points.resize(vertices);
    mesh->there.resize(vertices);
    mesh->gradient.resize(rows);
    mesh->step.resize(rows);
    mesh->diagonal.resize(rows);
    mesh->off.resize(mesh->matrix->blocks());
    mesh->det.resize(triangles);
    mesh->new_det.resize(triangles);
    return mesh;
}

TM_EXPORT void tm_end_projected(void* handle) { delete static_cast<torchmesh::Mesh*>(handle); }

// The steps of `minimise_by_projection`, so many at most, from `points` (V, 2), which change.  Gives the energies before
// and after in energy[0] and [1], det (T,), whether that was all in `done`, and returns the steps that were taken.
TM_EXPORT std::int64_t tm_projected_minimise(void* handle, const void* settings, const double* weight,
                                             std::int64_t steps, double* points, double* energy, double* det,
                                             std::int32_t* done) {
    using namespace torchmesh;
    Mesh& mesh = *static_cast<Mesh*>(handle);
    const Settings& o = *static_cast<const Settings*>(settings);
    set_points(mesh, points);
    double value = energy[0] = mesh.energy(mesh.points, weight, o, mesh.det);
    std::int64_t taken = 0;
    *done = 1;
    while (!(o.enough && all_upright(mesh.det))) {
        if (taken == steps) {
            *done = 0;
            break;
        }
        mesh.derivatives(weight, o);
        if (!mesh.solve(mesh.off, mesh.diagonal)) break;
        const double slope = mesh.slope_along();
        if (!(-slope > o.slope_tolerance * std::abs(value))) break;
        double length = 1, now = 0;
        bool found = false;
        for (; length > o.shortest && !found; length *= 0.5) {
            mesh.move(length);
            now = mesh.energy(mesh.there, weight, o, mesh.new_det);
            found = now <= value + o.decrease * length * slope;
        }
        if (!found) break;
        const double before = value;
        mesh.points.swap(mesh.there);
        mesh.det.swap(mesh.new_det);
        value = now;
        ++taken;
        if (!(before - value > o.energy_tolerance * std::abs(before))) break;
    }
    energy[1] = value;
    get_points(mesh, points, det);
    return taken;
}

// The steps of `push_areas` in the same way; `damping` is its state, which is handed back to the next call.
TM_EXPORT std::int64_t tm_projected_push(void* handle, void* damping, double least, const double* weight,
                                         std::int64_t steps, double* points, double* energy, double* det,
                                         std::int32_t* done) {
    using namespace torchmesh;
    Mesh& mesh = *static_cast<Mesh*>(handle);
    Damping& o = *static_cast<Damping*>(damping);
    set_points(mesh, points);
    if (mesh.held_diagonal.empty()) {
        // What holds J of each triangle where it is.
        mesh.clear();
        const double zero[4] = {}, one[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
        for (Index t = 0; t < mesh.triangles; ++t) mesh.assemble(t, zero, one);
        mesh.held_off = mesh.off;
        mesh.held_diagonal = mesh.diagonal;
    }
    double value = energy[0] = mesh.lack(mesh.points, weight, least, mesh.det);
    std::int64_t taken = 0;
    bool known = false;
    *done = 1;
    while (!all_upright(mesh.det)) {
        if (taken == steps) {
            *done = 0;
            break;
        }
        if (o.fresh || !known) mesh.gauss_newton(weight, least);
        known = true;
        ++taken;
        mesh.damped_off = mesh.off;
        mesh.damped_diagonal = mesh.diagonal;
        for (std::size_t e = 0; e < mesh.off.size(); ++e) add(mesh.damped_off[e], mesh.held_off[e], o.damping);
        for (std::size_t i = 0; i < mesh.diagonal.size(); ++i)
            add(mesh.damped_diagonal[i], mesh.held_diagonal[i], o.damping);
        if (!mesh.solve(mesh.damped_off, mesh.damped_diagonal)) break;
        mesh.move(1);
        const double now = mesh.lack(mesh.there, weight, least, mesh.new_det);
        // The damped model promises half of what its slope says.
        const double part = (value - now) / std::max(-0.5 * mesh.slope_along(), 1e-300);
        o.fresh = part > 1e-4;
        if (!o.fresh) {
            o.damping *= o.more;
            if (o.damping > o.most) break;
            continue;
        }
        const double gain = value - now;
        mesh.points.swap(mesh.there);
        mesh.det.swap(mesh.new_det);
        value = now;
        if (part > o.good)
            o.damping = std::max(o.less * o.damping, o.least);
        else if (part < o.poor)
            o.damping *= 2;
        if (gain < o.energy_tolerance * value && o.damping < 1) break;
    }
    energy[1] = value;
    get_points(mesh, points, det);
    return taken;
}
