// The exact part of the predicates, and the predicates over arrays.
#include "exact.hpp"

namespace torchmesh {
namespace {

// --- expansions: sums of doubles without overlap, the smallest first (Shewchuk 1997) ---

struct Expansion {
    std::vector<double> terms;

    int sign() const { return terms.empty() ? 0 : sign_of(terms.back()); }
};

void two_sum(double a, double b, double& sum, double& error) {
    sum = a + b;
    const double part = sum - a;
    error = (a - (sum - part)) + (b - part);
}

Expansion difference(double a, double b) {
    double sum, error;
    two_sum(a, -b, sum, error);
    Expansion out;
    if (error != 0) out.terms.push_back(error);
    if (sum != 0) out.terms.push_back(sum);
    return out;
}

// Shewchuk's Grow-Expansion, without zeros.
void add(Expansion& to, double value) {
    std::size_t kept = 0;
    for (double term : to.terms) {
        double error;
        two_sum(value, term, value, error);
        if (error != 0) to.terms[kept++] = error;
    }
    to.terms.resize(kept);
    if (value != 0) to.terms.push_back(value);
}

Expansion sum(Expansion a, const Expansion& b, double factor = 1) {
    for (double term : b.terms) add(a, factor * term);
    return a;
}

Expansion product(const Expansion& a, const Expansion& b) {
    Expansion out;
    for (double u : a.terms)
        for (double v : b.terms) {
            const double high = u * v;
            add(out, std::fma(u, v, -high));
            add(out, high);
        }
    return out;
}

// --- integers of any length, as a sign and digits of 32 bits, the lowest first ---

struct Integer {
    int sign = 0;
    std::vector<std::uint32_t> digits;

