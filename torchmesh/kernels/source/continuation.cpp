// One value of epsilon of the regularised functional, for many meshes, one after the other or in threads.
//
// What comes between two values is decided in torchmesh/untangling/continuation.py.
#include "minimise.hpp"

namespace torchmesh {
namespace {

// Must have the fields of kernels/continuation.py, `_Turn`, in the same order.
struct TurnArgument {
    ProblemsArgument problems;  // of which `start` and `out` are the same, and epsilon is the parameter
    OptionsArgument options;
    double* eps_of_triangles;   // (T,), that parameter
    const std::int64_t* rows;   // (K,) the meshes
    const double* eps;          // (K,) theirs
    double *before, *lowest;    // (K,) the energy at the start, the lowest det at the end
    std::int64_t* inverted;     // (K,) how many are not positive there
};

// The lowest det of the triangles of a mesh, and how many are not positive.
void judge(const ProblemsArgument& all, std::int64_t mesh, double* lowest, std::int64_t* inverted) {
    const TrianglesArgument& of = all.triangles;
    const double* x = static_cast<const double*>(all.out);
    const double* anchored = static_cast<const double*>(all.anchored);
    const double* m = static_cast<const double*>(of.target[3]);
    *lowest = std::numeric_limits<double>::infinity();
    *inverted = 0;
    for (std::int64_t t = all.triangle_offsets[mesh]; t < all.triangle_offsets[mesh + 1]; ++t) {
        double at[6];
        for (int k = 0; k < 6; ++k) {
            const std::int64_t row = of.rows[k * of.count + t];
            at[k] = row < all.unknowns ? x[row] : anchored[row - all.unknowns];
        }
        const double area = (at[2] - at[0]) * (at[5] - at[1]) - (at[3] - at[1]) * (at[4] - at[0]);
        const double det = area * m[of.target_stride[3] * t];
        *lowest = !(det >= *lowest) ? det : *lowest;
        *inverted += det <= 0;
    }
}

void take(const TurnArgument& all, std::int64_t k) {
    const std::int64_t mesh = all.rows[k];
    const std::int64_t* offsets = all.problems.triangle_offsets;
    std::fill(all.eps_of_triangles + offsets[mesh], all.eps_of_triangles + offsets[mesh + 1], all.eps[k]);
    all.before[k] = minimise_one(all.problems, all.options, mesh);
    judge(all.problems, mesh, all.lowest + k, all.inverted + k);
}

}  // namespace
}  // namespace torchmesh

TM_EXPORT void tm_continuation_turn(const torchmesh::TurnArgument* all, std::int64_t from, std::int64_t to,
                                    std::int32_t threads) {
    torchmesh::in_threads(to - from, threads, [&](std::int64_t k) { torchmesh::take(*all, from + k); });
}
