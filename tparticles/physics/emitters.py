"""Emitters: how many particles are born, when, and with which attributes.

The births are a function of the emitter and the seed alone. Counts are drawn per interval of the emitter's own clock and times
inside an interval are stratified, so ids, times and attributes are the same for any frame rate, sub-step or scheme.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field

from .. import rng
from ..errors import InputError
from ..spec import Count, Finite, NonNegative, Positive, spec
from .shapes import Cone, Point, Shape
from .spread import Spread, SpreadLike, positive

# Draws of one particle; each attribute has its own, so adding one never changes another.
DRAW_TIME, DRAW_POSITION, DRAW_VELOCITY, DRAW_TEMPERATURE, DRAW_SIZE, DRAW_LIFETIME = 0, 1, 4, 8, 10, 12

_MOST_INTERVALS = 50_000_000
_AROUND = 16  # births looked at before and after a time


def _to_keys(value: Any) -> Any:
    """Read a plain number as one pair; what is wrong with it is told of the number, not of the pair."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        if not math.isfinite(value):
            raise ValueError("should be a finite number")
        if value < 0:
            raise ValueError("should be greater than or equal to 0")
        return ((0.0, value),)
    if isinstance(value, str | bool) or not isinstance(value, Sequence):
        raise ValueError("should be a number, or a list of (time, value) pairs")
    return value


# A rate that changes with time: one number, or (time [s], value) pairs, linear in between and constant outside.
Keyed = Annotated[tuple[tuple[Finite, NonNegative], ...], Field(min_length=1), BeforeValidator(_to_keys)]


@spec
class PerFrame:
    """Reeves' rule: every interval of `frame` [s], mean + rand(-1, 1) * variance particles are born, fractions carried over.

    `mean` may be keyed: (time, value) pairs. The interval belongs to the emitter (1/24 s by default) and not to the film.
    """

    mean: Keyed
    variance: NonNegative = 0.0
    frame: Positive = 1 / 24


@spec
class Rate:
    """A continuous `rate` [1/s] of births, a number or (time, value) pairs; fractions are carried over."""

    rate: Keyed


@spec
class Burst:
    """`count` particles at the same `time` [s]."""

    count: Count
    time: Finite = 0.0


@spec
class Emitter:
    """A source of particles.

    `births`: a `PerFrame`, `Rate` or `Burst`, or a tuple of `Burst`s. Active from `start` to `stop` [s] (the film's end by
    default); `preroll` [s] lets it run that long before the film begins, so that the first frame is not empty.
    `shape` gives positions; `velocity` [m/s] (second-order systems only), `temperature` [K], `size` (diameter, [m]) and
    `lifetime` [s] (for ever, if None) have mean, variance and distribution.

    Raises:
        InputError: nothing to emit, an empty window, a size, temperature or lifetime that can be zero or less.
    """

    name: str = "emitter"
    births: PerFrame | Rate | Burst | tuple[Burst, ...]
    shape: Shape = Point()
    velocity: Cone | None = None
    temperature: SpreadLike | None = None
    size: SpreadLike = Spread(mean=0.01)
    lifetime: SpreadLike | None = None
    start: Finite = 0.0
    stop: Finite | None = None
    preroll: NonNegative = 0.0

    def __post_init__(self) -> None:
        here = f"emitter '{self.name}'"
        if self.stop is not None and self.stop <= self.start:
            raise InputError(f"{here}: stop = {self.stop:g} s must be after start = {self.start:g} s")
        for name in ("temperature", "size", "lifetime"):
            value = getattr(self, name)
            if value is not None:
                positive(here, name, value)
        if _nothing(self.births):
            raise InputError(f"{here} has nothing to emit: its births are zero at all times")
        bursts = _bursts(self.births)
        if bursts and not any(
            self.first_time <= b.time < (math.inf if self.stop is None else self.stop) for b in bursts
        ):
            raise InputError(
                f"{here} has nothing to emit: no burst falls between its first_time = {self.first_time:g} s and its stop"
            )
        for name in ("mean", "rate"):
            keys = getattr(self.births, name, ((0.0, 1.0),))
            if any(b[0] <= a[0] for a, b in itertools.pairwise(keys)):
                raise InputError(f"{here}: the times of births.{name} must increase")

    @property
    def first_time(self) -> float:
        """When the first particle can be born [s]."""
        return self.start - self.preroll


