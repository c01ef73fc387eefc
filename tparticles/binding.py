"""Binding: how a frozen description becomes kernel code whose parameters are data.

Bound for a kernel, the attributes of a spec or a law (an object with `@ti.func` methods) are

- float, or tuple of numbers with a float among them (a vector): read from a parameter pool at run time, so that another
  value compiles nothing;
- NumPy array (one-dimensional): in the pool too, indexed at run time as `self.name[i]`;
- other specs and laws (and tuples of them): bound in turn;
- all the rest (int, bool, str): constants of the compiled kernel.

An object with a method `derived()` adds what it returns, a dict of the same kinds of values worked out on the host.
"""

import dataclasses
from typing import Any

import numpy as np
import taichi as ti
from taichi.lang.impl import subscript

from . import backend
from .errors import InputError


class Parameters:
    """A pool of run-time parameters, handed to kernels as one array.

    A kernel that uses bound objects takes `values: ti.types.ndarray(ndim=1)` and says first
    `ti.static(self.parameters.read_from(values))`; it is launched with `self.parameters.array`.
    """

    def __init__(self) -> None:
        self.scalars: list[float] = []
        self.structure: list[
            Any
        ] = []  # what kernels are compiled for: of two pools that are alike in it, only values differ
        self._tables: list[np.ndarray] = []
        self._length = 0
        self._array: np.ndarray | None = None
        self._source: Any = None
        self._locals: Any = None

    def bind(self, law: Any, *, skip: tuple[str, ...] = ()) -> Any:
        """Return a twin of `law` for use inside kernels, without the attributes in `skip`."""
        properties: dict[str, Any] = {}
        constants: dict[str, Any] = {}
        self.structure.append(type(law))
        for name, value in (vars(law) | getattr(law, "derived", dict)()).items():
            if name in skip:
                continue
            self.structure.append((name, _kind(value)))
            if isinstance(value, float):
                properties[name] = self._scalar(value)
            elif isinstance(value, tuple) and _is_vector(value):
                properties[name] = self._vector(value)
            elif isinstance(value, np.ndarray):
                constants[name] = self.table(value)
            elif isinstance(value, tuple):
                constants[name] = tuple(self.bind(v) if _is_bindable(v) else v for v in value)
            else:
                constants[name] = self.bind(value) if _is_bindable(value) else value
        bound = object.__new__(type(type(law).__name__, (type(law),), properties))
        bound.__dict__.update(constants)
        return bound

    def _scalar(self, value: float) -> property:
        i, self._array = len(self.scalars), None
        self.scalars.append(value)
        return property(lambda _: self.load(i))

    def _vector(self, values: tuple[float, ...]) -> property:
        first, self._array = len(self.scalars), None
        self.scalars.extend(values)
        return property(lambda _: ti.Vector([self.load(first + d) for d in range(len(values))]))

    def table(self, values: np.ndarray) -> "_Table":
        """Put an array into the pool; return what kernels index."""
        if values.ndim != 1 or values.dtype.kind not in "fiub":
            raise InputError(
                f"a law's array must be one-dimensional and real, not {values.dtype} of shape {values.shape}"
            )
        table, self._array = _Table(self, self._length), None
        self._tables.append(values)
        self._length += values.size
        return table

    @property
    def array(self) -> np.ndarray:
        """All values in the precision of the run: scalars, then tables."""
        if self._array is None:
            kind = np.float64 if backend.current().precision == "f64" else np.float32
            self._array = np.concatenate([np.array([*self.scalars, 0.0]), *self._tables]).astype(kind)
        return self._array

    def read_from(self, values: Any) -> None:
        """Read from the kernel's array `values` from here on (while the kernel is traced)."""
        self._source, self._locals = values, None

    def hoist(self, locals_: Any) -> None:
        """Read the scalars from a local vector instead: a load from an array inside a lane loop might alias a store."""
        self._locals = locals_

    def load(self, i: int) -> Any:
        """Return scalar `i` (while a kernel is traced)."""
        return subscript(None, self._source if self._locals is None else self._locals, i)

    def load_table(self, i: Any) -> Any:
        """Return entry `i` of the tables (while a kernel is traced); `i` may be a run-time value."""
        return subscript(None, self._source, len(self.scalars) + 1 + i)


class _Table:
    """A table inside the pool; kernels index it like a field."""

    def __init__(self, pool: Parameters, first: int):
        self._pool, self._first = pool, first

    def __getitem__(self, i: Any) -> Any:
        return self._pool.load_table(self._first + i)


def _kind(value: Any) -> Any:
    """Return what of an attribute is compiled: the value itself, unless it goes to the pool or is bound in turn."""
    if isinstance(value, float | np.ndarray) or (isinstance(value, tuple) and _is_vector(value)):
        return type(value), np.shape(value)
    if isinstance(value, tuple):
        return tuple(map(_kind, value))
    if value is None or isinstance(value, bool | int | str):
        return type(value), value
    return type(value), None if _is_bindable(value) else id(value)


def _is_vector(value: tuple[Any, ...]) -> bool:
    """Numbers, at least one of them a float: (0.0, 0, 1.5) is a vector, (1, 2) are two integers."""
    numbers = all(isinstance(v, float | int) and not isinstance(v, bool) for v in value)
    return numbers and any(isinstance(v, float) for v in value)


def _is_bindable(value: Any) -> bool:
    if isinstance(value, type):
        return False
    functions = (f for cls in type(value).__mro__ for f in vars(cls).values())
    return dataclasses.is_dataclass(value) or any(getattr(f, "_is_taichi_function", False) for f in functions)
