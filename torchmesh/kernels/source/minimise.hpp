// L-BFGS on the energies of meshes, as Python asks for it and as other loops do.
#pragma once

#include "energy.hpp"

namespace torchmesh {

// As torchmesh/status.py numbers them; kernels/minimiser.py passes the numbers.
struct Statuses {
    std::int64_t running, converged, settled, iteration_limit, stalled, valid, not_finite;
};

// Must have the fields of kernels/minimiser.py, `_Options`, in the same order.
struct OptionsArgument {
    std::int64_t max_iterations, patience, history;
    double gradient_tolerance, energy_tolerance, first_step, largest_step, sufficient_decrease, least_curvature,
        shortening_least, shortening_most, blind_shortening, shortest_step, enough;
    std::int64_t has_enough;
    Statuses status;
};

// Must have the fields of kernels/minimiser.py, `_Problems`, in the same order.
struct ProblemsArgument {
    TrianglesArgument triangles;
    const void* start;     // (N,)
    const void* anchored;  // (F,)
    const void* scale;     // (N,)
    const std::int64_t *block_offsets, *triangle_offsets;
    std::int64_t count, width, unknowns;
    void* out;  // (N,)
    double *energy, *gradient;
    std::int64_t *iterations, *evaluations, *status;
};

// Minimises the problem `number`, in double precision, from its start to its end, and writes what it comes to.  Returns
// its energy at the start.
double minimise_one(const ProblemsArgument& all, const OptionsArgument& options, std::int64_t number);

}  // namespace torchmesh
