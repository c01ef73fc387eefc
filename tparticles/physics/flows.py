"""Velocity fields in closed form: uniform wind, a vortex, the ABC flow, the plume of a fire."""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false

import math
from typing import Any

import numpy as np
import taichi as ti

from ..spec import Finite, NonNegative, Positive, Vec3, spec, unit
from .elementary import cube_root, fading, sin_cos
from .law import Bound, Flow

_ORIGIN = 0.05  # depth of a plume's virtual origin [m]


@spec
class Uniform(Flow):
    """A constant `wind` [m/s]."""

    wind: Vec3 = (0.0, 0.0, 0.0)

    @ti.func
    def velocity(self, t, x):
        """Return the wind [m/s]."""
        return self.wind

    def jacobian_bound(self) -> Bound:
        """Return zero: the flow is the same everywhere."""
        return Bound()


@spec
class Vortex(Flow):
    """A Lamb-Oseen vortex: u_theta = circulation / (2 pi r) (1 - exp(-r^2 / core^2)) about an axis through `center`.

    `circulation` [m^2/s], `core` [m]. Close to the axis it turns like a rigid body at circulation / (2 pi core^2) [rad/s].
    """

    center: Vec3 = (0.0, 0.0, 0.0)
    axis: Vec3 = (0.0, 0.0, 1.0)
    circulation: Finite = 1.0
    core: Positive = 1.0

    def __post_init__(self) -> None:
        unit("Vortex.axis", self.axis)

    def derived(self) -> dict[str, Any]:
        """Return the axis at unit length, core^-2 [1/m^2] and the rotation rate on the axis [rad/s]."""
        return {"axis": unit("Vortex.axis", self.axis), "inverse": self.core**-2, "rotation": self._rotation()}

    @ti.func
    def velocity(self, t, x):
        """Return the velocity [m/s]."""
        d = x - self.center
        arm = d - d.dot(self.axis) * self.axis
        # (1 - exp(-s)) / s with s = r^2 / core^2
        _, ratio = fading(arm.norm_sqr() * self.inverse)
        return (self.rotation * ratio) * self.axis.cross(arm)

    def jacobian_bound(self) -> Bound:
        """Return the rotation rate on the axis, the largest norm of du/dx."""
        rate = abs(self._rotation())
        return Bound(real=rate, imaginary=rate)

    def _rotation(self) -> float:
        return self.circulation / (2 * math.pi * self.core**2)


@spec
class ABC(Flow):
    """The Arnold-Beltrami-Childress flow, a steady solution of Euler's equations with chaotic paths.

    u = (A sin kz + C cos ky, B sin kx + A cos kz, C sin ky + B cos kx), k = 2 pi / length
    (Dombre et al., J. Fluid Mech. 167, 1986). A, B, C [m/s], `length` [m].
    """

    A: Finite = math.sqrt(3.0)
    B: Finite = math.sqrt(2.0)
    C: Finite = 1.0
    length: Positive = 2 * math.pi

    def derived(self) -> dict[str, float]:
        """Return the reciprocal of the length [1/m]."""
        return {"inverse": 1.0 / self.length}

    @ti.func
    def velocity(self, t, x):
        """Return the velocity [m/s]."""
        s, c = sin_cos(self.inverse * x)
        return ti.Vector([self.A * s[2] + self.C * c[1], self.B * s[0] + self.A * c[2], self.C * s[1] + self.B * c[0]])

    def jacobian_bound(self) -> Bound:
        """Return the Frobenius norm of du/dx, k sqrt(A^2 + B^2 + C^2) everywhere."""
        rate = 2 * math.pi / self.length * math.hypot(self.A, self.B, self.C)
        return Bound(real=rate, imaginary=rate)


