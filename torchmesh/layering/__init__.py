"""Layers of thin triangles along walls: where a mesh has them, and how they follow their walls.

What lives here may import mesh.
"""
