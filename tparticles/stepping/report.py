"""What a stepper says of its work."""

from dataclasses import dataclass


@dataclass(frozen=True)
class StepReport:
    """What one advance took: sub-steps over all particles, tries that were rejected, smallest and largest dt [s] (0: no step)."""

    steps: int = 0
    rejected: int = 0
    dt_min: float = 0.0
    dt_max: float = 0.0
