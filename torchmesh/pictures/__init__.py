"""Plots, films and the report page of a mesh.

Imports from `improving` (its report) and `files`.
"""