def _nothing(births: Any) -> bool:
    if isinstance(births, tuple):
        return not births
    keys = getattr(births, "mean", None) or getattr(births, "rate", ((0.0, 1.0),))
    return not any(value for _, value in keys) and not getattr(births, "variance", 0.0)


def _bursts(births: Any) -> tuple[Burst, ...]:
    return births if isinstance(births, tuple) else (births,) if isinstance(births, Burst) else ()


@dataclass(frozen=True)
class Births:
    """Particles born in one span of time: `count` consecutive ids from `first`.

    Row i of `spans`, float64 (intervals, 4), is an interval of the emitter: its start [s], its length [s], how many are born in
    it, and the first one's id. The kernel that emits works the times out from it, to the same bits as `times`.
    """

    first: int
    count: int
    spans: np.ndarray
    key: int

    @property
    def times(self) -> np.ndarray:
        """The birth times [s] in rising order, float64."""
        own = self.first + np.arange(self.count)
        start, length, count, first = self.spans[np.searchsorted(self.spans[:, 3], own, side="right") - 1].T
        return start + length * ((own - first + rng.uniform(self.key, own, DRAW_TIME)) / count)


class Schedule:
    """All births of one emitter up to the end of a film: intervals with a start, a length and a count each.

    An interval that the film's end cuts is kept whole, so that the births do not depend on where the film ends.
    Births of an interval lie at start + length (j + u_j) / count, u_j the particle's own draw: stratified, so they rise.
    """

    def __init__(self, emitter: Emitter, *, key: int, end: float):
        self.key = key
        self.starts, self.lengths, counts = _intervals(emitter, key, end)
        self.counts = counts
        self.ends = np.cumsum(counts)
        self.total = int(self.ends[-1]) if len(counts) else 0
        self._latest = -math.inf, 0  # a time, and how many are born before it: one frame ends where the next begins

    def births(self, t0: float, t1: float) -> Births:
        """Return who is born in [t0, t1)."""
        first, end = self._before(t0), self._before(t1)
        low = int(np.searchsorted(self.ends, first, side="right"))
        high = int(np.searchsorted(self.ends, end, side="left")) + 1 if end > first else low
        return Births(first, max(end - first, 0), self._spans(low, high), self.key)

    def _spans(self, low: int, high: int) -> np.ndarray:
        """Return the rows of `Births.spans` of the intervals low..high-1."""
        counts = self.counts[low:high]
        return np.stack([self.starts[low:high], self.lengths[low:high], counts, self.ends[low:high] - counts], axis=1)

    def _before(self, t: float) -> int:
        """Return how many are born before `t` [s]; their times need not be worked out."""
        if self._latest[0] != t:
            begun = int(np.searchsorted(self.starts, t, side="left"))
            # An interval ends where the next begins, but for rounding: only the last two may have births left.
            whole = max(begun - 2, 0)
            born = (int(self.ends[whole - 1]) if whole else 0) + sum(self._born(i, t) for i in range(whole, begun))
            self._latest = t, born
        return self._latest[1]

    def _born(self, interval: int, t: float) -> int:
        """Return how many of the births of an interval that began before `t` [s] come before it."""
        count, length = int(self.counts[interval]), float(self.lengths[interval])
        if count == 0 or length == 0.0 or t > self.starts[interval] + length:
            return count
        # The births are spread evenly: look around the one that should be next, and at all of them if it is not there.
        next_one = min(max((t - float(self.starts[interval])) / length, 0.0), 1.0) * count
        for low, high in ((int(next_one) - _AROUND, int(next_one) + _AROUND), (0, count)):
            low, high = max(low, 0), min(high, count)
            spans = self._spans(interval, interval + 1)
            times = Births(int(spans[0, 3]) + low, high - low, spans, self.key).times
            if (low == 0 or times[0] < t) and (high == count or times[-1] >= t):
                return low + int(np.searchsorted(times, t, side="left"))
        raise AssertionError("all births were looked at")

    def most_alive(self, lifetime: float, frame: float) -> int:
        """Return a bound on how many live at once, if each lives at most `lifetime` [s] and deaths wait for a frame [s]."""
        if not math.isfinite(lifetime):
            return self.total
        # births whose interval begins in (t - lifetime - frame, t], counted at the end of every interval
        begun = np.searchsorted(self.starts + self.lengths, self.starts - (lifetime + 2 * frame), side="left")
        before = np.concatenate([[0], self.ends])[begun]
        return int(np.max(self.ends - before, initial=0))


