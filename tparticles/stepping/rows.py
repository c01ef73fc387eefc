"""Rows of a record: what there is to ask for, the memory that they lie in, and who takes them. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

ENERGIES = ("kinetic", "spring", "gravity")  # [J]
EVENT = ("step", "time", "vertex", "x", "y", "z", "vx", "vy", "vz", "wx", "wy", "wz")  # of a contact; v before, w after


@dataclass(frozen=True)
class Request:
    """Which steps and vertices of a mesh to record: every n-th step, and all vertices or those in `ids`, int (m,)."""

    every: int = 1
    ids: np.ndarray | None = None


@dataclass
class Rows:
    """Memory for some rows of a record, and what is in it.

    `state`, (3, rows, 3, m): x [m], v [m/s], a [m/s^2] of the recorded vertices; `energy`, float64 (rows, 3): see `ENERGIES`;
    `step`, `time` [s], `dt` [s] of each row; `events`, float64 (1 + n, 12): contacts, as `EVENT` says, behind their number.
    """

    state: np.ndarray
    energy: np.ndarray
    step: np.ndarray
    time: np.ndarray
    dt: np.ndarray
    events: np.ndarray
    filled: int = 0


class Sink(Protocol):
    """Where rows go."""

    def take(self) -> Rows:
        """Return empty rows; waits until there are some."""
        ...

    def give(self, rows: Rows) -> None:
        """Take filled rows over."""
        ...

    def rewind(self, rows: int, time: float) -> None:
        """Forget all rows but the first ones, and the contacts from `time` [s] on."""
        ...
