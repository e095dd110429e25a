"""Triangulation of the inside of one polygon: exact, constrained, Delaunay; and a mesher that adds vertices.

Imports from `mesh`.
"""
