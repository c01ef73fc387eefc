"""Flows: no divergence, closed forms, sums, bounds on the gradient, and laws of the user's own. In f64."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
import taichi as ti
from flow_cases import CASES, SUMS, Case, every_case
from law_probe import FlowProbe, jacobian

import tparticles as tp
from tparticles.errors import InputError
from tparticles.physics.law import flow_terms, jacobian_bound

EVERY = every_case()
pytestmark = pytest.mark.usefixtures("cpu64")

_probes: dict[str, FlowProbe] = {}


def probe(name: str) -> FlowProbe:
    """Return the compiled flow of a case; tests share it, for compiling costs more than all the rest."""
    if name not in _probes:
        _probes[name] = FlowProbe(EVERY[name].flow)
    return _probes[name]


@pytest.fixture(scope="module", autouse=True)
def forget_probes():
    yield
    _probes.clear()


def test_every_flow_of_the_package_has_a_case():
    offered = {value for name in tp.__all__ if isinstance(value := getattr(tp, name), type)}
    flows = {cls for cls in offered for name in ("velocity", "velocity_pass") if callable(getattr(cls, name, None))}
    assert flows == set(CASES)


def spectral_norms(J: np.ndarray) -> np.ndarray:
    return np.sqrt(np.linalg.eigvalsh(np.swapaxes(J, 1, 2) @ J)[:, -1])


@pytest.mark.parametrize("name", EVERY)
def test_divergence_is_zero_to_rounding(name):
    case = EVERY[name]
    J = jacobian(probe(name), case.points(3000), case.h, case.t)
    size = np.sqrt((J**2).sum(axis=(1, 2)).mean())
    divergence = np.abs(np.trace(J, axis1=1, axis2=2))
    # rounding: 1e-16 u / h; a wrong sign would leave as much as the gradient itself
    assert divergence.max() <= 1e-8 * size + 1e-10


@pytest.mark.parametrize("name", EVERY)
def test_the_bound_covers_the_gradient(name):
    """10^5 points: the bound holds for the spectral norm, so also for every eigenvalue, and is not far above it."""
    case = EVERY[name]
    J = jacobian(probe(name), case.points(100_000, seed=1), case.h, case.t)
    largest = spectral_norms(J).max()
    bound = jacobian_bound(flow_terms(case.flow))
    assert bound.real == bound.imaginary
    assert np.abs(np.linalg.eigvals(J[:20_000])).max() <= largest * (1 + 1e-9)
    assert largest <= bound.real * (1 + 1e-6) + 1e-9
    # octaves and summands rarely peak in one place, and noise rarely reaches its least upper bound
    assert bound.real <= 4.0 * largest + 1e-9


@pytest.mark.parametrize("name", SUMS)
def test_a_sum_is_the_sum_of_its_flows(name):
    case = SUMS[name]
    x = case.points(500)
    total = probe(f"sum, {name}")(x, case.t)
    parts = sum(FlowProbe(flow)(x, case.t) for flow in case.flow.flows)
    np.testing.assert_allclose(total, parts, atol=1e-13)


def test_sums_flatten_and_refuse_what_is_no_flow():
    a, b, c = tp.Uniform(), tp.ABC(), tp.Vortex()
    assert (a + b + c).flows == (a + (b + c)).flows == (a, b, c)
    assert (a + b) == (a + b) and hash(a + b) == hash(a + b) and (a + b) != (b + a)
    assert repr(a + b) == f"{a!r} + {b!r}"
    with pytest.raises(InputError, match=r"Sum: 3 is no flow"):
        a + 3


def test_uniform_is_exact():
    u = probe("Uniform, wind")(np.random.default_rng(0).normal(size=(100, 3)))
    assert (u == [1.0, -2.0, 0.5]).all()


def test_vortex_has_the_closed_form_of_lamb_and_oseen():
    case = EVERY["Vortex, tilted"]
    flow, x = case.flow, case.points(2000)
    axis, d = np.array(flow.axis) / 3.0, x - flow.center
    arm = d - np.outer(d @ axis, axis)
    r = np.linalg.norm(arm, axis=1)
    speed = flow.circulation / (2 * math.pi * r) * -np.expm1(-((r / flow.core) ** 2))
    expected = speed[:, None] * np.cross(axis, arm / r[:, None])
    np.testing.assert_allclose(probe("Vortex, tilted")(x), expected, atol=1e-13)


def test_vortex_turns_like_a_solid_near_its_axis_and_like_a_line_far_away():
    vortex = FlowProbe(tp.Vortex(circulation=2.0, core=0.5))
    rotation = 2.0 / (2 * math.pi * 0.25)
    for r in (0.0, 1e-12, 1e-6, 1e-3):
        assert vortex(np.array([r, 0.0, 5.0]))[0] == pytest.approx([0.0, rotation * r, 0.0], rel=1e-5, abs=1e-30)
    assert vortex(np.array([0.0, 50.0, 0.0]))[0] == pytest.approx([-2.0 / (2 * math.pi * 50), 0, 0], rel=1e-12)


def test_abc_has_its_formula_and_its_period():
    case = EVERY["ABC, short"]
    flow, x = case.flow, case.points(2000)
    s, c = np.sin(2 * math.pi / flow.length * x), np.cos(2 * math.pi / flow.length * x)
    A, B, C = flow.A, flow.B, flow.C
    expected = np.stack([A * s[:, 2] + C * c[:, 1], B * s[:, 0] + A * c[:, 2], C * s[:, 1] + B * c[:, 0]], axis=1)
    np.testing.assert_allclose(probe("ABC, short")(x), expected, atol=1e-13)
    np.testing.assert_allclose(probe("ABC, short")(x + 7 * flow.length), expected, atol=1e-12)


def test_abc_is_a_beltrami_flow():
    """curl u = k u, which makes it a steady solution of Euler's equations."""
    case = EVERY["ABC, short"]
    x = case.points(500)
    J = jacobian(probe("ABC, short"), x, case.h)
    curl = np.stack([J[:, 2, 1] - J[:, 1, 2], J[:, 0, 2] - J[:, 2, 0], J[:, 1, 0] - J[:, 0, 1]], axis=1)
    np.testing.assert_allclose(curl, 2 * math.pi / case.flow.length * probe("ABC, short")(x), atol=1e-9)


