"""Layers of thin triangles along walls: where a mesh has them, and how they follow their walls.

    layers     rows of thin quadrilaterals, found by walking outwards from the walls
    following  each vertex of a layer carried along with the wall below it

Imports from `mesh` and `kernels`.
"""
