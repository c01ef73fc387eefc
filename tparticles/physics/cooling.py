"""How a spark cools: two closed forms of its age, and burning char, which is integrated.

A cooling law gives the temperature [K] as a function of the temperature at birth, the age and the diameter, so no state is
kept; `Char` is a differential equation, so a system carries T in its state and every scheme integrates it.
"""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false

import math
from typing import Annotated

import taichi as ti
from pydantic import Field

from ..spec import NonNegative, Positive, spec
from .elementary import exp
from .law import Bound

STEFAN_BOLTZMANN = 5.670374419e-8  # [W / (m^2 K^4)]


@spec
class Exponential:
    """T = Ta + (T0 - Ta) exp(-age / `time`): an effective time constant [s], char heat included by its choice."""

    time: Positive = 1.0
    ambient: Positive = 293.0

    integrated = False
    uses_size = False

    @ti.func
    def temperature(self, T0, age, size):
        """Return the temperature [K] at `age` [s]."""
        return self.ambient + (T0 - self.ambient) * exp(-age / self.time)

    def age_at(self, T: float, T0: float) -> float:
        """Return the age [s] at which a spark born at `T0` has cooled to `T` [K]; inf if it never does."""
        if T0 <= T:
            return 0.0
        return self.time * math.log((T0 - self.ambient) / (T - self.ambient)) if self.ambient < T else math.inf


@spec
class Radiative:
    """Radiation alone from a sphere: m c dT/dt = -emissivity sigma A T^4, T = T0 (1 + 3 k T0^3 age)^(-1/3).

    k = 6 emissivity sigma / (`density` `heat_capacity` size). [kg/m^3], [J/(kg K)]; the particle's size is its diameter [m].
    """

    emissivity: Positive = 0.9
    density: Positive = 300.0
    heat_capacity: Positive = 1000.0

    integrated = False
    uses_size = True

    @ti.func
    def temperature(self, T0, age, size):
        """Return the temperature [K] at `age` [s]."""
        k = ti.static(6 * STEFAN_BOLTZMANN) * self.emissivity / (self.density * self.heat_capacity * size)
        return T0 * (1.0 + 3.0 * k * T0 * T0 * T0 * age) ** ti.static(-1 / 3)

    def age_at(self, T: float, T0: float, size: float) -> float:
        """Return the age [s] at which a spark born at `T0` with diameter `size` has cooled to `T` [K]."""
        k = 6 * STEFAN_BOLTZMANN * self.emissivity / (self.density * self.heat_capacity * size)
        return max(0.0, (T**-3 - T0**-3) / (3 * k))


@spec
class Char:
    """A glowing sphere of char: radiation, convection and the heat of its own combustion until it has burnt out.

    rho c d/6 dT/dt = -emissivity sigma (T^4 - Ta^4) - h (T - Tg) + q,   h = Nu lambda / d
    q = Nu (lambda / cp) / d ln(1 + B) H: oxygen diffusing to the surface burns carbon to CO (B = 0.233 / (4/3), Lewis number 1),
    which shrinks the sphere by the d^2 law, d^2 = d0^2 - K age, K = 4 Nu (lambda / cp) ln(1 + B) / rho, a closed form; burnt
    out at `ash` of its diameter, q = 0. Nu = 2 + 0.6 Re^(1/2) Pr^(1/3) (Ranz and Marshall, Chem. Eng. Prog. 48, 1952) with
    `slip` [m/s], the mean speed against the gas, and the diameter at birth. Glows near 1200 K, as measured for
    wood embers (Urban et al., Fire Safety J. 104, 2019).

    `ambient` [K] surroundings, `gas` [K] the air around the spark, `heat` [J/kg] of burning carbon to CO,
    `conductivity` [W/(m K)], `viscosity` [m^2/s] and `gas_heat_capacity` [J/(kg K)] of hot air.
    """

    ambient: Positive = 293.0
    gas: Positive = 500.0
    slip: NonNegative = 0.0
    emissivity: Positive = 0.9
    density: Positive = 300.0
    heat_capacity: Positive = 1000.0
    heat: NonNegative = 9.2e6
    ash: Annotated[Positive, Field(lt=1)] = 0.3
    conductivity: Positive = 0.067
    viscosity: Positive = 1.2e-4
    gas_heat_capacity: Positive = 1140.0

    integrated = True
    uses_size = True

    def derived(self) -> dict[str, float]:
        """Return rho D ln(1 + B) [kg/(m s)] of the burning surface."""
        return {"burning": self._burning()}

    def _burning(self) -> float:
        return self.conductivity / self.gas_heat_capacity * math.log1p(0.233 / (4 / 3))

    @ti.func
    def rate(self, T, age, size):
        """Return dT/dt [K/s] of a spark with diameter `size` [m] at birth."""
        nu = 2.0 + 0.6 * ti.sqrt(self.slip * size / self.viscosity) * ti.static(0.7 ** (1 / 3))
        shrink = 4.0 * nu * self.burning / self.density
        least = self.ash * size
        d2 = size * size - shrink * age
        burning = d2 > least * least
        d = ti.sqrt(ti.max(d2, least * least))
        gain = ti.select(burning, nu * self.burning * self.heat / d, 0.0)
        loss = self.emissivity * ti.static(STEFAN_BOLTZMANN) * (T * T * T * T - self.ambient**4)
        loss += nu * self.conductivity / d * (T - self.gas)
        return 6.0 / (self.density * self.heat_capacity * d) * (gain - loss)

    def burn_out(self, size: float) -> float:
        """Return the age [s] at which a spark of diameter `size` [m] has burnt out."""
        return size**2 * (1 - self.ash**2) * self.density / (4 * self._nusselt(size) * self._burning())

    def _nusselt(self, size: float) -> float:
        return 2 + 0.6 * math.sqrt(self.slip * size / self.viscosity) * 0.7 ** (1 / 3)

    def jacobian_bound_for(self, *, hottest: float, smallest: float) -> Bound:
        """Return the stiffest -d(dT/dt)/dT, at the `hottest` temperature [K] and the `smallest` diameter at birth [m]."""
        d = self.ash * smallest
        slope = 4 * self.emissivity * STEFAN_BOLTZMANN * hottest**3 + self._nusselt(smallest) * self.conductivity / d
        return Bound(real=6 / (self.density * self.heat_capacity * d) * slope)
