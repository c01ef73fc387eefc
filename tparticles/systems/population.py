"""The living particles of one group: births into free slots, deaths, and stable compaction.

Slots never depend on thread order: newborns are appended in the order of their ids, survivors keep their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import rng
from ..errors import InputError, RunError
from ..physics.emitters import Emitter, Schedule
from .attributes import Columns
from .kernels import Compaction, EmitKernel


@dataclass
class _Source:
    """One emitter at work."""

    emitter: Emitter
    schedule: Schedule
    kernel: EmitKernel


class Population:
    """Who is alive in a group.

    Arguments:
        name: of the group, for messages and random streams.
        emitters: where particles come from; ids of emitter e are e, e + E, e + 2E, ... (E emitters).
        columns: the attributes, allocated.
        schedules: their births, one each (see `schedules`).
    """

    def __init__(self, name: str, emitters: tuple[Emitter, ...], *, columns: Columns, schedules: Sequence[Schedule]):
        self.name, self.columns = name, columns
        self.born = self.died = self.alive = 0
        self._sources = [
            _Source(e, schedule, EmitKernel(e, columns, key=schedule.key, index=i, of=len(emitters)))
            for i, (e, schedule) in enumerate(zip(emitters, schedules, strict=True))
        ]
        self._compaction: Compaction | None = None

    def emit(self, t0: float, t1: float) -> int:
        """Append everybody born in [t0, t1) [s]; return how many.

        Raises:
            RunError: more than the capacity; the message names the emitter and the capacity needed.
        """
        before = self.alive
        for source in self._sources:
            births = source.schedule.births(t0, t1)
            count = births.count
            if self.alive + count > self.columns.capacity:
                raise RunError(
                    f"group '{self.name}', emitter '{source.emitter.name}': {count} births at t = {t0:.4g} s need room for "
                    f"{self.alive + count} particles, the capacity is {self.columns.capacity}; raise Group.capacity or "
                    "leave it out to have it derived from the emitters"
                )
            if count:
                source.kernel.emit(self.alive, births)
                self.alive += count
        self.born += self.alive - before
        return self.alive - before

    def bury(self, dead: Any, died: int) -> int:
        """Remove the `died` particles that are marked in the field `dead` (see `Mortality`); the others keep their order.

        Raises:
            RunError: alive is no longer born - died.
        """
        self.died += died
        if died:
            if self._compaction is None:
                self._compaction = Compaction(self.columns, dead)
            self.alive = self._compaction.run(self.alive)
        if self.alive != self.born - self.died:
            raise RunError(f"group '{self.name}': {self.alive} alive, but {self.born} born and {self.died} died")
        return died

    def read(self, name: str) -> np.ndarray:
        """Return an attribute of the living as an array, shape (alive,) or (alive, components)."""
        parts = [field.to_numpy()[: self.alive] for field in self.columns[name]]
        return parts[0] if len(parts) == 1 else np.stack(parts, axis=1)


def schedules(name: str, emitters: tuple[Emitter, ...], *, seed: int, end: float) -> list[Schedule]:
    """Return the births of every emitter of the group `name` up to `end` [s]; each has its own random stream."""
    names = [e.name for e in emitters]
    for twin in {n for n in names if names.count(n) > 1}:
        raise InputError(f"group '{name}' has two emitters named '{twin}': a name keys the random numbers")
    # "a/b" with "c" and "a" with "b/c" are two streams
    found = [Schedule(e, key=rng.stream_key(seed, f"{name.replace('/', '//')}/{e.name}"), end=end) for e in emitters]
    for emitter, schedule in zip(emitters, found, strict=True):
        if not schedule.total:
            raise InputError(
                f"group '{name}', emitter '{emitter.name}' has nothing to emit: no birth before the film ends at {end:g} s"
            )
        if schedule.total * len(emitters) >= 2**31:
            raise InputError(
                f"group '{name}', emitter '{emitter.name}': {schedule.total} births leave no ids (32 bits); "
                "give a lower rate, a shorter film, or several groups"
            )
    return found
