"""Libraries that take long to import: named at the head of a module, imported when something of them is first used.

SymPy, numba, SciPy and pyarrow cost a second of CPU together, and a stage is a process that needs few of them. Every
module takes them from here, so that importing it costs what its own lines cost; a test holds for each command what it
may have imported when it ends. `njit` is numba's: a kernel is no more than its Python function until it is called.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import update_wrapper
from importlib import import_module
from types import FunctionType, ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numba
    import pyarrow
    import pyarrow.compute as pyarrow_compute
    import pyarrow.csv as pyarrow_csv
    import pyarrow.parquet as pyarrow_parquet
    import rerun
    import rerun.blueprint as rerun_blueprint
    import scipy
    import sympy
    from numba import njit

__all__ = [
    "interpreted",
    "njit",
    "numba",
    "pyarrow",
    "pyarrow_compute",
    "pyarrow_csv",
    "pyarrow_parquet",
    "rerun",
    "rerun_blueprint",
    "scipy",
    "sympy",
]


class _Library:
    """A library under its name; what was asked for once is kept, so that it costs nothing more."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        value = getattr(import_module(self._name), attribute)
        self.__dict__[attribute] = value
        return value


class _Kernel:
    """A function that numba compiles when it is called, or when another kernel calls it.

    Args:
        py_func: the function; given: what `numba.njit` is given, a signature as text.
    """

    def __init__(self, py_func: Callable[..., Any], given: tuple[tuple[Any, ...], dict[str, Any]]) -> None:
        self.py_func, self._given = py_func, given
        update_wrapper(self, py_func)

    def __call__(self, *arguments: Any) -> Any:
        return self._compiled(*arguments)

    def __getattr__(self, attribute: str) -> Any:
        """Attribute that numba reads from its own functions, their type (`_numba_type_`) among them."""
        if attribute != "_compiled":
            return getattr(self._compiled, attribute)
        signature, options = self._given
        return self.__dict__.setdefault("_compiled", import_module("numba").njit(*signature, **options)(self.py_func))

    def __reduce__(self) -> str:
        return self.py_func.__qualname__


def interpreted(module: ModuleType) -> SimpleNamespace:
    """Names of a module with its kernels as plain Python functions, also where one calls another."""
    names = dict(vars(module))
    names |= {
        name: FunctionType(value.py_func.__code__, names, name)
        for name, value in vars(module).items()
        if isinstance(value, _Kernel)
    }
    return SimpleNamespace(**names)


if not TYPE_CHECKING:
    numba, pyarrow, rerun, scipy, sympy = map(_Library, ("numba", "pyarrow", "rerun", "scipy", "sympy"))
    pyarrow_compute, pyarrow_csv, pyarrow_parquet = map(_Library, ("pyarrow.compute", "pyarrow.csv", "pyarrow.parquet"))
    rerun_blueprint = _Library("rerun.blueprint")

    def njit(*signature: Any, **options: Any) -> Any:
        """Kernel as `numba.njit` makes it, with and without arguments, without a wrapper for C code: none calls it."""
        options = {"no_cfunc_wrapper": True} | options
        if len(signature) == 1 and callable(signature[0]):
            return _Kernel(signature[0], ((), options))
        return lambda function: _Kernel(function, (signature, options))
