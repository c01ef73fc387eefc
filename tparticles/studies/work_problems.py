"""The ensembles of the work-precision study: tracers of the ABC flow, sparks of very different inertia, Kepler orbits."""

# Kernel signatures are Taichi's, and vectors of a law have no Python type inside kernels.
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import taichi as ti

from ..physics.elementary import sin_cos
from .cloth import Cloth
from .problems import Problem, Tracers, spread

_TURNS = 1 / (2 * math.pi)


@dataclass(frozen=True)
class Sparks:
    """Sparks of response times from 1e-4 to 1e-1 s in a gusty wind: v' = (wind cos t - v) / tau + g, in the plane y = tau.

    One law serves the whole ensemble: what differs between particles has to be part of their state, and nothing moves along
    y, so that y holds the response time. `wind` and `g` are (x, z) [m/s, m/s^2]; the wind's period is 2 pi s.
    """

    wind: tuple[float, float] = (2.0, 0.5)
    g: tuple[float, float] = (0.0, -9.81)
    fastest: float = 1e-4
    slowest: float = 1e-1

    name: ClassVar[str] = "stiff-drag"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = False
    moving: ClassVar[tuple[int, ...]] = (0, 2, 3, 5)  # the components that are not constant

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        rate, c = 1.0 / x[1], sin_cos(_TURNS * t)[1]
        ax = (self.wind[0] * c - v[0]) * rate + self.g[0]
        az = (self.wind[1] * c - v[2]) * rate + self.g[1]
        return ti.Vector([ax, 0.0 * ax, az])

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        out, c = np.zeros_like(z), math.cos(t)
        out[0], out[2] = z[3], z[5]
        out[3] = (self.wind[0] * c - z[3]) / z[1] + self.g[0]
        out[5] = (self.wind[1] * c - z[5]) / z[1] + self.g[1]
        return out

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """v = W (cos t + tau sin t) + g tau + C e^(-t / tau), W = wind / (1 + tau^2); x is its integral."""
        out, tau = z0.copy(), z0[1]
        for d, wind, g in ((0, self.wind[0], self.g[0]), (2, self.wind[1], self.g[1])):
            W = wind / (1 + tau**2)
            C = z0[3 + d] - W - g * tau
            out[3 + d] = W * (math.cos(t) + tau * math.sin(t)) + g * tau + C * np.exp(-t / tau)
            out[d] += W * (math.sin(t) + tau * (1 - math.cos(t))) + g * tau * t - C * tau * np.expm1(-t / tau)
        return out

    def start(self, count: int) -> np.ndarray:
        """Return sparks that leave the line x = z = 0, response times spread evenly over their logarithm."""
        power, vx, vz = spread(count, (math.log(self.fastest), -3, 0), (math.log(self.slowest), 3, 6))
        zero = np.zeros(count)
        return np.stack([zero, np.exp(power), zero, vx, zero, vz])


@dataclass(frozen=True)
class Kepler:
    """Planets around the origin: x'' = -x / |x|^3, eccentricities up to 0.6, one turn in 2 pi."""

    name: ClassVar[str] = "kepler"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = True

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        r2 = x.norm_sqr()
        return -x / (r2 * ti.sqrt(r2))

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        r2 = (z[:3] ** 2).sum(axis=0)
        return np.concatenate([z[3:], -z[:3] / (r2 * np.sqrt(r2))])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """Start at perihelion (1 - e, 0, 0), so that E - e sin E = t; x = (cos E - e, sqrt(1 - e^2) sin E)."""
        e = 1 - z0[0]
        E = np.full_like(e, t) + e * math.sin(t)
        for _ in range(60):
            E -= (E - e * np.sin(E) - t) / (1 - e * np.cos(E))
        b, rate = np.sqrt(1 - e**2), 1 / (1 - e * np.cos(E))
        zero = np.zeros_like(e)
        return np.stack([np.cos(E) - e, b * np.sin(E), zero, -np.sin(E) * rate, b * np.cos(E) * rate, zero])

    def start(self, count: int) -> np.ndarray:
        """Return planets at perihelion, semi-major axis 1."""
        e = spread(count, (0.0,), (0.6,))[0]
        zero = np.zeros(count)
        return np.stack([1 - e, zero, zero, zero, np.sqrt((1 + e) / (1 - e)), zero])


@dataclass(frozen=True)
class Work:
    """A problem of the study and the time `span` until which it is solved; `stiff`: explicit solvers are not the obvious choice."""

    problem: Problem
    span: float
    what: str
    stiff: bool = False
    moving: tuple[int, ...] = dataclasses.field(default=())  # components that a solver has to be given; () for all

    @property
    def coupled(self) -> bool:
        """Whether it is one mesh, not an ensemble of particles."""
        return isinstance(self.problem, Cloth)


WORKS: dict[str, Work] = {
    "abc": Work(Tracers(), 5.0, "tracers of the ABC flow to t = 5"),
    "stiff-drag": Work(
        Sparks(), 2.0, "sparks, response times 1e-4 to 1e-1 s, to t = 2 s", stiff=True, moving=Sparks.moving
    ),
    "kepler": Work(Kepler(), 2 * math.pi, "planets, eccentricities up to 0.6, one turn"),
    **{
        f"cloth-1e{power}": Work(
            Cloth(10.0**power),
            0.05,
            f"taut cloth of 16 x 16 vertices, stiffness ratio 1e{power}, to t = 0.05 s",
            stiff=True,
        )
        for power in (4, 5, 6)
    },
}
