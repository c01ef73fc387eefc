"""Test problems: laws that the engine runs, with the same right-hand side for NumPy and their exact solutions.

States are arrays of shape (3, n) or (6, n): x, and v after it for second-order problems; n is the number of particles. All
are without units. Each problem solves from any initial state, so that an ensemble measures more than one path.
"""

# Kernel signatures are Taichi's, and vectors of a law have no Python type inside kernels.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar, Protocol

import numpy as np
import taichi as ti

from .. import schemes
from ..errors import RunError
from ..physics.flows import ABC
from ..systems.motion import Advected, Newtonian, System


class Problem(Protocol):
    """A law that knows its own equation; `velocity_free` (of forces): whether the acceleration does without v."""

    name: ClassVar[str]
    order: ClassVar[int]
    velocity_free: ClassVar[bool]

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt, of the shape of z."""
        ...

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """Return the state at time t of what starts from z0 at time 0."""
        ...

    def start(self, count: int) -> np.ndarray:
        """Return `count` initial states, always the same ones, shape (3, count) or (6, count)."""
        ...


def system(problem: Problem) -> System:
    """Return the system that the engine runs."""
    return Advected(flow=problem) if problem.order == 1 else Newtonian(forces=(problem,))


def spread(count: int, low: Any, high: Any) -> np.ndarray:
    """Return points that fill a box evenly, shape (len(low), count): Roberts' additive recurrence, the same every time."""
    low, high = (np.asarray(edge, float)[:, None] for edge in (low, high))
    golden = 1.0
    for _ in range(60):  # the root of g^(d+1) = g + 1
        golden = (1 + golden) ** (1 / (len(low) + 1))
    steps = golden ** -np.arange(1, len(low) + 1)
    return low + (high - low) * ((0.5 + np.outer(steps, np.arange(count))) % 1)


@dataclasses.dataclass(frozen=True)
class Spiral:
    """Stuart and Landau's flow onto a circle, which turns with a speed that depends on radius and time; z' = z cos t.

    In polar form r' = pull r (1 - r^2), phi' = turn + shear r^2 + cos t.
    """

    turn: float = 2.0
    shear: float = 0.2
    pull: float = 0.2

    name: ClassVar[str] = "spiral"
    order: ClassVar[int] = 1
    velocity_free: ClassVar[bool] = True

    @ti.func
    def velocity(self, t, x):
        """Return dx/dt."""
        r2 = x[0] * x[0] + x[1] * x[1]
        s = self.turn + self.shear * r2 + ti.cos(t)
        g = self.pull * (1.0 - r2)
        return ti.Vector([x[0] * g - x[1] * s, x[1] * g + x[0] * s, x[2] * ti.cos(t)])

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        x, y, h = z
        r2 = x * x + y * y
        s = self.turn + self.shear * r2 + math.cos(t)
        g = self.pull * (1 - r2)
        return np.stack([x * g - y * s, y * g + x * s, h * math.cos(t)])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """r^2 = 1 / (1 + c / e), e = e^(2 pull t); phi = phi0 + turn t + shear ln((e + c) / (1 + c)) / (2 pull) + sin t."""
        x, y, h = z0
        c, e = 1 / (x * x + y * y) - 1, math.exp(2 * self.pull * t)
        r = (1 + c / e) ** -0.5
        angle = self.turn * t + self.shear / (2 * self.pull) * np.log((e + c) / (1 + c)) + math.sin(t)
        phi = np.arctan2(y, x) + angle
        return np.stack([r * np.cos(phi), r * np.sin(phi), h * math.exp(math.sin(t))])

    def start(self, count: int) -> np.ndarray:
        """Return states on a ring, inside and outside the circle."""
        r, phi, h = spread(count, (0.6, 0, 0.5), (1.3, 2 * math.pi, 1))
        return np.stack([r * np.cos(phi), r * np.sin(phi), h])


