"""Cooling: the closed forms against their equations, burning char against a formula coded apart. In f64."""

import itertools
import math

import numpy as np
import pytest
import taichi as ti
from law_probe import Probe

import tparticles as tp
from tparticles.errors import InputError

pytestmark = pytest.mark.usefixtures("cpu64")
SIGMA = 5.670374419e-8
AGES = np.linspace(0.0, 3.0, 31)


@ti.func
def temperature(law: ti.template(), row):
    return ti.Vector([law.temperature(row[0], row[1], row[2])])


@ti.func
def rate(law: ti.template(), row):
    return ti.Vector([law.rate(row[0], row[1], row[2])])


def integrate(f, T, t, steps=40):
    """Integrate T' = f(t, T) with many RK4 steps between the times `t`."""
    out = [T]
    for a, b in itertools.pairwise(t):
        h = (b - a) / steps
        for k in range(steps):
            s = a + k * h
            k1 = f(s, T)
            k2 = f(s + h / 2, T + h / 2 * k1)
            k3 = f(s + h / 2, T + h / 2 * k2)
            T = T + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(s + h, T + h * k3))
        out.append(T)
    return np.array(out)


def test_exponential_solves_its_equation():
    law = tp.Exponential(time=0.7, ambient=300.0)
    found = Probe(law, temperature, arguments=3)(1500.0, AGES, 1e-3)
    np.testing.assert_allclose(found, integrate(lambda t, T: -(T - 300.0) / 0.7, 1500.0, AGES), rtol=1e-8)


@pytest.mark.parametrize("size", [2e-4, 1e-3, 5e-3])
def test_radiative_solves_its_equation(size):
    law = tp.Radiative(emissivity=0.8, density=400.0, heat_capacity=1200.0)
    # m c T' = -emissivity sigma A T^4 of a sphere, A / m = 6 / (density size)
    k = 6 * 0.8 * SIGMA / (400.0 * 1200.0 * size)
    found = Probe(law, temperature, arguments=3)(1500.0, AGES, size)
    np.testing.assert_allclose(found, integrate(lambda t, T: -k * T**4, 1500.0, AGES), rtol=1e-7)


def test_age_at_is_the_inverse():
    exponential, radiative = tp.Exponential(time=0.7), tp.Radiative()
    first, second = Probe(exponential, temperature, arguments=3), Probe(radiative, temperature, arguments=3)
    for T in (310.0, 700.0, 1499.0):
        assert first(1500.0, exponential.age_at(T, 1500.0), 1e-3)[0] == pytest.approx(T, rel=1e-12)
        assert second(1500.0, radiative.age_at(T, 1500.0, 2e-3), 2e-3)[0] == pytest.approx(T, rel=1e-12)


def test_age_at_the_ends():
    law = tp.Exponential(ambient=293.0)
    assert law.age_at(293.0, 1500.0) == law.age_at(100.0, 1500.0) == math.inf
    assert law.age_at(1600.0, 1500.0) == 0.0
    assert tp.Radiative().age_at(1600.0, 1500.0, 1e-3) == 0.0


def char_rate(law, T, age, d0):
    """The heat balance of a burning sphere, written from its physics: masses and powers of the whole sphere [kg, W]."""
    nusselt = 2 + 0.6 * math.sqrt(law.slip * d0 / law.viscosity) * 0.7 ** (1 / 3)
    transfer = nusselt * law.conductivity / law.gas_heat_capacity * math.log(1 + 0.233 * 3 / 4)  # rho D Sh ln(1 + B)
    lost = 4 * transfer / law.density * age
    burning = d0**2 - lost > (law.ash * d0) ** 2
    d = math.sqrt(d0**2 - lost) if burning else law.ash * d0
    area, mass = math.pi * d**2, law.density * math.pi / 6 * d**3
    power = area * transfer / d * law.heat if burning else 0.0
    power -= area * law.emissivity * SIGMA * (T**4 - law.ambient**4)
    power -= area * nusselt * law.conductivity / d * (T - law.gas)
    return power / (mass * law.heat_capacity)


