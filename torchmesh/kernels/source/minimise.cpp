// L-BFGS for many meshes, one after the other or in threads, each from start to end while it is in the cache.
//
// The method is that of torchmesh/optimising/lbfgs.py and lbfgs_history.py, where it is explained; names are the same.
// A problem's way depends on nothing outside the problem, so neither threads nor pauses change a bit.
#include "minimise.hpp"
#include "own_rows.hpp"

#include <memory>

namespace torchmesh {
namespace {

// --- loops over the unknowns of one problem ---

template <class T>
TM_INLINE void take_step(std::int64_t n, const T* TM_RESTRICT x, const T* TM_RESTRICT direction,
                         const T* TM_RESTRICT scale, T length, T* TM_RESTRICT move, T* TM_RESTRICT trial) {
    for (std::int64_t i = 0; i < n; ++i) {
        move[i] = direction[i] * length;
        trial[i] = x[i] + move[i] * scale[i];
    }
}

template <class T>
TM_INLINE double product(std::int64_t n, const T* TM_RESTRICT u, const T* TM_RESTRICT v) {
    double sum[LANES] = {};
    std::int64_t i = 0;
    for (; i + LANES <= n; i += LANES)
        for (int k = 0; k < LANES; ++k) sum[k] += double(u[i + k]) * double(v[i + k]);
    for (; i < n; ++i) sum[i % LANES] += double(u[i]) * double(v[i]);
    double total = 0;
    for (double part : sum) total += part;
    return total;
}

// The gradient in the metric becomes g, its change y; the products of all `vectors`, g the last of them, with g.
constexpr int STRIP = 512;

template <class T>
TM_INLINE void take_gradient(std::int64_t n, const T* TM_RESTRICT raw, const T* TM_RESTRICT metric, T* TM_RESTRICT g,
                             T* TM_RESTRICT y, T* const* vectors, int count, double* products) {
    for (int j = 0; j < count; ++j) products[j] = 0;
    for (std::int64_t start = 0; start < n; start += STRIP) {
        const std::int64_t size = std::min<std::int64_t>(STRIP, n - start);
        for (std::int64_t i = start; i < start + size; ++i) {
            T now = raw[i] * metric[i];
            y[i] = now - g[i];
            g[i] = now;
        }
        for (int j = 0; j < count; ++j) products[j] += product<T>(size, vectors[j] + start, g + start);
    }
}

template <class T>
TM_INLINE double combine(std::int64_t n, T* const* vectors, const T* weights, int count, T* TM_RESTRICT out) {
    T longest[LANES] = {};
    for (std::int64_t start = 0; start < n; start += STRIP) {
        const std::int64_t size = std::min<std::int64_t>(STRIP, n - start);
        T* TM_RESTRICT to = out + start;
        for (int j = 0; j < count; ++j) {
            const T* TM_RESTRICT v = vectors[j] + start;
            const T weight = weights[j];
            if (j == 0)
                for (std::int64_t i = 0; i < size; ++i) to[i] = weight * v[i];
            else
                for (std::int64_t i = 0; i < size; ++i) to[i] += weight * v[i];
        }
        std::int64_t i = 0;
        for (; i + LANES <= size; i += LANES)
            for (int k = 0; k < LANES; ++k) longest[k] = std::max(longest[k], std::abs(to[i + k]));
        for (; i < size; ++i) longest[0] = std::max(longest[0], std::abs(to[i]));
    }
    return double(*std::max_element(longest, longest + LANES));
}

#define TM_LOOPS(SUFFIX, T)                                                                                         \
    TM_DISPATCH void take_step_of(std::int64_t n, const T* x, const T* d, const T* s, T l, T* m, T* t) {             \
        take_step<T>(n, x, d, s, l, m, t);                                                                          \
    }                                                                                                               \
    TM_DISPATCH void take_gradient_of(std::int64_t n, const T* r, const T* m, T* g, T* y, T* const* v, int c,       \
                                      double* p) {                                                                  \
        take_gradient<T>(n, r, m, g, y, v, c, p);                                                                   \
    }                                                                                                               \
    TM_DISPATCH double combine_of(std::int64_t n, T* const* v, const T* w, int c, T* o) {                            \
        return combine<T>(n, v, w, c, o);                                                                           \
    }
TM_LOOPS(double, double)
TM_LOOPS(single, float)

// --- one problem ---

constexpr double LEAST_SLOPE = 1e-300;
constexpr double ROUNDING = 1e-15;

template <class T>
class Problem {
  public:
    Problem(const ProblemsArgument& all, const OptionsArgument& options, std::int64_t number)
        : options_(options),
          m_(int(options.history)),
          n_((all.block_offsets[number + 1] - all.block_offsets[number]) * all.width),
          triangles_(all.triangles, all.triangle_offsets[number], all.triangle_offsets[number + 1]) {
        const std::int64_t first = all.block_offsets[number] * all.width;
        set_coordinates(all, first);
        energy_of_ = energy_for(triangles_);
        std::copy_n(static_cast<const T*>(all.start) + first, n_, x_.begin());
        std::copy_n(static_cast<const T*>(all.start) + first, n_, trial_.begin());
        scale_.assign(static_cast<const T*>(all.scale) + first, static_cast<const T*>(all.scale) + first + n_);
        metric_.resize(n_);
        direction_.resize(n_);
        memory_.assign((2 * m_ + 1) * n_, T(0));
        for (int j = 0; j <= 2 * m_; ++j) vectors_.push_back(memory_.data() + j * n_);
        products_.assign(2 * m_ + 1, 0);
        sy_.assign(m_, 1);
        inverse_.assign(m_ * m_, 0);
        for (int j = 0; j < m_; ++j) inverse_[j * m_ + j] = 1;
        yy_.assign(m_ * m_, 0);
        begin();
    }

