"""The states of a film in shards: those of all shards, in the order in which one process has them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from .physics.emitters import Schedule
from .scene import Group, Scene
from .systems.population import schedules

State = dict[str, np.ndarray]
_SECTION = "state "


def sections(states: Mapping[str, State]) -> dict[str, State]:
    """Return states by group as sections of a piece."""
    return {_SECTION + name: state for name, state in states.items()}


def from_sections(found: Mapping[str, Any]) -> dict[str, State]:
    """Return the states that the sections of a piece hold, by group; nothing if it has none."""
    return {name.removeprefix(_SECTION): state for name, state in found.items() if name.startswith(_SECTION)}


class StateMerge:
    """Puts the states of shards together.

    One process has the particles of a group by the frame of their birth, then by emitter, then by id; those of meshes are of the
    first shard alone.
    """

    def __init__(self, scene: Scene):
        self._orders = {group.name: _Order.of(group, scene) for group in scene.particles}
        self._meshes = [group.name for group in scene.meshes]

    def merged(self, parts: Sequence[Mapping[str, State]]) -> dict[str, State]:
        """Return the states of all groups from those that each shard has of them."""
        found: dict[str, State] = {}
        for name, order in self._orders.items():
            state = {key: np.concatenate([part[name][key] for part in parts]) for key in parts[0][name]}
            place = order.place(state["id"])
            found[name] = {key: values[place] for key, values in state.items()}
        return found | {name: parts[0][name] for name in self._meshes}


@dataclass(frozen=True)
class _Order:
    """The births of a group: for each emitter, how many there were before each frame."""

    before: list[np.ndarray]

    @classmethod
    def of(cls, group: Group, scene: Scene) -> _Order:
        births = schedules(group.name, group.emitters, seed=scene.seed, end=scene.duration)
        first = min([0, *(math.floor(schedule.starts[0] * float(scene.fps)) for schedule in births)])
        times = [float(Fraction(frame) / scene.fps) for frame in range(first, scene.frame_count + 1)]
        return cls([_before(schedule, times) for schedule in births])

    def place(self, ids: np.ndarray) -> np.ndarray:
        """Return where the particles `ids` stand, in order; ids of emitter e of E are e, e + E, ..."""
        emitter, number = ids % len(self.before), ids // len(self.before)
        frame = np.empty(len(ids), np.int64)
        for e, before in enumerate(self.before):
            own = emitter == e
            frame[own] = np.searchsorted(before, number[own], side="right")
        return np.lexsort((number, emitter, frame))


def _before(schedule: Schedule, times: Sequence[float]) -> np.ndarray:
    return np.array([schedule.births(t, t).first for t in times])
