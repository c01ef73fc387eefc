"""Which step to take: controllers propose one, the frame clamp fits it so that the last one ends on the frame.

The clamp is one `@ti.pyfunc`, the same on the host and in kernels, wrapped around whatever the controller proposes.
"""

import math
from typing import Annotated, Literal

import taichi as ti
from pydantic import Field

from ..errors import InputError
from ..physics.law import Bound
from ..schemes import Scheme
from ..spec import Positive, spec

Clamp = Literal["equal", "slide32"]
_MOST_STEPS = 1_000_000  # per frame


@ti.pyfunc
def equal(left: float, dt: float) -> float:
    """Return the next of the fewest equal steps <= dt that end exactly after `left` [s]: left / ceil(left / dt).

    Rounding of a tie (dt divides `left`) must not cost a step: a step may exceed dt by 1e-4 of it.
    """
    return left / ti.max(ti.ceil(left / dt - 1e-4), 1.0)


@ti.pyfunc
def slide32(left: float, dt: float) -> float:
    """Return the lecture's next step (slide 32): what is left if dt reaches it, half of it if 1.5 dt does, else dt."""
    h = dt
    if dt >= left * (1.0 - 1e-6):
        h = left
    elif 1.5 * dt >= left * (1.0 - 1e-6):
        h = 0.5 * left
    return h


CLAMPS = {"equal": equal, "slide32": slide32}


@spec
class Fixed:
    """The same step `dt` [s] for every particle, clamped to the frame."""

    dt: Positive

    def step(self, scheme: Scheme, bound: Bound | None) -> float:
        """Return dt [s]."""
        return self.dt


@spec
class StabilityLimit:
    """The largest stable step times a fudge factor (slide 30): dt = safety * scheme limit / bound on the Jacobian.

    The scheme's limit on the real axis is held against the damping, its limit on the imaginary axis against the rotation.
    """

    safety: Annotated[float, Field(gt=0, le=1)] = 0.9

    def step(self, scheme: Scheme, bound: Bound | None) -> float:
        """Return dt [s]; infinite where nothing limits it.

        Raises:
            InputError: the scheme has no stable step on an axis that the laws use.
        """
        assert bound is not None
        dt = math.inf
        for axis, limit, rate in (
            ("real", scheme.real_limit, bound.real),
            ("imaginary", scheme.imaginary_limit, bound.imaginary),
        ):
            if rate > 0 and limit == 0:
                raise InputError(
                    f"scheme '{scheme.name}' has no stable step on the {axis} axis, where the laws have rates up to "
                    f"{rate:.3g} /s: take another scheme (rk4) or step with Fixed(dt)"
                )
            if rate > 0:
                dt = min(dt, limit / rate)
        return self.safety * dt


Controller = Fixed | StabilityLimit


def frame_step(controller: Controller, *, scheme: Scheme, bound: Bound | None, frame: float) -> float:
    """Return the step [s] to hand to the kernel for frames of `frame` seconds.

    Raises:
        InputError: so small that a frame would need more than a million steps.
    """
    dt = min(controller.step(scheme, bound), frame)
    if frame / dt > _MOST_STEPS:
        raise InputError(
            f"steps of {dt:.3g} s: a frame of {frame:.4g} s would take {frame / dt:.3g} of them (at most {_MOST_STEPS})"
        )
    return dt