    // Goes on to the given iteration at most, or until `work` triangles were visited; is it still running?
    bool advance(std::int64_t up_to, std::int64_t& work) {
        while (true) {
            terminate();
            if (status_ != options_.status.running) return false;
            if (iteration_ >= up_to || work <= 0) return true;
            step(int(iteration_ % m_));
            ++iteration_;
            work -= triangles_.count + n_;
        }
    }

    void write(const ProblemsArgument& all, std::int64_t number) const {
        std::copy_n(x_.data(), n_, static_cast<T*>(all.out) + all.block_offsets[number] * all.width);
        all.energy[number] = energy_ / unit_;
        all.gradient[number] = slope() / unit_;
        all.iterations[number] = accepted_;
        all.evaluations[number] = evaluations_;
        all.status[number] = status_;
    }

    double energy() const { return energy_ / unit_; }

  private:
    // Gives the triangles rows into this problem's own coordinates: its unknowns, then what it needs of the anchored.
    void set_coordinates(const ProblemsArgument& all, std::int64_t first) {
        OwnRows own(triangles_.rows, triangles_.count, first, n_, all.unknowns);
        rows_ = std::move(own.rows);
        for (int k = 0; k < 6; ++k) triangles_.rows[k] = rows_.data() + k * triangles_.count;
        const std::int64_t length = n_ + own.anchored();
        x_.resize(length);
        trial_.resize(length);
        raw_.resize(length);
        for (auto* to : {&x_, &trial_}) own.copy_anchored(static_cast<const T*>(all.anchored), to->data() + n_);
    }

    double evaluate(double* least) {
        std::fill(raw_.begin(), raw_.end(), T(0));
        return energy_of_(triangles_, trial_.data(), raw_.data(), least);
    }

    bool done(double least) const { return options_.has_enough && least > options_.enough; }

    void begin() {
        double least = 0;
        const double energy = evaluate(options_.has_enough ? &least : nullptr);
        const bool finite = std::isfinite(energy);
        free_ = 0;
        double square = 0;
        for (std::int64_t i = 0; i < n_; ++i) {
            free_ += scale_[i] > 0;
            const double g = finite ? double(raw_[i]) * double(scale_[i]) : 0;
            square += g * g;
        }
        free_ = std::max(free_, 1.0);
        unit_ = unit_of(std::sqrt(square / free_));
        T* g = vectors_[2 * m_];
        for (std::int64_t i = 0; i < n_; ++i) {
            metric_[i] = T(double(scale_[i]) * unit_);
            g[i] = finite ? T(double(raw_[i]) * double(scale_[i]) * unit_) : T(0);
        }
        energy_ = energy * unit_;
        small_ = (options_.gradient_tolerance * unit_) * (options_.gradient_tolerance * unit_) * free_;
        status_ = finite ? options_.status.running : options_.status.not_finite;
        if (finite && done(least)) status_ = options_.status.valid;
        for (int j = 0; j <= 2 * m_; ++j) products_[j] = product<T>(n_, vectors_[j], g);
        gamma_ = first_gamma();
        point_the_way();
        length_ = options_.largest_step / std::max(longest_, options_.largest_step);
        recent_.assign(options_.patience, energy_);
    }

    static double unit_of(double slope) {
        if (!(slope > 0)) return 1;
        int exponent;
        std::frexp(slope, &exponent);
        return std::ldexp(1.0, std::clamp(30 - exponent, -90, 90));
    }

    double slope() const { return std::sqrt(products_[2 * m_] / free_); }
    double first_gamma() const { return options_.first_step / std::max(slope(), LEAST_SLOPE); }

