"""Host arrays to fields and back, all in one launch: to get a kernel ready takes longer than most copies.

`Transfer` is what a checkpoint holds of a group; `Contents` is what fields hold from the beginning.
"""

# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import taichi as ti

from ..errors import RunError
from ..hints import rolled
from .attributes import Columns

_KINDS = {"i32": np.int32, "f32": np.float32, "f64": np.float64}


def _kind(field: Any) -> str:
    return next(kind for kind in _KINDS if field.dtype == getattr(ti, kind))


@ti.data_oriented
class Transfer:
    """Copies every column of the first `count` slots."""

    def __init__(self, columns: Columns):
        self.columns = columns
        self.fields: dict[str, list] = {kind: [] for kind in _KINDS}
        self.places: dict[
            str, tuple[str, slice]
        ] = {}  # of an attribute: its type, and its rows among those of the type
        for name in columns.names:
            fields = columns[name]
            kind = _kind(fields[0])
            first = len(self.fields[kind])
            self.fields[kind] += fields
            self.places[name] = kind, slice(first, first + len(fields))

    def read(self, count: int) -> dict[str, np.ndarray]:
        """Return all attributes of the first `count` particles, each of shape (components, count)."""
        arrays = self._arrays(count)
        if count:
            self._read(count, *arrays.values())
        return {name: arrays[kind][rows] for name, (kind, rows) in self.places.items()}

    def write(self, values: Mapping[str, np.ndarray]) -> int:
        """Put what `read` returned into the first slots; return how many particles that is.

        Raises:
            RunError: other attributes, another type, another shape, or more particles than there is room for.
        """
        count = values["id"].shape[-1] if "id" in values else 0
        arrays = self._arrays(count)
        for name, (kind, rows) in self.places.items():
            value, place = values.get(name), arrays[kind][rows]
            if value is None or (value.shape, value.dtype) != (place.shape, place.dtype):
                raise RunError(f"attribute '{name}' is not {kind} of shape {place.shape}")
            place[:] = value
        if count > self.columns.capacity:
            raise RunError(f"{count} particles need more room than there is ({self.columns.capacity})")
        if count:
            self._write(count, *arrays.values())
        return count

    def _arrays(self, count: int) -> dict[str, np.ndarray]:
        """Return a row for every column, by type; kernels take no empty arrays, so there is at least one row."""
        return {kind: np.empty((max(len(fields), 1), count), _KINDS[kind]) for kind, fields in self.fields.items()}

    @ti.kernel
    def _read(
        self,
        count: ti.i32,
        i32: ti.types.ndarray(dtype=ti.i32, ndim=2),
        f32: ti.types.ndarray(dtype=ti.f32, ndim=2),
        f64: ti.types.ndarray(dtype=ti.f64, ndim=2),
    ):
        for i in range(count):
            for k in ti.static(range(len(self.fields["i32"]))):
                i32[k, i] = self.fields["i32"][k][self.columns.first + i]
            for k in ti.static(range(len(self.fields["f32"]))):
                f32[k, i] = self.fields["f32"][k][self.columns.first + i]
            for k in ti.static(range(len(self.fields["f64"]))):
                f64[k, i] = self.fields["f64"][k][self.columns.first + i]

    @ti.kernel
    def _write(
        self,
        count: ti.i32,
        i32: ti.types.ndarray(dtype=ti.i32, ndim=2),
        f32: ti.types.ndarray(dtype=ti.f32, ndim=2),
        f64: ti.types.ndarray(dtype=ti.f64, ndim=2),
    ):
        for i in range(count):
            for k in ti.static(range(len(self.fields["i32"]))):
                self.fields["i32"][k][self.columns.first + i] = i32[k, i]
            for k in ti.static(range(len(self.fields["f32"]))):
                self.fields["f32"][k][self.columns.first + i] = f32[k, i]
            for k in ti.static(range(len(self.fields["f64"]))):
                self.fields["f64"][k][self.columns.first + i] = f64[k, i]


@ti.data_oriented
class Contents:
    """Values that fields get when all are declared: Taichi lays out together what is declared together, and holds few layouts."""

    def __init__(self):
        self._parts: dict[str, list[tuple[Any, np.ndarray]]] = {kind: [] for kind in _KINDS}

    def add(self, field: Any, values: np.ndarray) -> Any:
        """Put `values` into `field`, of their shape, when it comes to `fill`; return the field."""
        if values.shape != field.shape:
            raise ValueError(f"values of shape {values.shape} do not fit a field of shape {field.shape}")
        self._parts[_kind(field)].append((field, values))
        return field

    def fill(self) -> None:
        """Fill the fields, and forget the values."""
        values, self.places = {}, {}
        for kind, parts in self._parts.items():
            values[kind] = np.concatenate([v.ravel() for _, v in parts] or [[0]]).astype(_KINDS[kind])
            firsts = np.cumsum([0, *(v.size for _, v in parts)]).tolist()
            self.places[kind] = [(field, first) for (field, _), first in zip(parts, firsts, strict=False)]
            parts.clear()
        self._zero = ti.field(ti.i32, 1)  # behind the others: their rows stay aligned
        self._fill(*values.values())

    @ti.kernel
    def _fill(
        self,
        i32: ti.types.ndarray(dtype=ti.i32, ndim=1),
        f32: ti.types.ndarray(dtype=ti.f32, ndim=1),
        f64: ti.types.ndarray(dtype=ti.f64, ndim=1),
    ):
        # One loop for all fields of a type: over one for each, which it vectorises, LLVM takes ten times as long.
        for i in range(i32.shape[0]):
            rolled(self._zero)
            for field, first in ti.static(self.places["i32"]):
                self._put(field, i - first, i32[i])
        for i in range(f32.shape[0]):
            rolled(self._zero)
            for field, first in ti.static(self.places["f32"]):
                self._put(field, i - first, f32[i])
        for i in range(f64.shape[0]):
            rolled(self._zero)
            for field, first in ti.static(self.places["f64"]):
                self._put(field, i - first, f64[i])

    @ti.func
    def _put(self, field: ti.template(), at, value):
        """Set number `at` of a field, if it has so many."""
        if 0 <= at < ti.static(math.prod(field.shape)):
            if ti.static(len(field.shape) == 1):
                field[at] = value
            else:
                field[at // ti.static(field.shape[-1]), at % ti.static(field.shape[-1])] = value