@spec
class Plume(Flow):
    """The mean updraught of a fire: McCaffrey's centreline speed, a Gaussian profile, entrainment from one potential.

    Centreline, eta = z / Q^0.4 (McCaffrey, NBSIR 79-1910, 1979; Q = `power` [kW]): u = Q^0.2 times 6.8 eta^0.5 in the flame,
    1.9 in the intermittent zone, 1.1 eta^(-1/3) in the plume; here one smooth curve within 6 % of the three,
    u = 6.8 Q^0.2 eta^0.5 (1 + (eta / 0.1123)^(10/3))^(-1/4).
    Profile: u_z = u exp(-r^2 / b^2), b = `radius` + `spread` z. The Stokes stream function u b^2/2 (1 - exp(-r^2 / b^2)) gives
    the radial inflow that makes the whole divergence-free. `center` is the middle of the fire's base.
    """

    power: Positive = 50.0
    center: Vec3 = (0.0, 0.0, 0.0)
    radius: Positive = 0.3
    spread: NonNegative = 0.12

    def derived(self) -> dict[str, float]:
        """Return 6.8 Q^0.2 [m/s] and Q^-0.4 [1/m]."""
        return {"fast": 6.8 * self.power**0.2, "inverse": self.power**-0.4}

    @ti.func
    def velocity(self, t, x):
        """Return the velocity [m/s]; the axis is z, heights below the base count as the base."""
        d = x - self.center
        z = ti.max(d[2], 0.0)
        # a virtual origin a little below the base: sqrt(z) has no slope there
        eta = (z + _ORIGIN) * self.inverse
        # a = (eta / 0.1123)^(10/3)
        c = eta * ti.static(1 / 0.1123)
        a = c * c * c * cube_root(c)
        w = self.fast * ti.sqrt(eta / ti.sqrt(1.0 + a))
        # d(ln w)/dz = (1/2 - 5/6 a / (1 + a)) / (z + z0)
        dw = w * (0.5 - ti.static(5 / 6) * a / (1.0 + a)) / (z + _ORIGIN)
        b = self.radius + self.spread * z
        s = (d[0] * d[0] + d[1] * d[1]) / (b * b)
        e, ratio = fading(s)
        # u_r / r = -(1/r^2) d/dz [w b^2/2 (1 - exp(-r^2/b^2))]
        inward = -(0.5 * dw * ratio + w * self.spread / b * (ratio - e))
        inward = ti.select(d[2] > 0.0, inward, 0.0)
        return ti.Vector([inward * d[0], inward * d[1], w * e])

    def jacobian_bound(self) -> Bound:
        """Return the largest spectral norm of du/dx over a grid in height and radius, with 2 % to spare."""
        # heights above the virtual origin, past the speed's maximum; s = r^2 / b^2
        h = np.geomspace(_ORIGIN, 5.0 * self.power**0.4 + _ORIGIN, 160)[:, None]
        s = np.linspace(1e-3, 3.0, 60)[None, :] ** 2
        rate = 1.02 * float(np.max(np.linalg.norm(self._jacobian(h, s), 2, axis=(-2, -1))))
        return Bound(real=rate, imaginary=rate)

    def _jacobian(self, h: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return du/dx in cylindrical components (r, theta, z) at heights h - 0.05 and radii b sqrt(s), broadcast."""
        h, s = np.broadcast_arrays(h, s)
        a = (h * self.power**-0.4 / 0.1123) ** (10 / 3)
        w = 6.8 * np.sqrt(h) * (1 + a) ** -0.25  # Q^0.2 eta^0.5 = h^0.5
        g = (0.5 - 5 / 6 * a / (1 + a)) / h  # d(ln w)/dz
        dw, ddw = w * g, w * (g * g - g / h - 25 / 9 * a / ((1 + a) * h) ** 2)
        b = self.radius + self.spread * (h - _ORIGIN)
        k = self.spread / b
        e, f = np.exp(-s), -np.expm1(-s) / s
        # d/dz at constant r: s' = -2 s k, f' = -2 k (e - f), e' = 2 s k e
        inward = -(0.5 * dw * f + w * k * (f - e))
        bend = 0.5 * ddw * f + 2 * dw * k * (f - e) + w * k * k * (f - e - 2 * s * e)
        r = b * np.sqrt(s)
        stretch = dw * e + 2 * w * e * s * k
        zero = np.zeros_like(r)
        rows = ((-stretch - inward, zero, -r * bend), (zero, inward, zero), (-2 * r / b**2 * w * e, zero, stretch))
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
