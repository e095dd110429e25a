// Direct factors of the Hessians of meshes, as preconditioners: H = L D L^T in blocks of 2x2, one row for each vertex.
//
// What depends on the triangles alone, the order of elimination and where the entries of L are, is found once
// (`Elimination`).  Factors at one point then serve the points near it.
#pragma once

#include "dissection.hpp"
#include "hessian.hpp"

namespace torchmesh {

// The order in which the free vertices of one mesh are eliminated, and the entries of L.
struct Elimination {
    // rows  of the corners' coordinates: the x and y of free vertex v, v < half, are v and half + v; others are no rows of
    //       unknowns, of which there are 2 half
    Elimination(const std::int32_t* const* rows, std::int64_t count, std::int64_t half);

    Index size() const { return Index(vertex.size()); }

    std::int64_t half;
    std::vector<Index> vertex;        // (size,) the vertex that is eliminated as number i; vertices without a triangle
                                      // are left out
    std::vector<std::int64_t> start;  // (size + 1,) where the columns of L begin
    std::vector<Index> rows;          // the rows of the entries of L below the diagonal, ascending in each column
    std::vector<Index> number;        // (3, triangles) when the corners are eliminated, -1 for those that are not free
    std::vector<std::int64_t> entry;  // (3, triangles) the entries of L of the edges ab, ac, bc, or -1

  private:
    std::vector<Index> ordered(const std::int32_t* const* rows, std::int64_t count, std::vector<Index>& offsets,
                               std::vector<Index>& columns);
};

// The factors of one mesh at one point.
class BlockFactors {
  public:
    using Real = float;

    // False if the matrix is not positive definite; there are no factors then.
    bool factorise(const Elimination& of, const HessianTriangles& triangles);

    bool any() const { return !inverse_.empty(); }

    // x = H^-1 right, both (2 half,) with zeros where there is no vertex; `scratch` (2 size,) is written into.
    void solve(const Elimination& of, const double* right, double* x, std::vector<Real>& scratch) const;

  private:
    std::vector<Real> lower_;    // (entries, 4) the blocks of L D, row by row
    std::vector<Real> inverse_;  // (size, 3) of the blocks of D: xx, xy, yy
};

// What Python holds: the orders of many meshes, and the factors of their Hessians.  One that is not there is null.
struct Eliminations {
    std::vector<std::unique_ptr<const Elimination>> of;
};
struct FactorsOfMeshes {
    std::vector<BlockFactors> of;
};

inline const Elimination* order_of(const Eliminations* all, std::int64_t mesh) {
    return all ? all->of[std::size_t(mesh)].get() : nullptr;
}
inline const BlockFactors* factors_of(const FactorsOfMeshes* all, std::int64_t mesh) {
    return all ? &all->of[std::size_t(mesh)] : nullptr;
}

}  // namespace torchmesh
