"""Values that change in time by keys: the camera's moves, the paths of driven vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .spec import Finite, Vec3, spec

Array = NDArray[np.float64]


@spec
class Track:
    """A value that changes in time: `keys` are (time [s], value) pairs, each value a number or each a vector of 3.

    Between two keys the value goes straight, or, with `smooth`, along a cubic that starts and ends at rest and passes
    the keys between without a jump in speed; it never leaves the range of the two keys around it (slopes: harmonic
    means, Fritsch & Butland 1984, "A method for constructing local monotone piecewise cubic interpolants", equation 5).
    Before the first key and after the last the value is held.

    Raises `InputError` without a key, if times do not increase, or if numbers and vectors are mixed or a wrong type or value.
    """

    keys: tuple[tuple[Finite, Finite | Vec3], ...]
    smooth: bool = False

    def __post_init__(self) -> None:
        if not self.keys:
            raise InputError("a Track needs at least one key, (time, value)")
        for (before, _), (after, _) in zip(self.keys, self.keys[1:], strict=False):
            if not before < after:
                raise InputError(f"Track key times must increase: {after:g} s comes after {before:g} s")
        if len({isinstance(value, tuple) for _, value in self.keys}) > 1:
            raise InputError("a Track mixes numbers and vectors: its values must be all of one kind")

    @property
    def is_vector(self) -> bool:
        """Whether the values are vectors of 3."""
        return isinstance(self.keys[0][1], tuple)

    def at(self, t: float) -> Array:
        """Return the value at time `t` [s], shape () or (3,)."""
        times = np.array([time for time, _ in self.keys])
        values = np.array([value for _, value in self.keys], dtype=np.float64)
        if t <= times[0] or t >= times[-1]:
            return values[0 if t <= times[0] else -1]
        i = int(np.searchsorted(times, t, side="right")) - 1
        h = times[i + 1] - times[i]
        s = (t - times[i]) / h
        if not self.smooth:
            return (1.0 - s) * values[i] + s * values[i + 1]
        m0, m1 = _slope(times, values, i), _slope(times, values, i + 1)
        # Cubic Hermite: (1 + 2 s)(1 - s)^2 v0 + s (1 - s)^2 h m0 + s^2 (3 - 2 s) v1 - s^2 (1 - s) h m1
        rest = 1.0 - s
        return (
            (1.0 + 2.0 * s) * rest**2 * values[i]
            + s * rest**2 * h * m0
            + s**2 * (3.0 - 2.0 * s) * values[i + 1]
            - s**2 * rest * h * m1
        )

    def cubics(self) -> tuple[Array, Array]:
        """Return the track as polynomials, for kernels: key times [s], shape (n,), and coefficients, shape (n, 4) or (n, 4, 3).

        From key i to the next the value is c0 + c1 s + c2 s^2 + c3 s^3 with s = t - times[i] and c = coefficients[i]; the last
        row holds the last value.
        """
        times = np.array([time for time, _ in self.keys])
        values = np.array([value for _, value in self.keys], dtype=np.float64)
        result = np.zeros((len(times), 4, *values.shape[1:]))
        result[:, 0] = values
        for i, h in enumerate(np.diff(times)):
            d = (values[i + 1] - values[i]) / h
            result[i, 1] = d
            if self.smooth:
                m0, m1 = _slope(times, values, i), _slope(times, values, i + 1)
                result[i, 1:] = m0, (3.0 * d - 2.0 * m0 - m1) / h, (m0 + m1 - 2.0 * d) / h**2
        return times, result

    def speed(self, t: float) -> Array:
        """Return the rate of change at time `t` [1/s], shape () or (3,); at a corner, that of the piece that begins there."""
        times, c = self.cubics()
        if t < times[0]:
            return np.zeros_like(c[0, 0])
        i = int(np.searchsorted(times, t, side="right")) - 1
        s = t - times[i]
        return c[i, 1] + s * (2.0 * c[i, 2] + 3.0 * s * c[i, 3])


def _slope(times: Array, values: Array, i: int) -> Array:
    """Return the slope at key i: 0 at the ends and where a component turns, else the weighted harmonic mean."""
    if i in (0, len(times) - 1):
        return np.zeros_like(values[i])
    h0, h1 = times[i] - times[i - 1], times[i + 1] - times[i]
    d0, d1 = (values[i] - values[i - 1]) / h0, (values[i + 1] - values[i]) / h1
    # a = (h0 + 2 h1) / (3 (h0 + h1)), slope = d0 d1 / (a d1 + (1 - a) d0)
    a = (h0 + 2.0 * h1) / (3.0 * (h0 + h1))
    same = d0 * d1 > 0.0
    return np.where(same, d0 * d1 / np.where(same, a * d1 + (1.0 - a) * d0, 1.0), 0.0)