    void terminate() {
        if (status_ != options_.status.running) return;
        const double oldest = recent_[accepted_ % options_.patience];
        if (products_[2 * m_] <= small_)
            status_ = options_.status.converged;
        else if (accepted_ >= options_.patience && oldest - energy_ <= options_.energy_tolerance * std::abs(energy_))
            status_ = options_.status.settled;
        else if (length_ < options_.shortest_step)
            status_ = options_.status.stalled;
        else if (iteration_ >= options_.max_iterations)
            status_ = options_.status.iteration_limit;
    }

    void step(int slot) {
        T* move = vectors_[slot];
        take_step_of(n_, x_.data(), direction_.data(), scale_.data(), T(length_), move, trial_.data());
        double least = 0;
        const double energy = evaluate(options_.has_enough ? &least : nullptr) * unit_;
        const double change = energy - energy_, slope = length_ * descent_;
        ++evaluations_;
        bool good = change > -std::numeric_limits<double>::infinity();
        if (good && !(change <= options_.sufficient_decrease * slope)) good = flatter(change);
        if (good)
            accept(slot, energy, slope, done(least));
        else
            refuse(slot, change);
    }

    bool flatter(double change) const {
        if (!(change <= ROUNDING * std::abs(energy_))) return false;
        double square = 0;
        for (std::int64_t i = 0; i < n_; ++i) {
            const T g = raw_[i] * metric_[i];
            square += double(g) * double(g);
        }
        return square < products_[2 * m_];
    }

    void accept(int slot, double energy, double slope, bool done) {
        std::swap(x_, trial_);
        before_ = products_;
        take_gradient_of(n_, raw_.data(), metric_.data(), vectors_[2 * m_], vectors_[m_ + slot], vectors_.data(),
                         2 * m_ + 1, products_.data());
        const double square_change = products_[2 * m_] - before_[2 * m_];
        const double sy = products_[slot] - slope, yy = 2 * products_[m_ + slot] - square_change;
        if (sy > -options_.least_curvature * slope && yy > 0) {
            gamma_ = sy / yy;
            put(slot, sy, yy, true);
        } else {
            void_pair(slot);
        }
        recent_[accepted_ % options_.patience] = energy_;
        energy_ = energy;
        point_the_way();
        if (!(descent_ < 0)) {
            forget();
            point_the_way();
        }
        length_ = options_.largest_step / std::max(longest_, options_.largest_step);
        ++accepted_;
        if (done) status_ = options_.status.valid;
    }

    // The problem stays where it is, with its direction; its history has a zero in this slot.
    void refuse(int slot, double change) {
        void_pair(slot);
        double within = options_.blind_shortening * length_;
        if (std::isfinite(change)) {
            const double fit = -0.5 * descent_ * length_ / (change / length_ - descent_);
            within = std::min(std::max(fit, options_.shortening_least * length_), options_.shortening_most * length_);
        }
        length_ = within;
    }

    // The newest pair takes the place of the oldest; `products_` less `before_` are those of its y.
    void put(int slot, double sy, double yy, bool counts) {
        std::vector<double>& column = scratch_;
        column.assign(m_, 0);
        for (int i = 0; i < m_; ++i) inverse_[slot * m_ + i] = 0;
        if (counts)
            for (int i = 0; i < m_; ++i) {
                double sum = 0;
                for (int k = 0; k < m_; ++k)
                    if (k != slot) sum += (products_[k] - before_[k]) * inverse_[i * m_ + k];
                column[i] = sum;
            }
        for (int i = 0; i < m_; ++i) {
            inverse_[i * m_ + slot] = column[i] / -sy;
            const double of_y = i == slot ? yy : counts ? products_[m_ + i] - before_[m_ + i] : 0;
            yy_[slot * m_ + i] = yy_[i * m_ + slot] = of_y;
        }
        inverse_[slot * m_ + slot] = 1 / sy;
        sy_[slot] = sy;
    }

    // Makes the pair of `slot` zero; gamma is then that of an older pair.
    void void_pair(int slot) {
        for (int j : {slot, m_ + slot}) {
            std::fill_n(vectors_[j], n_, T(0));
            products_[j] = 0;
        }
        yy_[slot * m_ + slot] = 0;
        bool old = false;
        for (int j = 0; j < m_; ++j) old |= yy_[j * m_ + j] > 0;
        if (!old) gamma_ = first_gamma();
        put(slot, 1, 0, false);
    }

    void forget() {
        std::fill_n(memory_.begin(), 2 * m_ * n_, T(0));
        std::fill_n(products_.begin(), 2 * m_, 0.0);
        gamma_ = first_gamma();
        std::fill(sy_.begin(), sy_.end(), 1.0);
        std::fill(yy_.begin(), yy_.end(), 0.0);
        std::fill(inverse_.begin(), inverse_.end(), 0.0);
        for (int j = 0; j < m_; ++j) inverse_[j * m_ + j] = 1;
    }