def mccaffrey(z: np.ndarray, power: float) -> np.ndarray:
    """The three regimes of NBSIR 79-1910, table 2, Q in kW: flame, intermittent, plume."""
    eta = z / power**0.4
    k = np.select([eta < 0.08, eta < 0.2], [6.8 * np.sqrt(eta), np.full_like(eta, 1.9)], 1.1 * eta ** (-1 / 3))
    return k * power**0.2


@pytest.mark.parametrize("power", [5.0, 50.0, 2000.0])
def test_plume_follows_mccaffrey_on_its_axis(power):
    # heights count from the virtual origin, 5 cm below the base
    z = np.geomspace(0.001, 20.0, 400) * power**0.4
    x = np.stack([0 * z, 0 * z, z], axis=1)
    u = FlowProbe(tp.Plume(power=power))(x)
    assert (u[:, :2] == 0).all()
    error = u[:, 2] / mccaffrey(z + 0.05, power) - 1
    assert np.abs(error).max() < 0.07


def test_plume_has_a_gaussian_profile_and_draws_air_in():
    flow, plume = tp.Plume(), probe("Plume, campfire")
    for z in (0.1, 0.5, 2.0, 5.0):
        b = flow.radius + flow.spread * z
        x = np.stack([np.linspace(0, 4, 50) * b, np.zeros(50), np.full(50, z)], axis=1)
        u = plume(x)
        np.testing.assert_allclose(u[:, 2], u[0, 2] * np.exp(-((x[:, 0] / b) ** 2)), rtol=1e-12)
        assert (u[-10:, 0] < 0).all()  # well outside the flow goes inwards at every height
        assert (u[:, 1] == 0).all()
    # turned about the axis, the flow turns along
    a, b = plume(np.array([[0.6, 0.0, 1.0], [0.0, 0.6, 1.0]]))
    assert b == pytest.approx([0.0, a[0], a[2]])


