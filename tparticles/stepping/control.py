"""Which step to take: controllers propose one, the frame clamp fits it so that the last one ends on the frame.

The clamp is one `@ti.pyfunc`, the same on the host and in kernels, wrapped around whatever the controller proposes.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false

import dataclasses
import math
from typing import Annotated, Literal, Protocol

import numpy as np
import taichi as ti
from pydantic import Field

from ..errors import InputError
from ..physics.law import Bound
from ..schemes import Scheme, doubled
from ..spec import Positive, spec

Clamp = Literal["equal", "slide32", "dyadic", "slide32-anyway"]
_MOST_STEPS = 1_000_000  # per frame
_LEAST, _MOST = 4.0, 1000.0  # by what the errors of a life grow
_USUAL = 64.0  # where nobody knows how fast a flow pulls neighbours apart
_PULLS = 60.0  # that rate times a life, in which they grow by e
CALM = 1e-3  # of what is allowed: an error that is no luck


@ti.pyfunc
def equal(left: float, dt: float, frame: float) -> float:
    """Return the next of the fewest equal steps <= dt that end exactly after `left` [s]: left / ceil(left / dt).

    Rounding of a tie (dt divides `left`) must not cost a step: a step may exceed dt by 1e-4 of it.
    """
    return left / ti.max(ti.ceil(left / dt - 1e-4), 1.0)


@ti.pyfunc
def slide32(left: float, dt: float, frame: float) -> float:
    """Return the lecture's next step (slide 32): what is left if dt reaches it, half of it if 1.5 dt does, else dt."""
    h = dt
    if dt >= left * (1.0 - 1e-6):
        h = left
    elif 1.5 * dt >= left * (1.0 - 1e-6):
        h = 0.5 * left
    return h


@ti.pyfunc
def dyadic(left: float, dt: float, frame: float) -> float:
    """Return the largest step frame / 2^k <= dt that divides what is left [s], or what leads to the next multiple of it.

    A last bit in dt, of another machine, does not change the step.
    """
    h = frame
    # 1e-4 of slack, as for `equal`; 2^40 steps a frame are more than any clock can tell apart.
    for _ in range(40):
        if h > dt * (1.0 + 1e-4):
            h = 0.5 * h
    # A hundredth of a step is shared out among the others rather than taken alone: rounding leaves such slivers.
    whole = ti.floor(left / h + 0.01)
    over = left - h * whole
    if over > 0.01 * h:
        h = over
    else:
        h = left / whole  # h, but the last step is what is left to the bit
    return h


# Alternating steps can break methods that equal ones do not (Wright's effect): for those the lecture's rule has a name of its own.
CLAMPS = {"equal": equal, "slide32": slide32, "slide32-anyway": slide32, "dyadic": dyadic}


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


@ti.func
def _power(x, p):
    """Return x^p, x > 0, within some per cent: a straight line between powers of two, on the bits; no branch, no library call."""
    bits = ti.bit_cast(ti.cast(x, ti.f32), ti.i32)
    log2 = (ti.cast(bits, ti.f32) - 1065353216.0) * ti.static(2.0**-23)
    scaled = ti.math.clamp(p * log2, -60.0, 60.0) * ti.static(2.0**23) + 1065353216.0
    return ti.cast(ti.bit_cast(ti.cast(scaled, ti.i32), ti.f32), float)


@ti.func
def step_factor(error, before, exponent: ti.template(), most: ti.template()):
    """Return by what to multiply a step whose `error` is known in units of what is allowed; `before` is the last accepted one's.

    Accepted (error <= 1): 0.9 error^(-0.7/k) before^(0.4/k), PI control, k = 1 / `exponent`, up to `most`; rejected:
    0.9 error^(-1/k), at least 0.2.
    Source: Hairer and Wanner, Solving ODEs II, section IV.2, eq. (2.43).
    """
    grown = 0.9 * _power(error, -0.7 * exponent) * _power(before, 0.4 * exponent)
    shrunk = 0.9 * _power(error, -exponent)
    return ti.select(error <= 1.0, ti.math.clamp(grown, 0.2, most), ti.math.clamp(shrunk, 0.2, 0.9))


