"""SymPy expressions as numba kernels, in floating point and in outward rounded intervals, that outlive their process.

A kernel made for a case is a closure: over numbers, arrays and other kernels. numba keeps machine code for functions of
a source file alone, so the closure is written out as one: a module in the cache folder that holds its text, its
numbers, and imports of what it calls. Its name is a digest of all of that, of the kernels' sources, and of numba's
version; another process that needs the same kernel loads it in milliseconds instead of compiling it for seconds.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import math
import os
import sys
import textwrap
import types
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from simgap import reading
from simgap.arrays import Floats
from simgap.cache import cache_folder, kernel_sources, whole_file
from simgap.errors import UserError
from simgap.late import numba
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol

Kernel = Callable[..., Any]
_PACKAGE = "simgap_kernels"
_LARGE = 10**6  # bytes of an array above which numba takes its address for its content, and keeps no machine code


_OPTIONS: dict[str, dict[str, Any]] = {
    "njit": {"error_model": "numpy", "no_cfunc_wrapper": True},  # C calls none of them, and wrappers take time
    "cfunc": {"error_model": "numpy"},
}


class _NotWritable(Exception):
    """Something that a closure holds has no text, or there is no place for it."""


def cached_kernel(function: Callable[..., Any]) -> Kernel:
    """`numba.njit(error_model="numpy")` of a closure; its machine code is kept between processes where it can be."""
    return _cached(function, "njit", "", lambda f: numba.njit(**_OPTIONS["njit"])(f))


def cached_kernel_as(signature: Any, decorator: str = "njit") -> Callable[[Callable[..., Any]], Any]:
    """Likewise `numba.njit` or `numba.cfunc` with a signature, which is a name of the closure's module."""

    def decorate(function: Callable[..., Any]) -> Any:
        name = next(name for name, value in function.__globals__.items() if value is signature)
        compiled = getattr(numba, decorator)(signature, **_OPTIONS[decorator])
        return _cached(function, decorator, f"{name}, ", compiled, name)

    return decorate


def _cached(function: Callable[..., Any], decorator: str, first: str, compiled: Callable[..., Any], *names: str) -> Any:
    try:
        head = ["from __future__ import annotations", f"from numba import {decorator}", *_bindings(function, names)]
        options = ", ".join(f"{name}={value!r}" for name, value in _OPTIONS[decorator].items())
        mark = f"@{decorator}({first}{options}, cache=True)"
        module = _module("\n".join([*head, "", mark, _text_of(function)]))
        return getattr(module, function.__name__)
    except (_NotWritable, OSError):
        return compiled(function)


def _text_of(function: Callable[..., Any]) -> str:
    """The function's source without its decorators."""
    lines = textwrap.dedent(inspect.getsource(function)).splitlines()
    start = next(n for n, line in enumerate(lines) if line.startswith("def "))
    return "\n".join(lines[start:]) + "\n"


def _bindings(function: Callable[..., Any], names: tuple[str, ...]) -> Iterator[str]:
    """Lines that give every free name of the function its value."""
    code, globals_ = function.__code__, function.__globals__
    cells = dict(zip(code.co_freevars, (c.cell_contents for c in function.__closure__ or ()), strict=True))
    for name in sorted(cells):
        yield _binding(name, cells[name], None)
    for name in sorted({*code.co_names, *names} & set(globals_) - set(cells)):
        yield _binding(name, globals_[name], function.__module__)


def _binding(name: str, value: Any, module: str | None) -> str:
    if isinstance(value, types.ModuleType):
        return f"import {value.__name__} as {name}"
    own = getattr(value, "py_func", None)
    for home, called in ((getattr(own, "__module__", None), getattr(own, "__name__", "")), (module, name)):
        if home in sys.modules and getattr(sys.modules[home], called, None) is value:
            return f"from {home} import {called} as {name}  # {_stamp(home)}"
    if isinstance(value, bool | int | str):
        return f"{name} = {value!r}"
    if isinstance(value, float):
        return f"{name} = float({float(value)!r})" if math.isfinite(value) else f"{name} = float({str(value)!r})"
    if isinstance(value, np.ndarray):
        if value.nbytes > _LARGE:
            raise _NotWritable(name)
        return f"import numpy\n{name} = numpy.load({str(_array(value))!r})"
    home, called = getattr(value, "__module__", None), getattr(value, "__name__", "")
    if home in sys.modules and getattr(sys.modules[home], called, None) is value:
        return f"from {home} import {called} as {name}  # {_stamp(home)}"
    raise _NotWritable(name)


def _array(value: np.ndarray[Any, Any]) -> Path:
    """The array as a file named after its content."""
    digest = hashlib.sha256(f"{value.dtype.str}{value.shape}".encode() + value.tobytes()).hexdigest()[:32]
    path = _folder() / f"a_{digest}.npy"
    if not path.exists():
        with whole_file(path) as temporary:
            np.save(temporary, np.ascontiguousarray(value), allow_pickle=False)
    return path


