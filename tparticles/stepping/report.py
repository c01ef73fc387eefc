"""What a stepper says of its work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..schemes import Scheme


@dataclass(frozen=True)
class Solves:
    """What the implicit stages of a mesh took: the solver of the last one and why it was taken, iterations of Newton's method and
    of conjugate gradients, and the largest misfit left, as a part of the mean rest length."""

    method: str
    why: str
    newton: int
    linear: int
    residual: float


@dataclass(frozen=True)
class StepReport:
    """What one advance took: sub-steps over all particles, tries that were rejected, smallest and largest dt [s] (0: no step).

    `starting`: how many of the steps of particles were made by the starter of a multistep scheme; of one that starts itself, how
    many starts took a slope. `solves`: of a mesh with implicit
    stages.
    """

    steps: int = 0
    rejected: int = 0
    dt_min: float = 0.0
    dt_max: float = 0.0
    starting: int = 0
    solves: Solves | None = None

    @classmethod
    def of_bits(cls, steps: int, starting: int, rejected: int, low: int, high: int) -> StepReport:
        """Return what a kernel has counted; `low` and `high` are the bits of the smallest and the largest dt as f32."""
        if not steps:
            return cls(rejected=rejected)
        dt_min, dt_max = (float(dt) for dt in np.array([low, high], np.int32).view(np.float32))
        return cls(steps, rejected, dt_min, dt_max, starting)

    def evaluations(self, scheme: Scheme) -> int:
        """Return how often `scheme` has looked at the law for this, rejected tries and its starter's steps included."""
        if scheme.starts_itself:
            return (self.steps + self.rejected) * scheme.evaluations + self.starting
        own = (self.steps + self.rejected - self.starting) * scheme.evaluations
        return own + self.starting * (scheme.starter.evaluations if scheme.starter else 0)
