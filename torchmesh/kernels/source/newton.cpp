// Newton's method for the minimum of many meshes, one after the other or in threads.
//
// The method is that of torchmesh/optimising/newton.py, where it is explained; names are the same.
// A mesh's way depends on nothing outside the mesh, so neither threads nor pauses change a bit.
#include "energy.hpp"
#include "hessian.hpp"
#include "own_rows.hpp"

namespace torchmesh {
namespace {

// Must have the fields of kernels/newton.py, `_Problems`, in the same order.
struct NewtonArgument {
    TrianglesArgument triangles;
    const double *anchored, *size;                    // (F,), (N,)
    const std::int64_t *offsets, *triangle_offsets;   // (B+1,)
    std::int64_t unknowns;                            // N
    std::int64_t cg_iterations, halvings;
    double tolerance, cg_tolerance, first_cg_tolerance, near, decrease, left;
    double *x, *energy, *step;  // (N,), (B,), (B,), read and written
    std::uint8_t* running;      // (B,), read and written
};

// --- the slopes and curvatures of phi by stretch and det, at a stretch and a det that is positive ---

struct Curved {
    double s, d, ss, sd, dd;
};

// phi = F(q), q = stretch / (2 det), F(q) = q^p + (q / ceiling)^8
TM_INLINE Curved curved_inverse_mean_ratio(double stretch, double det, int power, double ceiling) {
    const double inverse = 1 / det, q = 0.5 * stretch * inverse;
    double first = power * (power > 1 ? whole_power(q, power - 1) : 1), second = 0;
    if (power > 1) second = power * (power - 1) * (power > 2 ? whole_power(q, power - 2) : 1);
    if (ceiling > 0) {
        const double r = q / ceiling, sixth = (r * r) * (r * r) * (r * r);
        first += 8 * sixth * r / ceiling;
        second += 56 * sixth / (ceiling * ceiling);
    }
    const double by_s = 0.5 * inverse, by_d = -q * inverse;
    return {first * by_s, first * by_d, second * by_s * by_s, (second * by_d - first * inverse) * by_s,
            second * by_d * by_d - 2 * first * by_d * inverse};
}

// phi = above / chi, above = (1 - theta) stretch + theta (1 + det^2), chi = (det + root) / 2, root^2 = eps^2 + det^2
TM_INLINE Curved curved_regularised(double stretch, double det, double eps, double theta) {
    const double root = std::sqrt(eps * eps + det * det), chi = 0.5 * (det + root), inverse = 1 / chi;
    const double by = 1 / root;  // chi' / chi
    const double twice = eps * eps / (2 * root * root * root) * inverse;  // chi'' / chi
    const double phi = ((1 - theta) * stretch + theta * (1 + det * det)) * inverse;
    const double above = 2 * theta * det * inverse, s = (1 - theta) * inverse;
    return {s, above - phi * by, 0, -s * by, 2 * theta * inverse - 2 * above * by - phi * twice + 2 * phi * by * by};
}

// --- one mesh ---

class Mesh {
  public:
    Mesh(const NewtonArgument& all, std::int64_t number)
        : all_(all),
          number_(number),
          first_(all.offsets[number]),
          n_(all.offsets[number + 1] - first_),
          triangles_(all.triangles, all.triangle_offsets[number], all.triangle_offsets[number + 1]),
          own_(triangles_.rows, triangles_.count, first_, n_, all.unknowns),
          hessian_(triangles_.count) {
        const std::int64_t count = triangles_.count;
        for (int k = 0; k < 6; ++k) hessian_.rows[k] = triangles_.rows[k] = own_.rows.data() + k * count;
        const auto length = std::size_t(n_ + own_.anchored());
        x_.resize(length);
        std::copy_n(all.x + first_, n_, x_.begin());
        own_.copy_anchored(all.anchored, x_.data() + n_);
        trial_ = x_;
        gradient_.resize(length);
        step_.resize(std::size_t(n_));
        diagonal_.resize(length);
        descent_.resize(length);
        energy_of_ = energy_for(triangles_);
    }

    // Takes so many steps at most.
    void run(std::int64_t steps) {
        double& energy = all_.energy[number_];
        double& left = all_.step[number_];
        if (std::isnan(energy)) energy = evaluate(x_);
        bool running = true;
        for (; running && steps > 0; --steps) running = step(energy, left);
        all_.running[number_] = running;
        std::copy_n(x_.begin(), n_, all_.x + first_);
    }

  private:
    // The energy, infinite where a triangle is inverted or flat; its gradient goes to `gradient_`.
    double evaluate(const std::vector<double>& at) {
        std::fill(gradient_.begin(), gradient_.end(), 0.0);
        double least = 0;
        const double energy = energy_of_(triangles_, at.data(), gradient_.data(), &least);
        return least > 0 ? energy : std::numeric_limits<double>::infinity();
    }