    void trim() {
        while (!digits.empty() && digits.back() == 0) digits.pop_back();
        if (digits.empty()) sign = 0;
    }
};

int compare(const std::vector<std::uint32_t>& a, const std::vector<std::uint32_t>& b) {
    if (a.size() != b.size()) return a.size() < b.size() ? -1 : 1;
    for (std::size_t i = a.size(); i-- > 0;)
        if (a[i] != b[i]) return a[i] < b[i] ? -1 : 1;
    return 0;
}

Integer sum(const Integer& a, const Integer& b, int factor = 1) {
    const int of_b = factor * b.sign;
    if (of_b == 0) return a;
    if (a.sign == 0) return Integer{of_b, b.digits};
    const bool swap = a.sign != of_b && compare(a.digits, b.digits) < 0;
    const auto &large = swap ? b.digits : a.digits, &small = swap ? a.digits : b.digits;
    Integer out{swap ? of_b : a.sign, large};
    std::int64_t carry = 0;
    const int direction = a.sign == of_b ? 1 : -1;
    out.digits.resize(std::max(large.size(), small.size()) + 1, 0);
    for (std::size_t i = 0; i < out.digits.size(); ++i) {
        carry += std::int64_t(out.digits[i]) + direction * std::int64_t(i < small.size() ? small[i] : 0);
        out.digits[i] = std::uint32_t(carry);
        carry >>= 32;
    }
    out.trim();
    return out;
}

Integer product(const Integer& a, const Integer& b) {
    Integer out{a.sign * b.sign, std::vector<std::uint32_t>(a.digits.size() + b.digits.size(), 0)};
    for (std::size_t i = 0; i < a.digits.size(); ++i) {
        std::uint64_t carry = 0;
        for (std::size_t j = 0; j < b.digits.size(); ++j) {
            carry += std::uint64_t(a.digits[i]) * b.digits[j] + out.digits[i + j];
            out.digits[i + j] = std::uint32_t(carry);
            carry >>= 32;
        }
        out.digits[i + b.digits.size()] = std::uint32_t(carry);
    }
    out.trim();
    return out;
}

// value 2^shift, which must be whole.
Integer integer(double value, int shift) {
    int exponent;
    const double mantissa = std::frexp(std::abs(value), &exponent);
    if (value == 0) return {};
    const auto whole = std::uint64_t(std::ldexp(mantissa, 53));
    const int left = exponent - 53 + shift, words = left / 32, bits = left % 32;
    Integer out{sign_of(value), std::vector<std::uint32_t>(std::size_t(words), 0)};
    const std::uint64_t low = bits ? whole << bits : whole, high = bits ? whole >> (64 - bits) : 0;
    for (std::uint64_t part : {low, high}) {
        out.digits.push_back(std::uint32_t(part));
        out.digits.push_back(std::uint32_t(part >> 32));
    }
    out.trim();
    return out;
}

Integer difference(const Integer& a, const Integer& b) { return sum(a, b, -1); }

// --- the determinants, in either arithmetic ---

template <class Number, class Value>
int orientation_sign(const Value* v) {
    const Number left = product(difference(v[2], v[0]), difference(v[5], v[1]));
    const Number right = product(difference(v[3], v[1]), difference(v[4], v[0]));
    const Number determinant = sum(left, right, -1);
    if constexpr (std::is_same_v<Number, Integer>)
        return determinant.sign;
    else
        return determinant.sign();
}

template <class Number, class Value>
int incircle_sign(const Value* v) {
    std::array<Number, 6> e;
    for (int i = 0; i < 6; ++i) e[i] = difference(v[i], v[6 + i % 2]);
    auto square = [&](int i) { return sum(product(e[2 * i], e[2 * i]), product(e[2 * i + 1], e[2 * i + 1])); };
    auto cross = [&](int i, int j) {
        return sum(product(e[2 * i], e[2 * j + 1]), product(e[2 * i + 1], e[2 * j]), -1);
    };
    Number determinant = product(square(0), cross(1, 2));
    determinant = sum(determinant, product(square(1), cross(2, 0)));
    determinant = sum(determinant, product(square(2), cross(0, 1)));
    if constexpr (std::is_same_v<Number, Integer>)
        return determinant.sign;
    else
        return determinant.sign();
}

// Expansions are exact where no product of four coordinates leaves the range of a double with all its digits: every
// coordinate is then a whole multiple of 2^-252.
bool in_range(const double* xy, int count) {
    for (int i = 0; i < count; ++i) {
        const double size = std::abs(xy[i]);
        if (size != 0 && !(size >= 0x1p-200 && size <= 0x1p200)) return false;
    }
    return true;
}

void integers(const double* xy, int count, Integer* out) {
    int least = 0;
    for (int i = 0, exponent; i < count; ++i) {
        std::frexp(xy[i], &exponent);
        if (xy[i] != 0) least = std::min(least, exponent - 53);
    }
    for (int i = 0; i < count; ++i) out[i] = integer(xy[i], -least);
}

// Puts the coordinates into a unit, a power of two, in which the largest is near 1.  No sign changes, and products are far
// from underflow.  False where a coordinate would lose bits, or where nothing would change.
bool in_unit(const double* xy, int count, double* out) {
    double largest = 0;
    for (int i = 0; i < count; ++i) largest = std::max(largest, std::abs(xy[i]));
    int exponent;
    std::frexp(largest, &exponent);
    if (largest == 0 || exponent == 0) return false;
    for (int i = 0; i < count; ++i) {
        out[i] = std::ldexp(xy[i], -exponent);
        if (exponent > 0 && xy[i] != 0 && !std::isnormal(out[i])) return false;
    }
    return true;
}

template <int COUNT, class Filter, class Sign>
int exact_sign(const double* xy, const Filter& filter, const Sign& sign) {
    double unit[COUNT];
    if (in_unit(xy, COUNT, unit)) {
        const int known = filter(unit);
        if (known != 0) return known;
        xy = unit;
    }
    if (in_range(xy, COUNT)) return sign(xy);
    Integer whole[COUNT];
    integers(xy, COUNT, whole);
    return sign(whole);
}

}  // namespace

int exact_orientation(const double* xy) {
    const auto filter = [](const double* v) {
        const double left = (v[2] - v[0]) * (v[5] - v[1]), right = (v[3] - v[1]) * (v[4] - v[0]);
        return filtered_sign(left - right, (std::abs(left) + std::abs(right)) * ORIENTATION_BOUND);
    };
    return exact_sign<6>(xy, filter, [](const auto* v) {
        return orientation_sign<std::conditional_t<std::is_same_v<decltype(v), const Integer*>, Integer, Expansion>>(v);
    });
}

int exact_incircle(const double* xy) {
    const auto filter = [](const double*) { return 0; };
    return exact_sign<8>(xy, filter, [](const auto* v) {
        return incircle_sign<std::conditional_t<std::is_same_v<decltype(v), const Integer*>, Integer, Expansion>>(v);
    });
}

}  // namespace torchmesh

// The signs of `count` rows, whose coordinates stand in 6 or 8 columns.
TM_EXPORT void tm_orientation(const double* const* c, std::int64_t count, std::int8_t* sign) {
    for (std::int64_t i = 0; i < count; ++i)
        sign[i] = std::int8_t(torchmesh::orientation(c[0][i], c[1][i], c[2][i], c[3][i], c[4][i], c[5][i]));
}

TM_EXPORT void tm_incircle(const double* const* c, std::int64_t count, std::int8_t* sign) {
    for (std::int64_t i = 0; i < count; ++i)
        sign[i] = std::int8_t(
            torchmesh::incircle(c[0][i], c[1][i], c[2][i], c[3][i], c[4][i], c[5][i], c[6][i], c[7][i]));
}

// The orientation of every triangle (count, 3) over points (V, 2).
TM_EXPORT void tm_triangle_signs(const double* points, const std::int64_t* triangles, std::int64_t count,
                                 std::int8_t* sign) {
    for (std::int64_t i = 0; i < count; ++i) {
        const double *a = points + 2 * triangles[3 * i], *b = points + 2 * triangles[3 * i + 1],
                     *c = points + 2 * triangles[3 * i + 2];
        sign[i] = std::int8_t(torchmesh::orientation(a[0], a[1], b[0], b[1], c[0], c[1]));
    }
}
