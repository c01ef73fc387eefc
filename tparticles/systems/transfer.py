"""The living to host arrays and back, all columns in one launch: what a checkpoint holds of a group."""

# pyright: reportInvalidTypeForm=false, reportIndexIssue=false

from collections.abc import Mapping

import numpy as np
import taichi as ti

from ..errors import RunError
from .attributes import Columns

_KINDS = {"i32": np.int32, "f32": np.float32, "f64": np.float64}


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
            kind = next(kind for kind in _KINDS if fields[0].dtype == getattr(ti, kind))
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
                i32[k, i] = self.fields["i32"][k][i]
            for k in ti.static(range(len(self.fields["f32"]))):
                f32[k, i] = self.fields["f32"][k][i]
            for k in ti.static(range(len(self.fields["f64"]))):
                f64[k, i] = self.fields["f64"][k][i]

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
                self.fields["i32"][k][i] = i32[k, i]
            for k in ti.static(range(len(self.fields["f32"]))):
                self.fields["f32"][k][i] = f32[k, i]
            for k in ti.static(range(len(self.fields["f64"]))):
                self.fields["f64"][k][i] = f64[k, i]