    // One step; is the mesh to go on?
    bool step(double& energy, double& left) {
        bend();
        const double enough = std::min(std::max(left, all_.cg_tolerance), all_.first_cg_tolerance);
        const Solution found = solve_with_hessian(hessian_, n_, std::int64_t(x_.size()), diagonal_.data(),
                                                  descent_.data(), enough, all_.cg_iterations, step_.data());
        double move = 0;
        for (std::int64_t i = 0; i < n_; ++i) move = std::max(move, std::abs(step_[i] / all_.size[first_ + i]));
        const bool near = found.converged && move < all_.near;
        const double after = near ? move * std::min(all_.left * (enough + move), 1.0) : move;
        left = found.converged ? after : std::numeric_limits<double>::infinity();
        if (!near) return search(energy);
        for (std::int64_t i = 0; i < n_; ++i) x_[i] += step_[i];
        return after >= all_.tolerance;
    }

    // Halves the step until it lowers the energy; was there such a step?
    bool search(double& energy) {
        double slope = 0, scale = 1;
        for (std::int64_t i = 0; i < n_; ++i) slope += step_[i] * descent_[i];
        if (!(slope > 0)) return false;
        for (std::int64_t k = 0; k < all_.halvings; ++k, scale *= 0.5) {
            for (std::int64_t i = 0; i < n_; ++i) trial_[i] = x_[i] + scale * step_[i];
            const double there = evaluate(trial_);
            if (!(there <= energy - all_.decrease * scale * slope)) continue;
            std::swap(x_, trial_);
            energy = there;
            return true;
        }
        return false;
    }

    // The Hessian at x, its diagonal, and minus the gradient.
    void bend() {
        std::fill(diagonal_.begin(), diagonal_.end(), 0.0);
        std::fill(descent_.begin(), descent_.end(), 0.0);
        const double* parameter = triangles_.each[0];
        for (std::int64_t t = 0; t < triangles_.count; ++t) {
            double e[4], g[4], block[10];
            std::size_t row[6];
            for (int k = 0; k < 6; ++k) row[k] = std::size_t(hessian_.rows[k][t]);
            for (int k = 0; k < 4; ++k) {
                e[k] = x_[row[k + 2]] - x_[row[k % 2]];
                const double* each = triangles_.each[k + 1];
                g[k] = each ? each[t] : triangles_.all[k + 1][0];
            }
            const double half[4] = {g[0] * e[0] + g[1] * e[2], g[0] * e[1] + g[1] * e[3], g[2] * e[2] + g[1] * e[0],
                                    g[2] * e[3] + g[1] * e[1]};
            const double stretch = ((half[0] * e[0] + half[1] * e[1]) + half[2] * e[2]) + half[3] * e[3];
            const double det = g[3] * (e[0] * e[3] - e[1] * e[2]);
            const Curved c = curved(stretch, det, parameter ? parameter[t] : triangles_.all[0][0]);
            hessian_of_triangle(e, g, c.s, c.d, c.ss, c.sd, c.dd, block);
            for (int k = 0; k < 10; ++k) hessian_.column(k)[t] = block[k];
            const double of_e[4] = {2 * c.s * half[0] + c.d * g[3] * e[3], 2 * c.s * half[1] - c.d * g[3] * e[2],
                                    2 * c.s * half[2] - c.d * g[3] * e[1], 2 * c.s * half[3] + c.d * g[3] * e[0]};
            const double second[4] = {block[0], block[4], block[7], block[9]};
            for (int k = 0; k < 2; ++k) {
                descent_[row[k]] += of_e[k] + of_e[k + 2];
                diagonal_[row[k]] += (second[k] + second[k + 2]) + 2 * block[k == 0 ? 2 : 6];
            }
            for (int k = 0; k < 4; ++k) {
                descent_[row[k + 2]] -= of_e[k];
                diagonal_[row[k + 2]] += second[k];
            }
        }
    }

    Curved curved(double stretch, double det, double parameter) const {
        // A flat triangle pulls nowhere, as in the twin, where its energy is the constant infinity.
        if (!(det > 0)) return {0, 0, 0, 0, 0};
        if (triangles_.kind == REGULARISED) return curved_regularised(stretch, det, parameter, triangles_.theta);
        return curved_inverse_mean_ratio(stretch, det, triangles_.power, triangles_.ceiling);
    }

    const NewtonArgument& all_;
    const std::int64_t number_, first_, n_;
    Triangles<double> triangles_;
    OwnRows own_;
    HessianTriangles hessian_;
    Energy<double> energy_of_ = nullptr;
    std::vector<double> x_, trial_, gradient_, step_, descent_, diagonal_;
};

}  // namespace
}  // namespace torchmesh

// Takes the meshes from, ..., to - 1 that are running so many steps farther, or to their end.
TM_EXPORT void tm_newton(const torchmesh::NewtonArgument* all, std::int64_t from, std::int64_t to, std::int64_t steps,
                         std::int32_t threads) {
    torchmesh::in_threads(to - from, threads, [&](std::int64_t i) {
        if (all->running[from + i]) torchmesh::Mesh(*all, from + i).run(steps);
    });
}
