"""A finished frame, and what it took."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .stepping.report import StepReport


@dataclass
class FrameReport:
    """What one frame took. `ms`: milliseconds in births, step, draw; dt in seconds; `starting`: see `StepReport`.

    `solves`: by group, what the implicit stages of meshes took in the last frame that was simulated for this one.
    """

    frame: int
    time: float
    born: int = 0
    died: int = 0
    alive: int = 0
    steps: int = 0
    rejected: int = 0
    starting: int = 0
    dt_min: float = 0.0
    dt_max: float = 0.0
    solves: dict[str, dict[str, Any]] = field(default_factory=dict)
    ms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("births", "step", "draw"), 0.0))

    def row(self) -> dict[str, Any]:
        """Return the report as a row of run.json."""
        row = dataclasses.asdict(self)
        return row if row["solves"] else {name: value for name, value in row.items() if name != "solves"}

    def add_steps(self, group: str, report: StepReport) -> None:
        """Count in what the stepper of a group did."""
        if report.solves:
            self.solves[group] = dataclasses.asdict(report.solves)
        self.rejected += report.rejected
        if report.steps:
            self.dt_min = min(self.dt_min, report.dt_min) if self.steps else report.dt_min
            self.dt_max = max(self.dt_max, report.dt_max)
            self.steps += report.steps
            self.starting += report.starting


@dataclass
class Frame:
    """A finished frame. `state` and `linear` read the simulation and are valid until the next frame is asked for."""

    number: int
    image: np.ndarray
    report: FrameReport
    _simulation: Any

    def linear(self) -> np.ndarray:
        """Return the film before tone curve and background, film values, float64, shape (h, w, 3)."""
        return self._simulation.film.linear()

    def state(self) -> dict[str, dict[str, np.ndarray]]:
        """Return the living, by group: id, x [m], v [m/s] if the scene has it, T [K], age [s], birth [s]."""
        return {group.spec.name: group.state(self.report.time) for group in self._simulation.groups}
