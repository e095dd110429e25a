"""Values of a mesh carried over to another mesh of the same domain, at vertices or in triangles.

    transfer     what the caller asks for: the values, the sparse matrix, what was seen on the way
    location     vertices of one mesh in the triangles of the other: linear interpolation
    overlaps     areas that triangles of both meshes share: averages, and the projection in `projection`
    domain       a triangulation of the vertices of a mesh whose own triangles overlap
    pairs        which triangles may touch at all
    sparse_rows  the linear map that all of this comes to

Imports from `optimising`, `triangulating` and `mesh`.
"""
