"""Test problems that come back: the oscillator, the pendulum, Kepler's ellipse; as `problems` has them."""

# pyright: reportInvalidTypeForm=false

from __future__ import annotations

import dataclasses
import math
from typing import Any, ClassVar

import numpy as np
import taichi as ti

from .elliptic import complete, incomplete, jacobi
from .problems import spread


@dataclasses.dataclass(frozen=True)
class Oscillator:
    """x'' = -omega^2 x."""

    omega: float = 1.0

    name: ClassVar[str] = "oscillator"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = True

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        return -self.omega * self.omega * x

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        return np.concatenate([z[3:], -(self.omega**2) * z[:3]])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """x = x0 cos omega t + v0 / omega sin omega t."""
        w, x, v = self.omega, z0[:3], z0[3:]
        c, s = math.cos(w * t), math.sin(w * t)
        return np.concatenate([x * c + v / w * s, v * c - w * x * s])

    def start(self, count: int) -> np.ndarray:
        """Return states of amplitudes about 1."""
        return spread(count, (-1,) * 6, (1,) * 6)


@dataclasses.dataclass(frozen=True)
class Damped:
    """x'' = -omega^2 x - 2 zeta omega v, 0 <= zeta < 1."""

    omega: float = 1.0
    zeta: float = 0.1

    name: ClassVar[str] = "damped"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = False

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        return -self.omega * self.omega * x - 2.0 * self.zeta * self.omega * v

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        return np.concatenate([z[3:], -(self.omega**2) * z[:3] - 2 * self.zeta * self.omega * z[3:]])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """x = e^(-zeta omega t) (a cos + b sin) of omega sqrt(1 - zeta^2) t."""
        g = self.zeta * self.omega
        wd = math.sqrt(self.omega**2 - g**2)
        a, b = z0[:3], (z0[3:] + g * z0[:3]) / wd
        c, s, fade = math.cos(wd * t), math.sin(wd * t), math.exp(-g * t)
        return np.concatenate([fade * (a * c + b * s), fade * (wd * (b * c - a * s) - g * (a * c + b * s))])

    def start(self, count: int) -> np.ndarray:
        """Return states of amplitudes about 1."""
        return spread(count, (-1,) * 6, (1,) * 6)