def _intervals(emitter: Emitter, key: int, end: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return starts [s], lengths [s] and counts of the intervals that begin before the film's `end` [s].

    Raises:
        InputError: more intervals or particles than can be numbered.
    """
    births, start = emitter.births, emitter.first_time
    stop = math.inf if emitter.stop is None else emitter.stop
    if isinstance(births, Burst | tuple):
        bursts = sorted((b for b in _bursts(births) if start <= b.time < min(stop, end)), key=lambda b: b.time)
        counts = np.array([b.count for b in bursts], np.int64)
        _check(emitter, "bursts", "particles", float(counts.sum()), 2**31)
        return np.array([b.time for b in bursts], float), np.zeros(len(bursts)), counts
    length = births.frame if isinstance(births, PerFrame) else 1 / 24
    needed = max(0.0, (min(stop, end) - start) / length - 1e-9)
    _check(emitter, f"births in intervals of {length:g} s", "intervals", needed, _MOST_INTERVALS)
    k = np.arange(math.ceil(needed))
    starts = start + k * length
    lengths = np.minimum(length, stop - starts)
    with np.errstate(over="ignore", invalid="ignore"):  # too many are refused below
        if isinstance(births, PerFrame):
            rand = 2 * rng.uniform(key ^ 0xA5A5A5A5, k, DRAW_TIME) - 1
            begun = np.cumsum(
                np.maximum(0.0, _value(births.mean, starts) + births.variance * rand) * (lengths / length)
            )
        else:
            begun = _integral(births.rate, starts + lengths) - _integral(births.rate, np.array(start))
    _check(emitter, "births", "particles", float(np.max(begun, initial=0.0)), 2**31)
    return starts, lengths, np.diff(np.floor(begun + 1e-9).astype(np.int64), prepend=0)


def _check(emitter: Emitter, what: str, unit: str, needed: float, most: int) -> None:
    if not needed <= most:
        raise InputError(
            f"emitter '{emitter.name}': its {what} make {needed:.3g} {unit}, at most {most} can be numbered"
        )


def _value(keys: Sequence[tuple[float, float]], t: np.ndarray) -> np.ndarray:
    times, values = zip(*keys, strict=True)
    return np.interp(t, times, values)


def _integral(keys: Sequence[tuple[float, float]], t: np.ndarray) -> np.ndarray:
    """Return the integral of a keyed rate from its first key to `t`, exactly: trapezia between the keys."""
    times, values = (np.array(column) for column in zip(*keys, strict=True))
    to_key = np.concatenate([[0.0], np.cumsum(np.diff(times) * (values[1:] + values[:-1]) / 2)])
    k = np.maximum(np.searchsorted(times, t, side="right") - 1, 0)
    return to_key[k] + (t - times[k]) * (values[k] + _value(keys, t)) / 2
