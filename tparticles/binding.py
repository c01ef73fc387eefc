"""Binding: how a frozen description becomes kernel code whose parameters are data.

Bound for a kernel, the attributes of a spec or a law (an object with `@ti.func` methods) are

- float, or tuple of floats (a vector): read from a parameter pool at run time, so that another value compiles nothing;
- NumPy array: a field, indexed at run time as `self.name[i]`;
- other specs and laws (and tuples of them): bound in turn;
- all the rest (int, bool, str): constants of the compiled kernel.

An object with a method `derived()` adds what it returns, a dict of the same kinds of values worked out on the host.
"""

import dataclasses
from typing import Any

import numpy as np
import taichi as ti


@ti.func
def _scalar(source: ti.template(), i: ti.template()):
    return source[i]


@ti.func
def _vector(source: ti.template(), i: ti.template(), n: ti.template()):
    return ti.Vector([source[i + d] for d in ti.static(range(n))])


class Parameters:
    """The pool of one kernel's run-time parameters.

    `source` is what the bound attributes read: the field, or, inside a kernel that called `hoist`, a local vector. Lane
    loops only vectorise over locals: a load from a field inside them might alias a store.
    """

    def __init__(self) -> None:
        self.values: list[float] = []
        self.source: Any = None
        self.field: Any = None

    def bind(self, law: Any, *, skip: tuple[str, ...] = ()) -> Any:
        """Return a twin of `law` for use inside a kernel, without the attributes in `skip`; its floats join the pool."""
        properties: dict[str, Any] = {}
        constants: dict[str, Any] = {}
        for name, value in (vars(law) | getattr(law, "derived", dict)()).items():
            if name in skip:
                continue
            if isinstance(value, float):
                properties[name] = self._reader(len(self.values), None)
                self.values.append(value)
            elif isinstance(value, tuple) and value and all(isinstance(v, float) for v in value):
                properties[name] = self._reader(len(self.values), len(value))
                self.values.extend(value)
            elif isinstance(value, np.ndarray):
                constants[name] = _table(value)
            elif isinstance(value, tuple):
                constants[name] = tuple(self.bind(v) if _is_bindable(v) else v for v in value)
            else:
                constants[name] = self.bind(value) if _is_bindable(value) else value
        bound = object.__new__(type(type(law).__name__, (type(law),), properties))
        bound.__dict__.update(constants)
        return bound

    def _reader(self, first: int, count: int | None) -> property:
        if count is None:
            return property(lambda _: _scalar(self.source, first))
        return property(lambda _: _vector(self.source, first, count))

    def allocate(self) -> None:
        """Make the field and fill it; call once, after the last `bind` and before the first launch."""
        self.field = self.source = ti.field(float, max(1, len(self.values)))
        self.field.from_numpy(np.asarray(self.values or [0.0]).astype(np.float64))

    def hoist(self, local: Any) -> None:
        """Read from the local vector `local` from here on (called while a kernel is traced)."""
        self.source = local


def _is_bindable(value: Any) -> bool:
    if isinstance(value, type):
        return False
    functions = (f for cls in type(value).__mro__ for f in vars(cls).values())
    return dataclasses.is_dataclass(value) or any(getattr(f, "_is_taichi_function", False) for f in functions)


def _table(values: np.ndarray) -> Any:
    table = ti.field(ti.u32 if values.dtype == np.uint32 else float, values.shape)
    table.from_numpy(values)
    return table
