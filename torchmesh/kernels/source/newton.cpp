// Newton's method for the minimum of many meshes, one after the other or in threads.
//
// The method is that of torchmesh/optimising/newton.py, where it is explained; names are the same.
// A mesh's way depends on nothing outside the mesh, so neither threads nor pauses change a bit.
#include "block_factors.hpp"
#include "energy.hpp"
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
    double tolerance, cg_tolerance, first_cg_tolerance, near, decrease, left, first_chord, contraction;
    double *x, *energy, *step;  // (N,), (B,), (B,), read and written
    std::uint8_t* running;      // (B,), read and written
    const Eliminations* orders;      // or null
    const FactorsOfMeshes* factors;  // of the Hessians at points near x, or null
};

// --- the second derivatives of triangles, in tiles ---

constexpr int PART = 128;

// Chord steps end at this part of the tolerance, if rounding lets them.
constexpr double PRECISE = 1e-3;

// Of a tile of triangles: the edges, the target, stretch and det, and the slopes and curvatures of phi by these.
struct Bent {
    double e[4][PART], g[4][PART], stretch[PART], det[PART], s[PART], d[PART], ss[PART], sd[PART], dd[PART];
};

// phi = F(q), q = stretch / (2 det), F(q) = q^p + (q / ceiling)^8
TM_INLINE void curve_inverse_mean_ratio(Bent& of, int n, int power, double ceiling) {
    double first[PART], second[PART];
    for (int i = 0; i < n; ++i) {
        first[i] = of.stretch[i] * (1 / of.det[i]);
        second[i] = 2;
    }
    for (int i = 0; power != 2 && i < n; ++i) {
        const double q = 0.5 * first[i];
        first[i] = power * (power > 1 ? whole_power(q, power - 1) : 1);
        second[i] = power > 1 ? power * (power - 1) * (power > 2 ? whole_power(q, power - 2) : 1) : 0;
    }
    for (int i = 0; ceiling > 0 && i < n; ++i) {
        const double r = 0.5 * of.stretch[i] * (1 / of.det[i]) / ceiling, sixth = (r * r) * (r * r) * (r * r);
        first[i] += 8 * sixth * r / ceiling;
        second[i] += 56 * sixth / (ceiling * ceiling);
    }
    for (int i = 0; i < n; ++i) {
        const double inverse = 1 / of.det[i], by_s = 0.5 * inverse, by_d = -0.5 * of.stretch[i] * inverse * inverse;
        of.s[i] = first[i] * by_s;
        of.d[i] = first[i] * by_d;
        of.ss[i] = second[i] * by_s * by_s;
        of.sd[i] = (second[i] * by_d - first[i] * inverse) * by_s;
        of.dd[i] = second[i] * by_d * by_d - 2 * first[i] * by_d * inverse;
    }
}

// phi = above / chi, above = (1 - theta) stretch + theta (1 + det^2), chi = (det + root) / 2, root^2 = eps^2 + det^2
TM_INLINE void curve_regularised(Bent& of, int n, const double* eps, double theta) {
    for (int i = 0; i < n; ++i) {
        const double det = of.det[i], root = std::sqrt(eps[i] * eps[i] + det * det), inverse = 1 / (0.5 * (det + root));
        const double by = 1 / root;  // chi' / chi
        const double twice = eps[i] * eps[i] / (2 * root * root * root) * inverse;  // chi'' / chi
        const double phi = ((1 - theta) * of.stretch[i] + theta * (1 + det * det)) * inverse;
        const double above = 2 * theta * det * inverse, s = (1 - theta) * inverse;
        of.s[i] = s;
        of.d[i] = above - phi * by;
        of.ss[i] = 0;
        of.sd[i] = -s * by;
        of.dd[i] = 2 * theta * inverse - 2 * above * by - phi * twice + 2 * phi * by * by;
    }
}

// Puts the second derivatives of all triangles at x into `to`.
TM_INLINE void bend_triangles(const Triangles<double>& of, const double* TM_RESTRICT x, HessianTriangles& to) {
    Bent bent;
    for (std::int64_t start = 0; start < of.count; start += PART) {
        const int n = int(std::min<std::int64_t>(PART, of.count - start));
        for (int k = 0; k < 4; ++k) {
            const std::int32_t *end = to.rows[k + 2] + start, *corner = to.rows[k % 2] + start;
            const double* target = of.values(k + 1, start);
            for (int i = 0; i < n; ++i) {
                bent.e[k][i] = x[end[i]] - x[corner[i]];
                bent.g[k][i] = target[i];
            }
        }
        for (int i = 0; i < n; ++i) {
            const double e0 = bent.e[0][i], e1 = bent.e[1][i], e2 = bent.e[2][i], e3 = bent.e[3][i];
            const double g0 = bent.g[0][i], g1 = bent.g[1][i], g2 = bent.g[2][i];
            bent.stretch[i] = (((g0 * e0 + g1 * e2) * e0 + (g0 * e1 + g1 * e3) * e1) + (g2 * e2 + g1 * e0) * e2) +
                              (g2 * e3 + g1 * e1) * e3;
            bent.det[i] = bent.g[3][i] * (e0 * e3 - e1 * e2);
        }
        if (of.kind == REGULARISED)
            curve_regularised(bent, n, of.values(0, start), of.theta);
        else
            curve_inverse_mean_ratio(bent, n, of.power, of.ceiling);
        // A flat triangle pulls nowhere, as in the twin, where its energy is the constant infinity.
        for (int i = 0; i < n; ++i)
            if (!(bent.det[i] > 0)) bent.s[i] = bent.d[i] = bent.ss[i] = bent.sd[i] = bent.dd[i] = 0;
        double* TM_RESTRICT column[10];
        for (int k = 0; k < 10; ++k) column[k] = to.column(k) + start;
        for (int i = 0; i < n; ++i) {
            const double e[4] = {bent.e[0][i], bent.e[1][i], bent.e[2][i], bent.e[3][i]};
            const double g[4] = {bent.g[0][i], bent.g[1][i], bent.g[2][i], bent.g[3][i]};
            double block[10];
            hessian_of_triangle(e, g, bent.s[i], bent.d[i], bent.ss[i], bent.sd[i], bent.dd[i], block);
            for (int k = 0; k < 10; ++k) column[k][i] = block[k];
        }
    }
}

