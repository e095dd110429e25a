"""Builds the compiled loops of torchmesh/kernels; everything else about the package stands in pyproject.toml.

    python setup.py build_ext --inplace

The loops are plain C++17 behind a C interface: they need neither Python's headers nor torch's, so one library serves
every version of both.  Where there is no compiler the package installs without them, and torch takes their place.
"""

import sys
from pathlib import Path

from setuptools import Extension, setup

SOURCE = Path("torchmesh/kernels/source")
# No flag here may change the result of an operation: a product is not fused with a sum, and sums keep their order.
FLAGS = (
    ["/O2", "/std:c++17", "/fp:precise", "/EHsc"]
    if sys.platform == "win32"
    else [
        "-O3",
        "-g0",
        "-std=c++17",
        "-ffp-contract=off",
        "-fno-math-errno",
        "-fno-trapping-math",
        "-fvisibility=hidden",
    ]
)

setup(
    ext_modules=[
        Extension(
            "torchmesh.kernels._loops",
            sorted(path.as_posix() for path in SOURCE.glob("*.cpp")),
            depends=sorted(path.as_posix() for path in SOURCE.glob("*.hpp")),
            extra_compile_args=FLAGS,
            extra_link_args=[] if sys.platform == "win32" else ["-pthread"],
            language="c++",
            optional=True,
            py_limited_api=True,
        )
    ],
    # One wheel for a system serves all versions of Python from this one on.
    options={"bdist_wheel": {"py_limited_api": "cp310"}},
)