def _module(text: str) -> types.ModuleType:
    """The module of this text, imported; written first if it is new."""
    name = "k_" + hashlib.sha256(f"{text}{_sources()}".encode()).hexdigest()[:32]
    path = _folder() / f"{name}.py"
    if not path.exists():
        with whole_file(path) as temporary:
            temporary.write(text.encode())
        importlib.invalidate_caches()
    return importlib.import_module(f"{_PACKAGE}.{name}")


@cache
def _folder() -> Path:
    """Folder of the modules; importable as a package."""
    home = cache_folder()
    if home is None:
        raise _NotWritable("no home")
    path = home / "kernels" / kernel_sources()
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not os.access(path, os.W_OK):
        raise _NotWritable(str(path))
    package = types.ModuleType(_PACKAGE)
    package.__path__ = [str(path)]
    sys.modules[_PACKAGE] = package
    return path


@cache
def _sources() -> str:
    """The package's kernels and the version of the compiler: what a kernel calls may stand in any of their files."""
    return "".join([numba.__version__, sys.version, kernel_sources()])


@cache
def _stamp(module: str) -> str:
    """Digest of the sources of a module that is not the package's own, such as a plug-in's, and of kernels it takes."""
    if module.split(".")[0] in {"simgap", _PACKAGE, "builtins", "math", "numpy"}:
        return ""
    file = getattr(sys.modules[module], "__file__", None)
    if file is None:
        raise _NotWritable(module)
    kernels = [getattr(value, "py_func", None) for value in vars(sys.modules[module]).values()]
    others = sorted({k.__module__ for k in kernels if k is not None} - {module})
    return hashlib.sha256(reading.read_bytes(Path(file)) + "".join(map(_stamp, others)).encode()).hexdigest()


def compile_kernel(
    exprs: Sequence[sp.Expr], groups: Sequence[Sequence[sp.Symbol]], before: Sequence[tuple[sp.Symbol, sp.Expr]] = ()
) -> Kernel:
    """A numba function `g(a, b, ...) -> (value, ...)` of one 1-D float64 array for each group of symbols.

    `before`: symbols that later expressions hold, each with its own over the groups' symbols and those before it. A
    chain of minima and maxima that is written out as one expression takes SymPy a second.
    """
    vectors, names = [sp.DeferredVector(f"a{k}") for k in range(len(groups))], [s for s, _ in before]
    rows = _indexed([*(e for _, e in before), *exprs], [*groups, names], [*vectors, names])
    steps, values = [*zip(names, rows, strict=False)], tuple(_floating(e) for e in rows[len(names) :])
    return cached_kernel(sp.lambdify(vectors, values, modules="math", cse=(lambda e: (steps, e)) if steps else True))


def compile_interval_kernel(exprs: Sequence[sp.Expr], groups: Sequence[Sequence[sp.Symbol]]) -> Kernel:
    """A numba function `g(lo_a, hi_a, lo_b, hi_b, ...) -> ((lo, hi), ...)`: an outward rounded enclosure.

    For every point of the boxes [lo_a, hi_a] x [lo_b, hi_b] x ... the exact value of each expression lies in its pair.

    Raises:
        UserError: for a function without an interval version.
    """
    vectors = [sp.DeferredVector(f"a{k}") for k in range(len(groups))]
    ends = [sp.Symbol(f"a{k}_{side}") for k in range(len(groups)) for side in ("lo", "hi")]
    values = tuple(sp.sympify(e) for e in _indexed(exprs, groups, vectors))
    from simgap.model.interval_printer import PRIMITIVES, IntervalPrinter

    printer = IntervalPrinter({"fully_qualified_modules": False, "allow_unknown_functions": True})
    function = sp.lambdify(ends, values, modules=[PRIMITIVES], printer=printer, cse=True)
    return cached_kernel(function)


def compile_columns(exprs: Sequence[sp.Expr], names: Sequence[str]) -> Callable[[Sequence[Floats]], Floats]:
    """A function of named columns (n,), in this order: -> (expressions, n)."""
    function = sp.lambdify([symbol(n) for n in names], list(exprs), modules="numpy", cse=True)

    def values(arguments: Sequence[Floats]) -> Floats:
        out = np.empty((len(exprs), *np.shape(arguments[0])))
        for row, column in zip(out, function(*arguments), strict=True):
            row[...] = column
        return out

    return values


def _indexed(
    exprs: Sequence[sp.Expr], groups: Sequence[Sequence[sp.Symbol]], vectors: Sequence[Sequence[sp.Expr]]
) -> list[sp.Expr]:
    places = {s: v[i] for group, v in zip(groups, vectors, strict=True) for i, s in enumerate(group)}
    free = set().union(*(sp.sympify(e).free_symbols for e in exprs)) - set(places)
    if free:
        raise UserError(f"an expression holds symbols without a value: {sorted(map(str, free))}")
    return [sp.sympify(e).xreplace(places) for e in exprs]


def _floating(e: sp.Expr) -> sp.Expr:
    """Bare numbers as floats, so that all entries of the tuple have one type; and those that are no int64."""
    if e.is_number:
        return sp.Float(e, 17)
    return e.xreplace({n: sp.Float(n, 17) for n in e.atoms(sp.Rational) if max(abs(n.p), n.q) >= 2**63})