TM_DISPATCH void bend(const Triangles<double>& of, const double* x, HessianTriangles& to) {
    bend_triangles(of, x, to);
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
        descent_.resize(std::size_t(n_));
        diagonal_.resize(length);
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

    // The factors of the Hessian at x, if it is positive definite.
    void factorise(BlockFactors& factors) {
        const Elimination* order = order_of(all_.orders, number_);
        if (!order) return;
        bend(triangles_, x_.data(), hessian_);
        factors.factorise(*order, hessian_);
    }

  private:
    // The energy, infinite where a triangle is inverted or flat; its gradient goes to `gradient_`.
    double evaluate(const std::vector<double>& at) {
        std::fill(gradient_.begin(), gradient_.end(), 0.0);
        double least = 0;
        const double energy = energy_of_(triangles_, at.data(), gradient_.data(), &least);
        return least > 0 ? energy : std::numeric_limits<double>::infinity();
    }

    // One step, or many with the factors that were given; is the mesh to go on?
    bool step(double& energy, double& left) {
        if (chords(left)) return false;
        evaluate(x_);
        bend(triangles_, x_.data(), hessian_);
        for (std::int64_t i = 0; i < n_; ++i) descent_[i] = -gradient_[i];
        const double enough = std::min(std::max(left, all_.cg_tolerance), all_.first_cg_tolerance);
        const Solution found = solved(enough);
        const double move = largest_move();
        const bool near = found.converged && move < all_.near;
        const double after = near ? move * std::min(all_.left * (enough + move), 1.0) : move;
        left = found.converged ? after : std::numeric_limits<double>::infinity();
        if (!near) return search(energy);
        for (std::int64_t i = 0; i < n_; ++i) x_[i] += step_[i];
        return after >= all_.tolerance;
    }

    // The linear system, whose solution goes to `step_`.
    Solution solved(double enough) {
        const auto length = std::int64_t(x_.size());
        Solution found = solve_with_factors(hessian_, n_, length, descent_.data(), enough, all_.cg_iterations,
                                            step_.data(), order_of(all_.orders, number_),
                                            factors_of(all_.factors, number_));
        if (found.converged) return found;
        add_diagonal(hessian_, diagonal_);
        return solve_with_hessian(hessian_, n_, length, diagonal_.data(), descent_.data(), enough, all_.cg_iterations,
                                  step_.data());
    }

    // Newton steps with the Hessian at the point of the factors in place of that at x, as long as each is a small part of
    // the one before; do they lead to the minimum?  If not, x is where it was.
    bool chords(double& left) {
        const BlockFactors* factors = factors_of(all_.factors, number_);
        if (!factors || !factors->any()) return false;
        const Elimination& order = *order_of(all_.orders, number_);
        std::copy(x_.begin(), x_.end(), trial_.begin());
        const double none = std::numeric_limits<double>::infinity();
        double last = none, after = none;
        // They are short, so that they go on well beyond the tolerance, as a step of Newton's method does.
        while (after >= PRECISE * all_.tolerance && !std::isinf(evaluate(x_))) {
            factors->solve(order, gradient_.data(), step_.data(), scratch_);
            const double move = largest_move();
            if (!(move < std::min(all_.contraction * last, all_.first_chord))) break;
            for (std::int64_t i = 0; i < n_; ++i) x_[i] -= step_[i];
            // All further steps together, if they go on to become shorter as fast.
            after = last < none ? move * std::min(all_.left * (move / last), 1.0) : move;
            last = move;
        }
        if (after < all_.tolerance) {
            left = after;
            return true;
        }
        std::copy(trial_.begin(), trial_.end(), x_.begin());
        return false;
    }

    double largest_move() const {
        double move = 0;
        for (std::int64_t i = 0; i < n_; ++i) {
            const double part = std::abs(step_[i] / all_.size[first_ + i]);
            if (!(part <= move)) move = part;  // and if it is not a number
        }
        return move;
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

    const NewtonArgument& all_;
    const std::int64_t number_, first_, n_;
    Triangles<double> triangles_;
    OwnRows own_;
    HessianTriangles hessian_;
    Energy<double> energy_of_ = nullptr;
    std::vector<double> x_, trial_, gradient_, step_, descent_, diagonal_;
    std::vector<BlockFactors::Real> scratch_;
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

// The factors of the Hessians of the running meshes at x, near which others may be solved with them.
TM_EXPORT void* tm_new_factors(std::int64_t meshes) {
    auto* made = new torchmesh::FactorsOfMeshes;
    made->of.resize(std::size_t(meshes));
    return made;
}

TM_EXPORT void tm_factorise_hessians(const torchmesh::NewtonArgument* all, void* handle, std::int64_t from,
                                     std::int64_t to, std::int32_t threads) {
    auto& factors = *static_cast<torchmesh::FactorsOfMeshes*>(handle);
    torchmesh::in_threads(to - from, threads, [&](std::int64_t i) {
        if (all->running[from + i]) torchmesh::Mesh(*all, from + i).factorise(factors.of[std::size_t(from + i)]);
    });
}
