"""Attacks on torchmesh, seeded and endless: `python -m experiments.robustness.attack`.

files, mutants                             mutated files
meshes, domains, cracks, tangles, impossible  meshes that are hard to mend, or cannot be
"""
