// The energies, compiled for each kind and precision.
#include "energy.hpp"

namespace torchmesh {

#define TM_ENERGY(NAME, T, KIND, POWER, CEILING)                                                      \
    TM_DISPATCH double NAME(const Triangles<T>& of, const T* x, T* gradient, double* least) {         \
        return add_energy<T, KIND, POWER, CEILING>(of, x, gradient, least);                           \
    }
#define TM_ENERGIES(SUFFIX, T)                                                                \
    TM_ENERGY(imr_1_##SUFFIX, T, INVERSE_MEAN_RATIO, 1, false)                                \
    TM_ENERGY(imr_2_##SUFFIX, T, INVERSE_MEAN_RATIO, 2, false)                                \
    TM_ENERGY(imr_2_ceiling_##SUFFIX, T, INVERSE_MEAN_RATIO, 2, true)                         \
    TM_ENERGY(imr_n_##SUFFIX, T, INVERSE_MEAN_RATIO, 0, false)                                \
    TM_ENERGY(imr_n_ceiling_##SUFFIX, T, INVERSE_MEAN_RATIO, 0, true)                         \
    TM_ENERGY(beta_##SUFFIX, T, UNTANGLE_BETA, 0, false)                                      \
    TM_ENERGY(regularised_##SUFFIX, T, REGULARISED, 0, false)                                 \
    template <>                                                                               \
    Energy<T> energy_for<T>(const Triangles<T>& of) {                                         \
        if (of.kind == UNTANGLE_BETA) return beta_##SUFFIX;                                   \
        if (of.kind == REGULARISED) return regularised_##SUFFIX;                              \
        if (of.power == 2) return of.ceiling > 0 ? imr_2_ceiling_##SUFFIX : imr_2_##SUFFIX;   \
        if (of.power == 1 && !(of.ceiling > 0)) return imr_1_##SUFFIX;                        \
        return of.ceiling > 0 ? imr_n_ceiling_##SUFFIX : imr_n_##SUFFIX;                      \
    }

TM_ENERGIES(double, double)
TM_ENERGIES(single, float)

namespace {

template <class T>
void energies(const TrianglesArgument& triangles, const void* x, const std::int64_t* offsets, std::int64_t meshes,
              void* gradient, double* energy, double* least) {
    for (std::int64_t i = 0; i < meshes; ++i) {
        const Triangles<T> of(triangles, offsets[i], offsets[i + 1]);
        energy[i] = energy_for(of)(of, static_cast<const T*>(x), static_cast<T*>(gradient), least + i);
    }
}

}  // namespace
}  // namespace torchmesh

// The energy of each mesh, its least det, and the gradient, which is added to what is there.
TM_EXPORT void tm_energies(const torchmesh::TrianglesArgument* triangles, const void* x, const std::int64_t* offsets,
                           std::int64_t meshes, void* gradient, double* energy, double* least, std::int32_t single) {
    auto loop = single ? torchmesh::energies<float> : torchmesh::energies<double>;
    loop(*triangles, x, offsets, meshes, gradient, energy, least);
}
