"""Public functions say what they expect where they are given something else than meshes and records of options.

    improve(points) --> TypeError: improve expects a MeshBatch as batch=, not a Tensor: MeshBatch.from_arrays(...) ...

Of each function, the parameters that its annotations call a mesh or a record of options are looked at.
"""

import dataclasses
import functools
import inspect
import os
import types
from collections.abc import Callable, Iterable
from typing import Any, ParamSpec, TypeVar, get_args, get_origin

from torch import Tensor

_P = ParamSpec("_P")
_R = TypeVar("_R")


@dataclasses.dataclass(frozen=True)
class _Parameter:
    """A parameter of a function: its place, its name, the record that it takes, and whether None will do, too."""

    place: int
    name: str
    kind: type
    may_be_none: bool


# The records and meshes among the fields of each type of options that was met.
_FIELDS: dict[type, tuple[_Parameter, ...]] = {}


def typed(verb: Callable[_P, _R]) -> Callable[_P, _R]:
    """`verb`, which raises TypeError for what is not the mesh or the record of options that its annotations say."""
    check = check_of(verb)

    @functools.wraps(verb)
    def checked(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        check(args, kwargs)
        return verb(*args, **kwargs)

    return checked


def check_of(verb: Callable[..., Any]) -> Callable[[tuple[Any, ...], dict[str, Any]], None]:
    """The check of positional and named arguments of `verb`, which raises TypeError."""
    parameters = _parameters(verb)
    name = verb.__name__.lstrip("_")

    def check(args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        for p in parameters:
            if p.place < len(args):
                value = args[p.place]
            elif p.name in kwargs:
                value = kwargs[p.name]
            else:
                continue
            if not isinstance(value, p.kind) and not (value is None and p.may_be_none):
                raise TypeError(f"{name} {_expected(p.kind, p.name, value)}")

    return check


def check_records(options: Any) -> None:
    """Raise TypeError where a field of a record of options is not the record or the mesh that it is to be."""
    kind = type(options)
    if kind not in _FIELDS:
        found = enumerate(dataclasses.fields(options))
        _FIELDS[kind] = tuple(p for place, f in found for p in _record(place, f.name, f.type))
    for f in _FIELDS[kind]:
        value = getattr(options, f.name)
        if not isinstance(value, f.kind) and not (value is None and f.may_be_none):
            raise TypeError(f"{kind.__name__} {_expected(f.kind, f.name, value)}")


def check_meshes(verb: str, kind: type, meshes: Any) -> None:
    """Raise TypeError, in the name of `verb`, unless all of a sequence are of the `kind`, meshes."""
    if not isinstance(meshes, Iterable):
        raise TypeError(f"{verb} expects several {kind.__name__}, not {_named(meshes)}")
    for mesh in meshes:
        if not isinstance(mesh, kind):
            raise TypeError(f"{verb} expects several {kind.__name__}, and among them {_made(kind, mesh)}")


def _parameters(verb: Callable[..., Any]) -> tuple[_Parameter, ...]:
    found = enumerate(inspect.signature(verb).parameters.values())
    return tuple(p for place, one in found for p in _record(place, one.name, one.annotation))


def _record(place: int, name: str, annotation: Any) -> list[_Parameter]:
    """The parameter, if its annotation is one record, or that or None."""
    kinds = [annotation]
    if get_origin(annotation) is types.UnionType:
        kinds = [kind for kind in get_args(annotation) if kind is not types.NoneType]
    if len(kinds) != 1 or not (isinstance(kinds[0], type) and dataclasses.is_dataclass(kinds[0])):
        return []
    return [_Parameter(place, name, kinds[0], kinds[0] is not annotation)]


def _expected(kind: type, name: str, value: Any) -> str:
    """'expects a MeshBatch as batch=, not a Tensor: ...'"""
    if kind.__name__ == "MeshBatch":
        return f"expects a MeshBatch as {name}=, {_made(kind, value)}"
    such = f": {kind.__name__}(**{name})" if type(value) is dict else ""
    return f"expects {kind.__name__} as {name}=, not {_named(value)}{such}"


def _made(kind: type, value: Any) -> str:
    """'not a Tensor: MeshBatch.from_arrays(points, triangles) makes a MeshBatch'"""
    way = f"{kind.__name__}.from_arrays(points, triangles)"
    if isinstance(value, str | os.PathLike):
        way = "read(path)"
    elif isinstance(value, list | tuple) and value and all(isinstance(part, kind) for part in value):
        way = "join(meshes)"
    elif not isinstance(value, Tensor) and not hasattr(value, "__array__"):
        return f"not {_named(value)}"
    return f"not {_named(value)}: {way} makes one"


def _named(value: Any) -> str:
    """'a Tensor', 'an ndarray', 'None'"""
    if value is None or isinstance(value, type):
        return repr(value)
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' or name == 'ndarray' else 'a'} {name}"
