"""Checks of the numbers in records of options: what no step can work with is refused by name, with a ValueError."""

import operator
from typing import Any


def is_number(value: Any) -> bool:
    """Whether it is one number, of Python, numpy or torch: no text, and not None."""
    return hasattr(value, "__float__")


def is_whole(value: Any) -> bool:
    """Whether it is one whole number, of Python, numpy or torch, and no truth value."""
    try:
        operator.index(value)
    except TypeError:
        return False
    return not isinstance(value, bool)


def check_least(options: object, **least: float) -> None:
    """Raise ValueError for the first field of `options` that is below the least value named for it, or not a number."""
    for name, bound in least.items():
        value = getattr(options, name)
        if not (is_number(value) and value >= bound):
            raise ValueError(f"{type(options).__name__}.{name} must be at least {bound}, not {value!r}")


def check_whole(options: object, **least: int) -> None:
    """Raise ValueError for the first field of `options` that is not a whole number from the one named for it on."""
    for name, bound in least.items():
        value = getattr(options, name)
        if not is_whole(value):
            raise ValueError(f"{type(options).__name__}.{name} must be a whole number, not {value!r}")
        if value < bound:
            raise ValueError(f"{type(options).__name__}.{name} must be at least {bound}, not {value}")


def check_between_0_and_1(options: object, *names: str) -> None:
    """Raise ValueError for the first of these fields of `options` that is not a number above 0 and below 1."""
    for name in names:
        value = getattr(options, name)
        if not (is_number(value) and 0 < value < 1):
            raise ValueError(f"{type(options).__name__}.{name} must be between 0 and 1, not {value!r}")
