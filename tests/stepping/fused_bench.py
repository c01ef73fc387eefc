"""Particles under a fused stepper, without a scene around them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tparticles import schemes
from tparticles.schemes import Scheme
from tparticles.stepping.control import Tolerance
from tparticles.stepping.fused import FusedStepper
from tparticles.stepping.report import StepReport
from tparticles.systems.attributes import Attribute, Columns

SCHEMES = tuple(schemes.CATALOGUE.values())
ONE_STEP = tuple(scheme for scheme in SCHEMES if scheme.one_step and 1 in scheme.system_orders and not scheme.implicit)


class Particles:
    """Columns for `count` particles, and steppers that share them (so that one kernel serves all schemes of one length)."""

    def __init__(self, system: Any, count: int, *, names: Sequence[str] = (), cooling: Any = None):
        self.system, self.count, self.cooling = system, count, cooling
        width = max(len(scheme.carried) for scheme in SCHEMES) * 7 + 2
        more = (Attribute("history", width, "real", "", ""), Attribute("dt", 1, "real", "s", ""))
        self.columns = Columns(("x", "id", "birth", *system.state, *names), count, more=more)
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

    def stepper(
        self,
        scheme: str | Scheme,
        *,
        clamp: str = "equal",
        lanes: int | None = None,
        tolerance: Tolerance | None = None,
    ) -> FusedStepper:
        """Return the stepper of a scheme, made once; under a tolerance, of one that estimates its error."""
        found = schemes.get(scheme) if tolerance is None else schemes.doubled(schemes.get(scheme))
        key = found.name, clamp, lanes, type(tolerance)
        if key not in self._steppers:
            self._steppers[key] = FusedStepper(
                self.system,
                cooling=self.cooling,
                scheme=found,
                clamp=clamp,
                columns=self.columns,
                size=1e-3,
                tolerance=tolerance,
                lanes=lanes,
            )
        stepper = self._steppers[key]
        stepper.tolerance = tolerance  # its numbers are data
        return stepper

    def run(
        self,
        scheme: str | Scheme,
        t0: float,
        t1: float,
        dt: float,
        *,
        clamp: str = "equal",
        lanes: int | None = None,
        tolerance: Tolerance | None = None,
        camera: np.ndarray | None = None,
    ) -> StepReport:
        """Advance all particles once, as in one frame."""
        stepper = self.stepper(scheme, clamp=clamp, lanes=lanes, tolerance=tolerance)
        return stepper.advance(self.count, t0, t1, dt, camera=camera)