@dataclasses.dataclass(frozen=True)
class Shaken:
    """Pinney's equation seen from a shaken frame: y'' = -omega^2 y + 1 / y^3 with y = x - shake sin t > 0.

    Nonlinear, with time on the right-hand side, without velocity (E. Pinney, Proc. Amer. Math. Soc. 1, 1950).
    """

    omega: float = 1.3
    shake: float = 0.3

    name: ClassVar[str] = "shaken"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = True

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        s = self.shake * ti.sin(t)
        y = x - s
        return 1.0 / (y * y * y) - self.omega * self.omega * y - s

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        s = self.shake * math.sin(t)
        y = z[:3] - s
        return np.concatenate([z[3:], y**-3 - self.omega**2 * y - s])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """y^2 = (y0 cos + w0 / omega sin)^2 + sin^2 / (omega y0)^2, of omega t."""
        w, y0 = self.omega, z0[:3]
        w0 = z0[3:] - self.shake
        c, s = math.cos(w * t), math.sin(w * t)
        p, dp = y0 * c + w0 / w * s, w0 * c - w * y0 * s
        y = np.sqrt(p**2 + (s / (w * y0)) ** 2)
        dy = (p * dp + s * c / (w * y0**2)) / y
        return np.concatenate([y + self.shake * math.sin(t), dy + self.shake * math.cos(t)])

    def start(self, count: int) -> np.ndarray:
        """Return states near the rest at y = omega^-1/2."""
        return spread(count, (0.7,) * 3 + (-0.1,) * 3, (1.2,) * 3 + (0.5,) * 3)


@dataclasses.dataclass(frozen=True)
class Rubbing:
    """A damped, driven oscillator y seen through x = e^y: x'' = x (-omega^2 y - 2 zeta omega y' + drive cos t + y'^2), y' = v / x.

    Nonlinear in position and velocity, with time on the right-hand side.
    """

    omega: float = 1.5
    zeta: float = 0.1
    drive: float = 0.4

    name: ClassVar[str] = "rubbing"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = False

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        w = v / x
        pull = self.omega * self.omega * ti.log(x) + 2.0 * self.zeta * self.omega * w
        return x * (self.drive * ti.cos(t) - pull + w * w)

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        x, w = z[:3], z[3:] / z[:3]
        pull = self.omega**2 * np.log(x) + 2 * self.zeta * self.omega * w
        return np.concatenate([z[3:], x * (self.drive * math.cos(t) - pull + w * w)])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """y = p cos t + q sin t + e^(-zeta omega t) (a cos + b sin) of omega sqrt(1 - zeta^2) t."""
        w, g = self.omega, self.zeta * self.omega
        p, q = self.drive * np.array([w**2 - 1, 2 * g]) / ((w**2 - 1) ** 2 + 4 * g**2)
        wd = math.sqrt(w**2 - g**2)
        a = np.log(z0[:3]) - p
        b = (z0[3:] / z0[:3] - q + g * a) / wd
        c, s, fade = math.cos(wd * t), math.sin(wd * t), math.exp(-g * t)
        y = fade * (a * c + b * s) + p * math.cos(t) + q * math.sin(t)
        dy = fade * (wd * (b * c - a * s) - g * (a * c + b * s)) - p * math.sin(t) + q * math.cos(t)
        return np.concatenate([np.exp(y), np.exp(y) * dy])

    def start(self, count: int) -> np.ndarray:
        """Return states with |y| < 0.5."""
        return spread(count, (0.65,) * 3 + (-0.4,) * 3, (1.6,) * 3 + (0.4,) * 3)


@dataclasses.dataclass(frozen=True)
class ProtheroRobinson:
    """x' = -stiffness (x - phi) + phi', phi = sin(t + i) for component i: a stiff decay onto a slow forcing.

    Source: A. Prothero, A. Robinson, Math. Comp. 28 (1974); Hairer and Wanner II, section IV.15.
    """

    stiffness: float = 1e3

    name: ClassVar[str] = "prothero-robinson"
    order: ClassVar[int] = 1
    velocity_free: ClassVar[bool] = True

    @ti.func
    def velocity(self, t, x):
        """Return dx/dt."""
        at = ti.Vector([t, t + 1.0, t + 2.0])
        return ti.cos(at) - self.stiffness * (x - ti.sin(at))

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        at = t + np.arange(3)[:, None]
        return np.cos(at) - self.stiffness * (z - np.sin(at))

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """x = phi + (x0 - phi(0)) e^(-stiffness t)."""
        i = np.arange(3)[:, None]
        return np.sin(t + i) + (z0 - np.sin(i)) * math.exp(-self.stiffness * t)

    def start(self, count: int) -> np.ndarray:
        """Return states on the slow solution."""
        return np.repeat(np.sin(np.arange(3.0))[:, None], count, axis=1)