class Tolerance(Protocol):
    """What a step's error is held against; the particles choose their own steps.

    `error(target, e, z0, z, h, frame)`, a `@ti.func`: the estimate `e` of a step `h` [s] from `z0` to `z` (x, v, T, as far as
    they are part of the state) in units of what is allowed, `target` being `numbers(frame, camera)`, float32.
    `first`: the first step of a particle, in the longest one allowed; `most`: by what a step may grow over the one before;
    `trusted`: the longest step that need not be preceded by an error below `CALM`, in the longest one allowed.
    """

    first: float
    most: float
    trusted: float

    def numbers(self, frame: float, camera: np.ndarray | None) -> np.ndarray: ...  # noqa: D102
    def error(self, target, e, z0, z, h, frame): ...  # noqa: D102


@spec
class ErrorControl:
    """Every particle takes the largest steps whose local error stays below atol + rtol |x|, and so for v and T.

    PI control on the scheme's embedded pair, on what its corrector adds, or on step doubling where it has neither.
    """

    rtol: Annotated[Positive, Field(lt=1)] = 1e-4
    atol: Positive = 1e-6

    first = 1.0
    most = 5.0
    trusted = 1.0

    def step(self, scheme: Scheme, bound: Bound | None) -> float:
        """Return the largest step [s]: no limit but the frame."""
        return math.inf

    def numbers(self, frame: float, camera: np.ndarray | None) -> np.ndarray:
        """Return what kernels need, float32 (2,)."""
        return np.array([self.rtol, self.atol], np.float32)

    @ti.func
    def error(self, target: ti.template(), e, z0, z, h, frame):
        """Return the largest error of x, v, T in units of its tolerance."""
        worst = h * 0.0
        for first, last in ti.static(_parts(e.n)):
            off = size0 = size1 = h * 0.0
            for d in ti.static(range(first, last)):
                off += e[d] * e[d]
                size0 += z0[d] * z0[d]
                size1 += z[d] * z[d]
            worst = ti.max(worst, ti.sqrt(off) / (target[1] + target[0] * ti.sqrt(ti.max(size0, size1))))
        return worst


@spec
class PixelTolerance:
    """Every particle takes the largest steps that keep its dot within `px` pixels of where it should be.

    The local error is held against what it would be on the film of the scene's camera; a step may err by `px` / `growth`. An error
    along the line of sight counts as one across it, and one in v as the way it leads astray within a frame.
    `growth` stands for how much the errors of a life add up, and grow: turbulence pulls neighbours apart, exponentially. Left out,
    it is worked out for each group as 4 exp(B L / 60), at most 1000: B [1/s] bounds how fast its flow can pull neighbours apart
    (the imaginary part of the Jacobian's bound), L [s] is the longest life that a particle can have, and 60 is measured, not
    derived: on the whole they part far slower than the bound, and single ones that pass a stagnation point do not
    (`python -m tests.bench pixels`).
    Estimates of steps across several eddies are a matter of luck: the first step is a quarter of a frame (a 64th, where it is of
    order one), none is more than twice the one before, and one above half a frame follows an error of next to nothing.
    """

    px: Positive = 0.5
    growth: Positive | None = None

    first = 0.25
    most = 2.0
    trusted = 0.5

    def fitted(self, rate: float | None, life: float) -> "PixelTolerance":
        """Return one with a growth for a `life` [s] in a flow that pulls apart at `rate` [1/s], None where nobody knows it."""
        if self.growth is not None:
            return self
        growth = _USUAL if rate is None else min(_MOST, _LEAST * math.exp(min(rate * life / _PULLS, 700.0)))
        return dataclasses.replace(self, growth=growth)

    def step(self, scheme: Scheme, bound: Bound | None) -> float:
        """Return the largest step [s]: no limit but the frame."""
        return math.inf

    def numbers(self, frame: float, camera: np.ndarray | None) -> np.ndarray:
        """Return what kernels need, float32 (16,): pixels allowed in a step, and the camera row (see `render.project`)."""
        assert camera is not None
        return np.concatenate([[self.px / (self.growth or _USUAL)], camera]).astype(np.float32)

    @ti.func
    def error(self, target: ti.template(), e, z0, z, h, frame):
        """Return the error on the film in units of what a step may err by."""
        off = ti.Vector([e[0], e[1], e[2]])
        if ti.static(e.n >= 6):
            off += frame * ti.Vector([e[3], e[4], e[5]])
        x = ti.Vector([z[0] - target[1], z[1] - target[2], z[2] - target[3]])
        forward = ti.Vector([target[10], target[11], target[12]])
        # Beside and behind the camera as at the edge of a very wide lens: who is there may come into view.
        depth = ti.max(x.dot(forward), 0.25 * x.norm() + 1e-3)
        # An error along the line of sight counts as one across it: what it leads astray is seen later.
        return target[13] / depth * off.norm() / target[0]


