"""All families of cases."""

import functools
from collections.abc import Iterator, Sequence

from .case import Case, Family
from .tangles import layered, network_outputs, onto_outlines, thrown, with_bodies

# The modules of bench/tangles, in the order in which their families are listed.
_MODULES = (with_bodies, thrown, onto_outlines, layered, network_outputs)


@functools.cache
def families() -> dict[str, Family]:
    """All families by name."""
    return {family.name: family for module in _MODULES for family in module.FAMILIES}


def chosen(names: Sequence[str]) -> list[Family]:
    """The families of these names, all if there are none.  Raises ValueError for an unknown name."""
    known = families()
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"there is no family {', '.join(unknown)}; there are {', '.join(known)}")
    return [known[name] for name in dict.fromkeys(names)] or list(known.values())


def cases(names: Sequence[str] = (), limit: int | None = None) -> Iterator[Case]:
    """The first `limit` cases of each of the named families; by default all cases of all families."""
    for family in chosen(names):
        for number in range(len(family) if limit is None else min(limit, len(family))):
            yield family.case(number)
