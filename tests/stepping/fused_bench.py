"""Particles under a fused stepper, without a scene around them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tparticles import schemes
from tparticles.schemes import Scheme
from tparticles.stepping.fused import FusedStepper, StepReport
from tparticles.systems.attributes import Columns

DORMAND_PRINCE = schemes.runge_kutta(
    [
        [],
        [1 / 5],
        [3 / 40, 9 / 40],
        [44 / 45, -56 / 15, 32 / 9],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ],
    [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84, 0],
    name="dormand-prince",
    order=5,
)
HEUN = schemes.runge_kutta([[], [1]], [1 / 2, 1 / 2], name="heun")
KUTTA3 = schemes.runge_kutta([[], [1 / 2], [-1, 2]], [1 / 6, 2 / 3, 1 / 6], name="kutta-rk3")
SCHEMES = (*schemes.CATALOGUE.values(), HEUN, KUTTA3, DORMAND_PRINCE)


class Particles:
    """Columns for `count` particles, and steppers that share them (so that one kernel serves all schemes of one length)."""

    def __init__(self, system: Any, count: int, *, names: Sequence[str] = (), cooling: Any = None):
        self.system, self.count, self.cooling = system, count, cooling
        self.columns = Columns(("x", "id", "birth", *system.state, *names), count)
        self._steppers: dict[Any, FusedStepper] = {}

    def set(self, name: str, values: Any) -> None:
        """Fill an attribute of all slots; scalars and rows are repeated."""
        fields = self.columns[name]
        rows = np.broadcast_to(np.asarray(values, float).reshape(-1, len(fields)), (self.count, len(fields)))
        for d, field in enumerate(fields):
            padded = np.zeros(self.columns.padded)
            padded[: self.count] = rows[:, d]
            field.from_numpy(padded.astype(field.to_numpy().dtype))

    def get(self, name: str) -> np.ndarray:
        """Return an attribute, shape (count,) or (count, 3)."""
        parts = [field.to_numpy()[: self.count] for field in self.columns[name]]
        return parts[0] if len(parts) == 1 else np.stack(parts, axis=1)

    def stepper(self, scheme: str | Scheme, *, clamp: str = "equal", lanes: int | None = None) -> FusedStepper:
        """Return the stepper of a scheme, made once."""
        found = schemes.get(scheme)
        key = found.name, clamp, lanes
        if key not in self._steppers:
            self._steppers[key] = FusedStepper(
                self.system,
                cooling=self.cooling,
                scheme=found,
                clamp=clamp,
                columns=self.columns,
                size=1e-3,
                lanes=lanes,
            )
        return self._steppers[key]

    def run(
        self, scheme: str | Scheme, t0: float, t1: float, dt: float, *, clamp: str = "equal", lanes: int | None = None
    ) -> StepReport:
        """Advance all particles once, as in one frame."""
        return self.stepper(scheme, clamp=clamp, lanes=lanes).advance(self.count, t0, t1, dt)
