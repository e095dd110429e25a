"""Files by the thousand: reading and writing them, workers, a manifest, and runs that resume where they stopped.

Imports from `improving`, `learning` and `files`.
"""