def _parts(components: int) -> list[tuple[int, int]]:
    """Return where x, v and T stand in a state of so many components."""
    return {3: [(0, 3)], 4: [(0, 3), (3, 4)], 6: [(0, 3), (3, 6)], 7: [(0, 3), (3, 6), (6, 7)]}[components]


Controller = Fixed | StabilityLimit | ErrorControl | PixelTolerance


def check_fit(controller: Controller, clamp: str, scheme: Scheme) -> None:
    """Refuse a controller or a clamp that a scheme cannot run under.

    Raises:
        InputError: no estimate of the scheme's error, or steps of two sizes under a scheme that they may destroy.
    """
    if isinstance(controller, ErrorControl | PixelTolerance):
        doubled(scheme)
    elif scheme.starts_itself:
        raise InputError(
            f"scheme '{scheme.name}' has no starter, and starts itself only where its error is held against a tolerance: step "
            "with ErrorControl(rtol, atol) or PixelTolerance(px)"
        )
    if clamp == "slide32" and (not scheme.one_step or scheme.system_orders == {2}):
        kind = "multistep scheme" if not scheme.one_step else "splitting"
        raise InputError(
            f"clamp 'slide32' ends a frame with steps of another size, which can make a {kind} such as '{scheme.name}' "
            "unstable though each step is stable alone (Wright's effect): use 'equal', or 'slide32-anyway' to see it"
        )


def check_precision(controller: Controller, precision: str) -> None:
    """Refuse a tolerance that rounding does not let anybody reach.

    Raises:
        InputError: naming the least that can be asked for.
    """
    f64 = precision == "f64"
    least, name = None, ""
    if isinstance(controller, ErrorControl):
        least, name = (1e-14 if f64 else 2e-6), "rtol"
    elif isinstance(controller, PixelTolerance):
        least, name = (1e-9 if f64 else 1e-2), "px"
    if least is not None and getattr(controller, name) < least:
        more = "" if f64 else "; --precision f64 reaches further"
        what = f"{type(controller).__name__}.{name} = {getattr(controller, name):g}"
        raise InputError(f"{what}: rounding in {precision} allows at least {least:g}{more}")


def equal_steps(dt: float, frame: float) -> float:
    """Return the step [s] of a whole frame in equal steps <= `dt`, as the kernels cut it."""
    return frame / math.ceil(frame / dt - 1e-4)


def frame_step(
    controller: Controller, *, scheme: Scheme, bound: Bound | None, frame: float, damping: float = 0.0
) -> float:
    """Return the step [s] to hand to the kernel for frames of `frame` seconds; `damping` is a rate that certainly occurs [1/s].

    Raises:
        InputError: so small that a frame would need more than a million steps, or fixed and certainly unstable.
    """
    dt = min(controller.step(scheme, bound), frame)
    taken = equal_steps(dt, frame)
    if isinstance(controller, Fixed) and damping * taken > scheme.real_limit * (1 + 1e-6):
        raise InputError(
            f"steps of {taken:.3g} s are unstable: velocities relax at {damping:.3g} /s, and '{scheme.name}' needs dt < "
            f"{scheme.real_limit / damping:.3g} s; use StabilityLimit(), or an implicit scheme (tr-bdf2, backward-euler)"
        )
    if frame / dt > _MOST_STEPS:
        raise InputError(
            f"steps of {dt:.3g} s: a frame of {frame:.4g} s would take {frame / dt:.3g} of them (at most {_MOST_STEPS})"
        )
    return dt
