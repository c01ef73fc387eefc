"""Velocity fields in closed form: uniform wind, a vortex, the ABC flow, the plume of a fire."""

import math

import taichi as ti

from ..spec import Finite, NonNegative, Positive, Vec3, spec
from .law import Bound, Flow


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

    @ti.func
    def velocity(self, t, x):
        """Return the velocity [m/s]."""
        axis = self.axis.normalized()
        d = x - self.center
        arm = d - d.dot(axis) * axis
        # (1 - exp(-s)) / s with s = r^2 / core^2; its series where the difference would cancel
        s = arm.norm_sqr() / (self.core * self.core)
        ratio = ti.select(s < 1e-3, 1.0 - s * (0.5 - s / 6.0), (1.0 - ti.exp(-s)) / ti.max(s, 1e-3))
        return (self.circulation / ti.static(2 * math.pi) / (self.core * self.core)) * ratio * axis.cross(arm)

    def jacobian_bound(self) -> Bound:
        """Return the rotation rate on the axis, the largest eigenvalue of the flow."""
        rate = abs(self.circulation) / (2 * math.pi * self.core**2)
        return Bound(real=rate, imaginary=rate)


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
        """Return the wave number k [1/m]."""
        return {"k": 2 * math.pi / self.length}

    @ti.func
    def velocity(self, t, x):
        """Return the velocity [m/s]."""
        s, c = ti.sin(self.k * x), ti.cos(self.k * x)
        return ti.Vector([self.A * s[2] + self.C * c[1], self.B * s[0] + self.A * c[2], self.C * s[1] + self.B * c[0]])

    def jacobian_bound(self) -> Bound:
        """Return the Frobenius norm of du/dx, k sqrt(A^2 + B^2 + C^2) everywhere."""
        rate = 2 * math.pi / self.length * math.hypot(self.A, self.B, self.C)
        return Bound(real=rate, imaginary=rate)


@spec
class Plume(Flow):
    """The mean updraught of a fire: McCaffrey's centreline speed, a Gaussian profile, entrainment from one potential.

    Centreline, eta = z / Q^0.4 (McCaffrey, NBSIR 79-1910, 1979; Q = `power` [kW]): u = Q^0.2 times 6.8 eta^0.5 in the flame, 1.9 in the
    intermittent zone, 1.1 eta^(-1/3) in the plume; here one smooth curve within 6 % of the three,
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
        eta = (z + 0.05) * self.inverse
        a = (eta / 0.1123) ** ti.static(10 / 3)
        w = self.fast * ti.sqrt(eta) * (1.0 + a) ** -0.25
        # d(ln w)/dz = (1/2 - 5/6 a / (1 + a)) / (z + z0)
        dw = w * (0.5 - ti.static(5 / 6) * a / (1.0 + a)) / (z + 0.05)
        b = self.radius + self.spread * z
        s = (d[0] * d[0] + d[1] * d[1]) / (b * b)
        e = ti.exp(-s)
        ratio = ti.select(s < 1e-3, 1.0 - s * (0.5 - s / 6.0), (1.0 - e) / ti.max(s, 1e-3))
        # u_r / r = -(1/r^2) d/dz [w b^2/2 (1 - exp(-r^2/b^2))]
        inward = -(0.5 * dw * ratio + w * self.spread / b * (ratio - e))
        inward = ti.select(d[2] > 0.0, inward, 0.0)
        return ti.Vector([inward * d[0], inward * d[1], w * e])

    def jacobian_bound(self) -> Bound:
        """Return the largest shear: sqrt(2/e) u_max / radius across the profile, plus the stretching at the base."""
        fastest = 1.95 * self.power**0.2
        stretch = 6.8 * self.power**0.2 * (0.05 * self.power**-0.4) ** 0.5 * 0.5 / 0.05
        rate = math.sqrt(2 / math.e) * fastest / self.radius + stretch
        return Bound(real=rate, imaginary=rate)
