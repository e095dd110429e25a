"""Files by the thousand: workers, a manifest, runs that go on where they were stopped.

Imports from `improving`, `learning` and `files`.
"""
