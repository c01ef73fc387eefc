"""Emitters: how many particles are born, when, and with which attributes.

The births are a function of the emitter and the seed alone. Counts are drawn per interval of the emitter's own clock and times
inside an interval are stratified, so ids, times and attributes are the same for any frame rate, sub-step or scheme.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator

from .. import rng
from ..errors import InputError
from ..spec import Finite, NonNegative, Positive, spec
from .shapes import Cone, Point, Shape
from .spread import Spread, SpreadLike, positive

# Draws of one particle; each attribute has its own, so adding one never changes another.
DRAW_TIME, DRAW_POSITION, DRAW_VELOCITY, DRAW_TEMPERATURE, DRAW_SIZE, DRAW_LIFETIME = 0, 1, 4, 8, 10, 12

_MOST_INTERVALS = 50_000_000


def _to_keys(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return ((0.0, value),)
    return value


# A rate that changes with time: one number, or (time [s], value) pairs, linear in between and constant outside.
Keyed = Annotated[tuple[tuple[Finite, NonNegative], ...], BeforeValidator(_to_keys)]


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

    count: Annotated[int, BeforeValidator(lambda n: int(n) if isinstance(n, float) and n.is_integer() else n)]
    time: Finite = 0.0

    def __post_init__(self) -> None:
        if self.count < 1:
            raise InputError(f"Burst.count = {self.count}: at least 1 particle is needed")


@spec
class Emitter:
    """A source of particles.

    `births`: a `PerFrame`, `Rate` or `Burst`, or a tuple of `Burst`s. Active from `start` to `stop` [s] (the film's end by default);
    `preroll` [s] lets it run that long before the film begins, so that the first frame is not empty.
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
        for name in ("mean", "rate"):
            keys = getattr(self.births, name, ((0.0, 1.0),))
            if any(b[0] <= a[0] for a, b in zip(keys, keys[1:], strict=False)):
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


@dataclass(frozen=True)
class Births:
    """Particles born in one span of time: consecutive ids from `first`, birth times [s] in rising order, float64."""

    first: int
    times: np.ndarray


class Schedule:
    """All births of one emitter up to the end of a film: intervals with a start, a length and a count each.

    Births of an interval lie at start + length (j + u_j) / count, u_j the particle's own draw: stratified, so they rise.
    """

    def __init__(self, emitter: Emitter, *, key: int, end: float):
        stop = min(end, emitter.stop if emitter.stop is not None else end)
        self.key = key
        self.starts, self.lengths, counts = _intervals(emitter.births, key, emitter.first_time, stop)
        self.counts = counts
        self.ends = np.cumsum(counts)
        self.total = int(self.ends[-1]) if len(counts) else 0

    def births(self, t0: float, t1: float) -> Births:
        """Return who is born in [t0, t1)."""
        # An interval may reach into the span from before it; its births rise with their id.
        low = int(np.searchsorted(self.starts + self.lengths, t0, side="left"))
        high = int(np.searchsorted(self.starts, t1, side="left"))
        first = int(self.ends[low] - self.counts[low]) if low < len(self.ends) else self.total
        counts = self.counts[low:high]
        if not counts.sum():
            return Births(first, np.empty(0))
        which = np.repeat(np.arange(len(counts)), counts)
        ids = first + np.arange(len(which))
        j = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        u = rng.uniform(self.key, ids, DRAW_TIME)
        times = self.starts[low:high][which] + self.lengths[low:high][which] * ((j + u) / counts[which])
        a, b = np.searchsorted(times, [t0, t1], side="left")
        return Births(first + int(a), times[a:b])

    def most_alive(self, lifetime: float, frame: float) -> int:
        """Return a bound on how many live at once, if each lives at most `lifetime` [s] and deaths wait for a frame [s]."""
        if not math.isfinite(lifetime):
            return self.total
        # births whose interval begins in (t - lifetime - frame, t], counted at the end of every interval
        begun = np.searchsorted(self.starts + self.lengths, self.starts - (lifetime + 2 * frame), side="left")
        before = np.concatenate([[0], self.ends])[begun]
        return int(np.max(self.ends - before, initial=0))


def _intervals(births: Any, key: int, start: float, stop: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return starts [s], lengths [s] and counts of the intervals of [start, stop)."""
    if isinstance(births, Burst | tuple):
        bursts = sorted(births if isinstance(births, tuple) else (births,), key=lambda b: b.time)
        bursts = [b for b in bursts if start <= b.time < stop]
        return (
            np.array([b.time for b in bursts], float),
            np.zeros(len(bursts)),
            np.array([b.count for b in bursts], np.int64),
        )
    length = births.frame if isinstance(births, PerFrame) else 1 / 24
    count = max(0, math.ceil((stop - start) / length - 1e-9))
    if count > _MOST_INTERVALS:
        raise InputError(f"births in intervals of {length:g} s over {stop - start:g} s: that is {count} intervals")
    k = np.arange(count)
    starts = start + k * length
    lengths = np.minimum(length, stop - starts)
    if isinstance(births, PerFrame):
        wanted = _value(births.mean, starts) + births.variance * (2 * rng.uniform(key ^ 0xA5A5A5A5, k, DRAW_TIME) - 1)
    else:
        wanted = _value(births.rate, starts + 0.5 * lengths) * length
    whole = np.floor(np.cumsum(np.maximum(0.0, wanted) * (lengths / length)) + 1e-9).astype(np.int64)
    return starts, lengths, np.diff(whole, prepend=0)


def _value(keys: Sequence[tuple[float, float]], t: np.ndarray) -> np.ndarray:
    times, values = zip(*keys, strict=True)
    return np.interp(t, times, values)
