"""The living particles of one group: births into free slots, deaths, and stable compaction.

Slots never depend on thread order: newborns are appended in the order of their ids, survivors keep their order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import rng
from ..errors import InputError, RunError
from ..physics.emitters import Births, Emitter, Schedule
from .attributes import Columns
from .kernels import Compaction, EmitKernel
from .transfer import Transfer


@dataclass(frozen=True)
class Share:
    """The part of the particles that one shard of `count` simulates: every `count`-th id of each emitter.

    Ids follow the births, so that whoever lives at a moment is dealt out evenly, whatever the emitters do; emitters begin with
    different shards, so that many small ones are dealt out, too. A particle does not depend on its neighbours: it has the same
    bits in any shard.
    """

    index: int = 0  # from 0
    count: int = 1

    def of(self, births: Births, emitter: int) -> tuple[int, int]:
        """Return the first own id and the number of those `births` of emitter number `emitter` that are of this share."""
        first = births.first + (self.index - births.first - emitter) % self.count
        return first, max(0, -(-(births.first + births.count - first) // self.count))

    def room(self, capacity: int, emitters: int) -> int:
        """Return the room that this share takes of a group whose ids of every moment are consecutive."""
        return capacity if self.count == 1 else min(capacity, -(-capacity // self.count) + emitters)


WHOLE = Share()


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
        share: which of them are simulated here.
        enough: returns a capacity that will do, asked where the one there is does not.
    """

    def __init__(
        self,
        name: str,
        emitters: tuple[Emitter, ...],
        *,
        columns: Columns,
        schedules: Sequence[Schedule],
        share: Share = WHOLE,
        enough: Callable[[], int] | None = None,
    ):
        self.name, self.columns, self.share, self._enough = name, columns, share, enough
        self.born = self.died = self.alive = 0
        self._sources = [
            _Source(e, schedule, EmitKernel(e, columns, key=schedule.key, index=i, of=len(emitters)))
            for i, (e, schedule) in enumerate(zip(emitters, schedules, strict=True))
        ]
        self._transfer: Transfer | None = None

    def emit(self, t0: float, t1: float) -> int:
        """Append everybody born in [t0, t1) [s]; return how many.

        Raises:
            RunError: more than the capacity; the message names the emitter and a capacity that will do.
        """
        before = self.alive
        for i, source in enumerate(self._sources):
            births = source.schedule.births(t0, t1)
            first, count = self.share.of(births, i)
            if self.alive + count > self.columns.capacity:
                raised = f" to {self._enough()}" if self._enough else ""
                raise RunError(
                    f"group '{self.name}', emitter '{source.emitter.name}': {count} births at t = {t0:.4g} s need room for "
                    f"{self.alive + count} particles, the capacity is {self.columns.capacity}; raise Group.capacity{raised} or "
                    "leave it out to have it derived from the emitters"
                )
            if count:
                source.kernel.emit(self.alive, births, first, count, self.share.count)
                self.alive += count
        self.born += self.alive - before
        return self.alive - before

    def bury(self, compaction: Compaction | None, died: int) -> int:
        """Remove the `died` particles that are marked (see `Mortality`); the others keep their order.

        `compaction` is of the columns, or of the whole that they are a part of; None if nobody can die.

        Raises:
            RunError: alive is no longer born - died.
        """
        self.died += died
        if died:
            assert compaction
            self.alive = compaction.run(self.alive, self.columns.first)
        self._check()
        return died

    def snapshot(self) -> dict[str, np.ndarray | int | float]:
        """Return all that the future of the group depends on: the counters, and every attribute of the living."""
        self._transfer = self._transfer or Transfer(self.columns)
        return {"born": self.born, "died": self.died, **self._transfer.read(self.alive)}

    def restore(self, state: Mapping[str, np.ndarray | int | float]) -> None:
        """Go on from a `snapshot`.

        Raises:
            RunError: it is of another group.
        """
        self._transfer = self._transfer or Transfer(self.columns)
        arrays = {name: value for name, value in state.items() if isinstance(value, np.ndarray)}
        self.alive = self._transfer.write(arrays)
        self.born, self.died = int(state["born"]), int(state["died"])
        self._check()

    def _check(self) -> None:
        if self.alive != self.born - self.died:
            raise RunError(f"group '{self.name}': {self.alive} alive, but {self.born} born and {self.died} died")

    def read(self, name: str) -> np.ndarray:
        """Return an attribute of the living as an array, shape (alive,) or (alive, components)."""
        living = slice(self.columns.first, self.columns.first + self.alive)
        parts = [field.to_numpy()[living] for field in self.columns[name]]
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
