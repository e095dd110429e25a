"""Attacks on torchmesh, seeded and endless: `python -m experiments.robustness.attack`."""
