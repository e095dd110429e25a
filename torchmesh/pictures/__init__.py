"""What people look at: plots, films, the report page.

Imports from `improving` (its report) and `files`.
"""