def test_plume_gathers_volume_with_height_by_what_flows_in():
    plume = probe("Plume, campfire")
    heights, radius = np.linspace(0.0, 6.0, 61), 12.0
    r = (np.arange(4000) + 0.5) / 4000 * radius
    flux = np.array(
        [
            np.sum(plume(np.stack([r, 0 * r, np.full_like(r, z)], axis=1))[:, 2] * 2 * math.pi * r) * radius / 4000
            for z in heights
        ]
    )
    assert (np.diff(flux) > 0).all()
    z = np.linspace(1e-6, 6.0, 6001)
    wall = plume(np.stack([np.full_like(z, radius), 0 * z, z], axis=1))[:, 0]
    inflow = -np.trapezoid(wall, z) * 2 * math.pi * radius
    assert inflow == pytest.approx(flux[-1] - flux[0], rel=1e-3)


def test_plume_below_its_base_rises_as_at_the_base():
    plume = probe("Plume, campfire")
    below, base = plume(np.array([[0.1, 0.0, -0.5], [0.1, 0.0, 0.0]]))
    assert (below == base).all() and below[0] == 0


@dataclass(frozen=True)
class Shear:
    """A flow of the user's own, as written in a scene file."""

    rate: float = 2.0
    direction: tuple = (1.0, 0, 0)
    flips: bool = False

    @ti.func
    def velocity(self, t, x):
        u = self.rate * x[2] * self.direction
        if ti.static(self.flips):
            u = -u
        return u


def test_a_flow_of_the_users_own_adds_up_with_the_built_in_ones():
    x = np.random.default_rng(0).normal(size=(50, 3))
    u = FlowProbe(Shear() + tp.Uniform(wind=(0.0, 1.0, 0.0)))(x)
    np.testing.assert_allclose(u, np.stack([2 * x[:, 2], np.ones(50), np.zeros(50)], axis=1))
    assert (FlowProbe(Shear(flips=True))(x)[:, 0] == -2 * x[:, 2]).all()


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (Shear(), Shear(rate=-7.0, direction=(0.0, 2, 0))),
        (tp.Vortex(), tp.Vortex(center=(1.0, 2.0, 3.0), axis=(0.0, 1.0, 0.0), circulation=-2.0, core=0.1)),
        (tp.Plume(), tp.Plume(power=7.0, spread=0.3)),
        (tp.CurlNoise(octaves=2), tp.CurlNoise(octaves=2, speed=3.0, length=0.3, gain=0.1, drift=(1.0, 0, 0), seed=9)),
    ],
)
def test_parameters_are_data(first, second):
    """The kernel compiled for one set of numbers, launched with another one's, gives the other's flow."""
    x = np.random.default_rng(0).uniform(0.1, 2.0, (50, 3))
    a, b = FlowProbe(first), FlowProbe(second)
    expected, before = b(x, 0.3), a(x, 0.3)
    a.parameters._array = b.parameters.array
    assert (a(x, 0.3) == expected).all() and not (before == expected).all()


def test_a_flow_without_a_bound_says_so():
    with pytest.raises(InputError, match=r"Shear has no jacobian_bound"):
        jacobian_bound(flow_terms(Shear() + tp.Uniform()))


def test_a_vortex_needs_an_axis():
    with pytest.raises(InputError, match=r"Vortex\.axis = \(0\.0, 0\.0, 0\.0\): a direction must not be zero"):
        tp.Vortex(axis=(0, 0, 0))


def test_cases_keep_away_from_lattice_faces():
    case = Case(tp.CurlNoise(length=0.5), h=1e-2)
    p = case.points(1000) * 2.0
    assert (np.abs(p - np.round(p)) > 0.08 - 1e-12).all()