@pytest.mark.parametrize("law", [tp.Char(), tp.Char(slip=2.0, emissivity=0.7, density=500.0, ash=0.5, gas=800.0)])
def test_char_has_the_rate_of_its_heat_balance(law):
    T, age, d = (a.ravel() for a in np.meshgrid([400.0, 900.0, 1500.0], [0.0, 0.3, 2.0, 30.0], [3e-4, 1e-3, 2e-3]))
    found = Probe(law, rate, arguments=3)(T, age, d)
    np.testing.assert_allclose(found, [char_rate(law, *row) for row in zip(T, age, d, strict=True)], rtol=1e-11)


def equilibrium(law, size):
    low, high = 300.0, 4000.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if char_rate(law, middle, 0.0, size) > 0 else (low, middle)
    return low


@pytest.mark.parametrize(("size", "expected"), [(1e-3, 1146.0), (0.5e-3, 1283.0)])
def test_char_glows_as_embers_do(size, expected):
    """Measured on wood embers: 1023 K at 1 m/s of air to 1223 K at 4 m/s (Urban et al. 2019)."""
    found = equilibrium(tp.Char(), size)
    assert found == pytest.approx(expected, abs=2.0)
    assert 1100 < found < 1300
    assert Probe(tp.Char(), rate, arguments=3)(found, 0.0, size)[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("size", "expected"), [(1e-3, 3.60), (0.5e-3, 0.90), (2e-3, 14.4)])
def test_char_burns_for_seconds(size, expected):
    law = tp.Char()
    age = law.burn_out(size)
    assert age == pytest.approx(expected, rel=0.01)
    # just before it gains heat, just after it only loses
    before, after = Probe(law, rate, arguments=3)(1000.0, np.array([age * (1 - 1e-9), age * (1 + 1e-9)]), size)
    assert before > 0 > after


def test_char_burns_faster_in_the_wind():
    assert tp.Char(slip=4.0).burn_out(1e-3) < 0.5 * tp.Char().burn_out(1e-3)
    assert equilibrium(tp.Char(slip=4.0), 1e-3) > equilibrium(tp.Char(), 1e-3)


def test_char_cools_to_its_surroundings_when_it_has_burnt_out():
    law = tp.Char(gas=293.0)
    ages = np.linspace(0.0, 6.0, 121)
    T = integrate(lambda t, T: char_rate(law, T, t, 1e-3), 1300.0, ages, steps=100)
    burnt = ages > law.burn_out(1e-3) + 0.05
    assert (np.diff(T[burnt]) <= 1e-9).all()
    assert T[-1] == pytest.approx(293.0, abs=1.0)
    assert T[ages < law.burn_out(1e-3)].min() > 1000


@pytest.mark.parametrize("law", [tp.Char(), tp.Char(slip=3.0, ash=0.1)])
def test_the_bound_covers_the_slope(law):
    smallest, hottest = 3e-4, 1500.0
    T, age, d = (
        a.ravel()
        for a in np.meshgrid(np.linspace(300, hottest, 13), np.linspace(0, 3, 31), np.geomspace(smallest, 3e-3, 6))
    )
    probe = Probe(law, rate, arguments=3)
    slope = (probe(T + 0.01, age, d) - probe(T - 0.01, age, d)) / 0.02
    bound = law.jacobian_bound_for(hottest=hottest, smallest=smallest)
    assert (slope < 0).all() and bound.imaginary == 0
    assert -slope.min() <= bound.real * (1 + 1e-6)
    assert bound.real <= 1.05 * -slope.min()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Exponential(time=0.0), r"Exponential\.time = 0\.0: should be greater than 0"),
        (lambda: tp.Radiative(emissivity=-1), r"Radiative\.emissivity = -1: should be greater than 0"),
        (lambda: tp.Char(ash=1.0), r"Char\.ash = 1\.0: should be less than 1"),
        (lambda: tp.Char(conductvity=1.0), r"no parameter 'conductvity'; did you mean 'conductivity'"),
    ],
)
def test_wrong_laws_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