    // Minus H g by the compact representation, the slope along it, and its largest component.
    void point_the_way() {
        std::vector<double>& w = scratch_;
        w.assign(2 * m_, 0);
        double* v = w.data() + m_;
        for (int j = 0; j < m_; ++j)
            for (int i = 0; i < m_; ++i) w[j] += products_[i] * inverse_[j * m_ + i];
        for (int j = 0; j < m_; ++j) {
            double by_yy = 0;
            for (int i = 0; i < m_; ++i) by_yy += w[i] * yy_[i * m_ + j];
            v[j] = sy_[j] * w[j] + gamma_ * (by_yy - products_[m_ + j]);
        }
        weights_.resize(2 * m_ + 1);
        descent_ = 0;
        for (int i = 0; i <= 2 * m_; ++i) {
            double weight = gamma_;
            if (i < m_) {
                weight = 0;
                for (int j = 0; j < m_; ++j) weight += v[j] * inverse_[j * m_ + i];
            } else if (i < 2 * m_) {
                weight = -gamma_ * w[i - m_];
            }
            weights_[i] = T(-weight);
            descent_ -= weight * products_[i];
        }
        longest_ = combine_of(n_, vectors_.data(), weights_.data(), 2 * m_ + 1, direction_.data());
    }

    const OptionsArgument& options_;
    const int m_;
    const std::int64_t n_;
    Triangles<T> triangles_;
    Energy<T> energy_of_ = nullptr;
    std::vector<std::int32_t> rows_;
    std::vector<T> x_, trial_, raw_, scale_, metric_, direction_, memory_, weights_;
    std::vector<T*> vectors_;
    std::vector<double> products_, before_, sy_, inverse_, yy_, recent_, scratch_;
    double energy_ = 0, descent_ = 0, length_ = 0, longest_ = 0, unit_ = 1, small_ = 0, gamma_ = 0, free_ = 1;
    std::int64_t status_ = 0, iteration_ = 0, accepted_ = 0, evaluations_ = 1;
};

// --- many problems ---

struct Run {
    virtual ~Run() = default;
    virtual std::int64_t advance(std::int64_t up_to, std::int64_t work, int threads, double* energies) = 0;
};

template <class T>
struct RunOf : Run {
    RunOf(const ProblemsArgument& all, const OptionsArgument& options)
        : all(all), options(options), problems(all.count), ended(all.count, 0) {}

    // Returns how many problems still run; energies (B,), if given, of those that ran in this call, NaN for the others.
    std::int64_t advance(std::int64_t up_to, std::int64_t work, int threads, double* energies) override {
        std::vector<std::int64_t> rows;
        for (std::int64_t i = 0; i < all.count; ++i)
            if (!ended[i]) rows.push_back(i);
        if (energies) std::fill_n(energies, all.count, std::nan(""));
        std::atomic<std::int64_t> left{work};
        in_threads(std::int64_t(rows.size()), threads, [&](std::int64_t k) {
            const std::int64_t i = rows[k];
            std::int64_t mine = left.load();
            if (mine <= 0) return;
            const std::int64_t before = mine;
            if (!problems[i]) problems[i] = std::make_unique<Problem<T>>(all, options, i);
            const bool running = problems[i]->advance(up_to, mine);
            if (energies) energies[i] = problems[i]->energy();
            if (!running) {
                problems[i]->write(all, i);
                ended[i] = 1;
                problems[i].reset();
            }
            left.fetch_sub(before - mine);
        });
        return std::count(ended.begin(), ended.end(), 0);
    }

    const ProblemsArgument all;
    const OptionsArgument options;
    std::vector<std::unique_ptr<Problem<T>>> problems;
    std::vector<char> ended;
};

}  // namespace

double minimise_one(const ProblemsArgument& all, const OptionsArgument& options, std::int64_t number) {
    Problem<double> problem(all, options, number);
    const double before = problem.energy();
    std::int64_t work = std::numeric_limits<std::int64_t>::max();
    problem.advance(options.max_iterations + 1, work);
    problem.write(all, number);
    return before;
}

}  // namespace torchmesh

TM_EXPORT void* tm_minimise_start(const torchmesh::ProblemsArgument* problems, const torchmesh::OptionsArgument* options,
                                  std::int32_t single) {
    if (single) return static_cast<torchmesh::Run*>(new torchmesh::RunOf<float>(*problems, *options));
    return static_cast<torchmesh::Run*>(new torchmesh::RunOf<double>(*problems, *options));
}

TM_EXPORT std::int64_t tm_minimise_advance(void* run, std::int64_t up_to, std::int64_t work, std::int32_t threads,
                                           double* energies) {
    return static_cast<torchmesh::Run*>(run)->advance(up_to, work, threads, energies);
}

TM_EXPORT void tm_minimise_end(void* run) { delete static_cast<torchmesh::Run*>(run); }