def pendulum_solution(omega: Any, t: float, x0: np.ndarray, v0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return x and v of x'' = -omega^2 sin x for swings below the top: sin(x / 2) = k sn(omega t + u0), v = 2 k omega cn."""
    m, u0 = pendulum_argument(omega, x0, v0)
    sn, cn, _ = jacobi(omega * t + u0, m)
    k = np.sqrt(m)
    return 2 * np.arcsin(np.clip(k * sn, -1, 1)), 2 * k * omega * cn


def pendulum_argument(omega: Any, x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return m = k^2 = sin^2(x/2) + (v / 2 omega)^2 of a pendulum's swing, and the argument u of sn where it is now.

    NaN where the pendulum goes over the top (m >= 1).
    """
    s, c = np.sin(x / 2), v / (2 * omega)
    m = s**2 + c**2
    m = np.where(m < 1, m, np.nan)
    return m, incomplete(np.arctan2(s, c), m)


def pendulum_period(amplitude: Any, omega: Any = 1.0) -> np.ndarray:
    """Return the exact period 4 K(sin^2(amplitude / 2)) / omega of a pendulum."""
    return 4 * complete(np.sin(np.asarray(amplitude) / 2) ** 2) / omega


@dataclasses.dataclass(frozen=True)
class Swings:
    """Three equations of period 1 in one: an oscillator in x[0], and pendula of amplitudes `small`, `wide` [rad] in x[1], x[2].

    x[0]'' = -w0^2 x[0]; x[1]'' = -w1^2 sin x[1], and so x[2], with the w at which an exact period is 1.
    """

    omega: tuple[float, float, float]

    name: ClassVar[str] = "swings"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = True

    @staticmethod
    def of_period_1(small: float, wide: float) -> Swings:
        """Return the problem whose pendula have period 1 at these amplitudes [rad]."""
        first, second = (float(pendulum_period(amplitude)) for amplitude in (small, wide))
        return Swings((2 * math.pi, first, second))

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        w = self.omega
        return ti.Vector([-w[0] * w[0] * x[0], -w[1] * w[1] * ti.sin(x[1]), -w[2] * w[2] * ti.sin(x[2])])

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        w2 = np.array(self.omega)[:, None] ** 2
        return np.concatenate([z[3:], -w2 * np.stack([z[0], np.sin(z[1]), np.sin(z[2])])])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """Return the oscillator's and the pendula's solutions."""
        w, (x0, v0) = self.omega, z0.reshape(2, 3, -1)
        c, s = math.cos(w[0] * t), math.sin(w[0] * t)
        parts = [(x0[0] * c + v0[0] / w[0] * s, v0[0] * c - w[0] * x0[0] * s)]
        parts += [pendulum_solution(w[i], t, x0[i], v0[i]) for i in (1, 2)]
        return np.array(parts).transpose(1, 0, 2).reshape(6, -1)

    def at_phases(self, amplitudes: tuple[float, float, float], count: int) -> np.ndarray:
        """Return states of these amplitudes at `count` times spread evenly over the period, shape (6, count)."""
        rest = np.zeros((6, 1))
        rest[:3, 0] = amplitudes
        return np.concatenate([self.solution(k / count, rest) for k in range(count)], axis=1)

    def start(self, count: int) -> np.ndarray:
        """Return states of amplitudes 1, 1 and 2."""
        return self.at_phases((1.0, 1.0, 2.0), count)

    def energy(self, z: np.ndarray) -> np.ndarray:
        """Return the three energies, v^2 / 2 + w^2 (x^2 / 2 or 1 - cos x), shape (3, n)."""
        w2 = np.array(self.omega)[:, None] ** 2
        x, v = z[:3], z[3:]
        potential = np.stack([x[0] ** 2 / 2, *(2 * np.sin(x[1:] / 2) ** 2)])
        return v**2 / 2 + w2 * potential

    def swing(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how far along its swing each is [turns], 0..1, and the frequency of that swing, of shape (3, n) both.

        NaN for a pendulum that goes over the top.
        """
        x, v = z[:3], z[3:]
        turns, frequency = [np.arctan2(x[0], v[0] / self.omega[0]) / (2 * math.pi)], [np.ones_like(x[0])]
        for i in (1, 2):
            m, u = pendulum_argument(self.omega[i], x[i], v[i])
            quarter = complete(m)
            turns.append(u / (4 * quarter))
            frequency.append(self.omega[i] / (4 * quarter))
        return np.stack(turns) % 1, np.stack(frequency)


@dataclasses.dataclass(frozen=True)
class Kepler:
    """x'' = -x / |x|^3, bound orbits; `eccentricity` of those that it starts from, of semi-major axis 1 and period 2 pi."""

    eccentricity: float = 0.6

    name: ClassVar[str] = "kepler"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = True

    @ti.func
    def acceleration(self, t, x, v):
        """Return x''."""
        r2 = x.dot(x)
        return -x / (r2 * ti.sqrt(r2))

    def rate(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return dz/dt."""
        return np.concatenate([z[3:], -z[:3] * (z[:3] ** 2).sum(axis=0) ** -1.5])

    def solution(self, t: float, z0: np.ndarray) -> np.ndarray:
        """x = f x0 + g v0, with the change D of eccentric anomaly: n t = D - (1 - r0/a) sin D + s (1 - cos D), s = x0.v0 / sqrt a.

        Source: R. Bate, D. Mueller, J. White, Fundamentals of Astrodynamics (1971), section 4.4.
        """
        x, v = z0[:3], z0[3:]
        r0, sigma = np.sqrt((x**2).sum(axis=0)), (x * v).sum(axis=0)
        a = 1 / (2 / r0 - (v**2).sum(axis=0))
        s, far = sigma / np.sqrt(a), 1 - r0 / a
        mean = a**-1.5 * t
        D = _root_of_kepler(mean, far, s)
        r = a * (1 - far * np.cos(D) + s * np.sin(D))
        f, g = 1 - a / r0 * (1 - np.cos(D)), t - a**1.5 * (D - np.sin(D))
        df, dg = -np.sqrt(a) / (r * r0) * np.sin(D), 1 - a / r * (1 - np.cos(D))
        return np.concatenate([f * x + g * v, df * x + dg * v])

    def start(self, count: int) -> np.ndarray:
        """Return states at the pericentre of orbits in planes of their own."""
        e = self.eccentricity
        tilt = spread(count, (0.0,), (math.pi,))[0]
        x, v = 1 - e, math.sqrt((1 + e) / (1 - e))
        zero = np.zeros(count)
        return np.stack([zero + x, zero, zero, zero, v * np.cos(tilt), v * np.sin(tilt)])

    def energy(self, z: np.ndarray) -> np.ndarray:
        """Return v^2 / 2 - 1 / r, shape (n,)."""
        return (z[3:] ** 2).sum(axis=0) / 2 - (z[:3] ** 2).sum(axis=0) ** -0.5


def _root_of_kepler(mean: np.ndarray, far: np.ndarray, s: np.ndarray) -> np.ndarray:
    # The left side rises all along: Newton's method between bounds that close in.
    low, high = mean - np.abs(far) - 2 * np.abs(s), mean + np.abs(far) + 2 * np.abs(s)
    D = mean
    for _ in range(100):
        off = D - far * np.sin(D) + s * (1 - np.cos(D)) - mean
        low, high = np.where(off < 0, D, low), np.where(off > 0, D, high)
        step = D - off / (1 - far * np.cos(D) + s * np.sin(D))
        D = np.where((step > low) & (step < high), step, (low + high) / 2)
    return D
