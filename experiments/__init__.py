"""Scripts that measure torchmesh, grouped by what they ask about.

Each runs from the root of the repository as a module, `python -m experiments.GROUP.NAME`, and says with `--help` what
it measures; README.md in this folder lists them all.  A script has a function `main` that takes the arguments as a
list and returns the exit status.  Scripts import from `experiments.shared`, from their own group, and from torchmesh,
its inner modules included; torchmesh imports nothing from here.
"""
