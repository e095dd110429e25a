"""The methods that are compared: functions with a name.

Nothing here imports torch, so that a file with a method costs nothing until it is run.
"""

import importlib
import importlib.util
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

from .answers import Missing
from .weights import weights_file

Function = TypeVar("Function", bound=Callable[..., Any])

# The modules of bench/methods, each of which has some of the built-in methods.
_BUILTIN = ("ours", "tools", "extensions", "networks")


@dataclass(frozen=True)
class Method:
    """A method under its name.

    function    takes a `MeshBatch` of one mesh, which it must not change, and returns another one or a `Result`
    undeformed  whether it also takes the undeformed mesh, as its second argument
    libraries   the modules that must be installed, beside those that torchmesh needs anyway
    weights     whether it needs the weights of the benchmark's network
    home        the module or file that it was defined in
    """

    name: str
    function: Callable[..., Any]
    undeformed: bool = False
    libraries: tuple[str, ...] = ()
    weights: bool = False
    home: str = field(default="", compare=False)

    @property
    def builtin(self) -> bool:
        """Whether the method is one of torchmesh's own modules."""
        return self.home.startswith(f"{__package__}.methods.")

    def check(self) -> None:
        """Raise Missing, naming it, if a library is not installed, or the weights of the network are not there."""
        for name in self.libraries:
            if importlib.util.find_spec(name) is None:
                raise Missing(f"{self.name} needs {name}: pip install 'torchmesh-untangle[bench,peers]'")
        if self.weights:
            weights_file()


# All methods known so far, by name.
METHODS: dict[str, Method] = {}


def method(
    name: str, *, undeformed: bool = False, libraries: tuple[str, ...] = (), weights: bool = False
) -> Callable[[Function], Function]:
    """Decorate a function to make it a method of the benchmark.

    name        under which the results have it: letters, digits, and - _ . +
    undeformed  True: the function gets the tangled mesh and the undeformed one, whose boundary is elsewhere
    libraries   modules that must be installed; without them the method is left out, and that is said
    weights     whether it needs the weights of the benchmark's network

    The function gets a `MeshBatch` of one mesh, and returns another one with no inverted triangle, whose boundary
    vertices and other fixed vertices are where they were; vertices and triangles may have other rows.  It may raise
    `bench.Refused` for a mesh that it cannot take; any other exception counts as a failure.

    Raises ValueError for a name that cannot be, or that a built-in method has.
    """
    if not isinstance(name, str) or not name or not all(c.isalnum() or c in "-_.+" for c in name):
        raise ValueError(f"the name of a method has letters, digits and -_.+ only, not {name!r}")

    def register(function: Function) -> Function:
        home = function.__module__
        made = Method(name, function, undeformed, tuple(libraries), weights, home)
        builtin_methods()
        if name in METHODS and METHODS[name].builtin and METHODS[name].home != home:
            raise ValueError(f"{name!r} is a built-in method: give yours another name")
        METHODS[name] = made
        return function

    return register


def builtin_methods() -> list[str]:
    """The names of the methods that torchmesh brings, whether or not their libraries are installed."""
    if not _LOADED:
        _LOADED.append(True)
        for module in _BUILTIN:
            importlib.import_module(f".methods.{module}", __package__)
    return [name for name, known in METHODS.items() if known.builtin]


# Holds True once the built-in methods are registered.
_LOADED: list[bool] = []


def why_not(known: Method) -> str:
    """What the method lacks to run here, in words; "" if nothing."""
    try:
        known.check()
    except Missing as why:
        return str(why)
    return ""


def words(known: Method) -> str:
    """The first sentence of its docstring."""
    return (known.function.__doc__ or "").strip().split("\n")[0]


def chosen(names: list[str]) -> list[Method]:
    """The methods of these names, "all" meaning every built-in one.  Raises ValueError for an unknown name."""
    builtin = builtin_methods()
    wanted = list(dict.fromkeys(n for name in names for n in (builtin if name == "all" else [name])))
    unknown = [name for name in wanted if name not in METHODS]
    if unknown:
        raise ValueError(f"there is no method {', '.join(unknown)}; there are {', '.join(METHODS)}")
    return [METHODS[name] for name in wanted]


def methods_of(path: str) -> list[str]:
    """Run the file, and return the names of the methods that it defines.

    Raises ValueError, naming the file, if it cannot be run or defines none.
    """
    known = dict(METHODS)
    name = f"torchmesh_bench_file_{abs(hash(path))}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"{path}: this is no file of Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    folder = os.path.dirname(os.path.abspath(path))
    sys.path.insert(0, folder)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise ValueError(f"{path}: {type(error).__name__}: {error}") from error
    finally:
        sys.path.remove(folder)
    found = [n for n, m in METHODS.items() if known.get(n) is not m and not m.builtin]
    if not found:
        raise ValueError(f"{path}: no function in it is decorated with @bench.method")
    return found
