"""Numbers on a regular grid, as part of a frozen description."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

_AXES = "xyz"


class Samples:
    """A read-only array of finite numbers with one axis per dimension, at least two samples along each; equal if its content is.

    Raises:
        ValueError: another shape, or something that is no finite number.
    """

    def __init__(self, values: Any, *, dimensions: int):
        try:
            array = np.asarray(values)
        except ValueError:
            raise ValueError("its rows differ in length") from None
        if array.dtype.kind not in "fiu":
            raise ValueError(f"should be numbers, not {array.dtype}")
        if array.ndim != dimensions or min(array.shape) < 2:
            wanted = ", ".join(f"n{_AXES[d]}" for d in range(dimensions))
            raise ValueError(f"should have shape ({wanted}), at least 2 each, not {array.shape}")
        array = np.array(array, np.float64, order="C") + 0.0
        if not np.isfinite(array).all():
            raise ValueError(f"value {np.argwhere(~np.isfinite(array))[0].tolist()} is not finite")
        array.flags.writeable = False
        self.values = array

    @cached_property
    def content(self) -> str:
        """A hash of the numbers, the same in any process."""
        return hashlib.sha256(f"{self.values.shape}".encode() + self.values.tobytes()).hexdigest()[:16]

    def __repr__(self) -> str:
        return f"Samples({'x'.join(map(str, self.values.shape))}, content {self.content})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Samples) and self.content == other.content

    def __hash__(self) -> int:
        return hash(self.content)

    def __reduce__(self) -> tuple[Callable[..., Samples], tuple[Any, ...]]:
        return _restored, (self.values,)


def samples(dimensions: int) -> Callable[[Any], Samples]:
    """Return a validator that makes `Samples` of arrays with so many dimensions."""

    def read(value: Any) -> Samples:
        return value if isinstance(value, Samples) else Samples(value, dimensions=dimensions)

    return read


def _restored(values: np.ndarray) -> Samples:
    return Samples(values, dimensions=values.ndim)