@dataclasses.dataclass(frozen=True)
class StiffDrag:
    """Sparks in a gusty wind: v' = (wind cos t - v) / time + g; `time` is the response time, the wind's period 2 pi."""

    time: float = 1e-3
    wind: tuple[float, float, float] = (2.0, 0.0, 0.5)
    g: tuple[float, float, float] = (0.0, 0.0, -9.81)

    name: ClassVar[str] = "stiff-drag"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = False

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        return (self.wind * ti.cos(t) - v) / self.time + self.g

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        wind, g = (np.array(part)[:, None] for part in (self.wind, self.g))
        return np.concatenate([z[3:], (wind * math.cos(t) - z[3:]) / self.time + g])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """v = W (cos t + time sin t) + g time + C e^(-t / time), W = wind / (1 + time^2); x is its integral."""
        tau, g = self.time, np.array(self.g)[:, None]
        W = np.array(self.wind)[:, None] / (1 + tau**2)
        C = z0[3:] - W - g * tau
        v = W * (math.cos(t) + tau * math.sin(t)) + g * tau + C * math.exp(-t / tau)
        x = z0[:3] + W * (math.sin(t) + tau * (1 - math.cos(t))) + g * tau * t - C * tau * math.expm1(-t / tau)
        return np.concatenate([x, v])

    def start(self, count: int) -> np.ndarray:
        """Return sparks that leave the origin in all directions."""
        return np.concatenate([np.zeros((3, count)), spread(count, (-3, -3, 0), (3, 3, 6))])


@dataclasses.dataclass(frozen=True)
class Tracers:
    """Tracers of the ABC flow, with chaotic paths; the solution is computed, good for a few Lyapunov times (about 15 each)."""

    flow: ABC = dataclasses.field(default_factory=ABC)

    name: ClassVar[str] = "abc"
    order: ClassVar[int] = 1
    velocity_free: ClassVar[bool] = True

    @ti.func
    def velocity(self, t, x):
        """Return dx/dt."""
        return self.flow.velocity(t, x)

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        f, k = self.flow, 2 * math.pi / self.flow.length
        (sx, sy, sz), (cx, cy, cz) = np.sin(k * z), np.cos(k * z)
        return np.stack([f.A * sz + f.C * cy, f.B * sx + f.A * cz, f.C * sy + f.B * cx])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """Return a reference solution."""
        return reference(self, t, z0)

    def start(self, count: int) -> np.ndarray:
        """Return tracers all over one cell of the flow."""
        return spread(count, (0,) * 3, (self.flow.length,) * 3)


def reference(
    problem: Problem, t: float, z0: np.ndarray, *, accuracy: float = 1e-12, most_steps: int = 2**19
) -> np.ndarray:
    """Return the state at t by Dormand-Prince with ever more equal steps, until twice as many change less than `accuracy`.

    Raises RunError if `most_steps` do not do it.
    """
    scheme, steps = schemes.get("dormand-prince"), 64
    before = schemes.integrate(scheme, problem.rate, 0.0, z0, t / steps, steps)[-1]
    while steps < most_steps:
        steps *= 2
        now = schemes.integrate(scheme, problem.rate, 0.0, z0, t / steps, steps)[-1]
        if np.abs(now - before).max() <= accuracy * max(1.0, float(np.abs(now).max())):
            return now
        before = now
    raise RunError(f"the reference of problem '{problem.name}' at t = {t:.6g} does not settle to {accuracy:.0e}")
