"""Forces: closed forms, drag towards a flow, and laws of the user's own, in f64 and in single lanes (they compile faster)."""

import dataclasses
import math

import numpy as np
import pytest
import taichi as ti
from fused_bench import Particles

import tparticles as tp
from tparticles.errors import InputError
from tparticles.physics.law import Bound

COUNT = 20
pytestmark = pytest.mark.usefixtures("cpu64")

NOISE = tp.CurlNoise(speed=2.0, length=0.8, octaves=3, period=0.7, drift=(0.0, 0.3, 1.0))
WHIRL = tp.Vortex(circulation=3.0)


def start(bench, seed=1):
    rng = np.random.default_rng(seed)
    x, v = rng.uniform(-2, 2, (2, COUNT, 3))
    bench.set("x", x)
    bench.set("v", v)
    return x, v


def test_free_fall_is_exact_for_a_second_order_scheme(cpu64):
    bench = Particles(tp.Newtonian(forces=tp.Gravity()), COUNT)
    x, v = start(bench)
    for frame in range(12):
        bench.run("midpoint", frame / 24, (frame + 1) / 24, 1 / 50, lanes=1)
    g = np.array([0, 0, -9.81])
    np.testing.assert_allclose(bench.get("x"), x + 0.5 * v + 0.125 * g, atol=1e-13)
    np.testing.assert_allclose(bench.get("v"), v + 0.5 * g, atol=1e-13)


def test_drag_ends_at_the_terminal_velocity(cpu64):
    bench = Particles(tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=0.05, flow=tp.Uniform(wind=(3.0, 0, 0))))), COUNT)
    start(bench)
    bench.run("rk4", 0.0, 2.0, 0.02, lanes=1)
    np.testing.assert_allclose(bench.get("v"), np.broadcast_to([3.0, 0.0, -9.81 * 0.05], (COUNT, 3)), atol=1e-12)


class OneForce:
    """Gravity and drag towards a vortex and one octave of noise, written as one law."""

    def __init__(self):
        self.whirl, self.noise, self.time, self.octaves = WHIRL, NOISE, 0.2, NOISE.octaves

    @ti.func
    def acceleration(self, t, x, v):
        u = self.whirl.velocity(t, x)
        for o in range(self.octaves):
            u += self.noise.velocity_pass(o, t, x)
        return (u - v) / self.time - ti.Vector([0.0, 0.0, 9.81])


def test_drag_towards_a_sum_equals_the_law_written_as_one(cpu64):
    parts = Particles(tp.Newtonian(forces=(tp.Drag(time=0.2, flow=WHIRL + NOISE), tp.Gravity())), COUNT)
    whole = Particles(tp.Newtonian(forces=OneForce()), COUNT)
    for bench in (parts, whole):
        start(bench)
        bench.run("rk4", 1.0, 1.5, 0.02, lanes=1)
    np.testing.assert_allclose(parts.get("x"), whole.get("x"), atol=1e-12)
    np.testing.assert_allclose(parts.get("v"), whole.get("v"), atol=1e-11)


def test_each_drag_is_given_its_own_flow(cpu64):
    # Two drags of equal strength towards winds that cancel: the flow register must not keep the first one's wind.
    winds = [
        tp.Drag(time=0.1, flow=tp.Uniform(wind=(w, 0.0, 0.0)) + tp.Uniform(wind=(0.0, 1.0, 0.0))) for w in (5.0, -5.0)
    ]
    bench = Particles(tp.Newtonian(forces=winds), COUNT)
    start(bench)
    bench.run("rk4", 0.0, 2.0, 0.02, lanes=1)
    np.testing.assert_allclose(bench.get("v"), np.broadcast_to([0.0, 1.0, 0.0], (COUNT, 3)), atol=1e-12)


@dataclasses.dataclass(frozen=True)
class Magnus:
    """A user's force with a flow: a = k (u - v) x axis."""

    k: float = 2.0
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    flow: object = dataclasses.field(default_factory=lambda: tp.Uniform(wind=(1.0, 2.0, 0.0)))

    @ti.func
    def acceleration(self, t, x, v, u):
        return self.k * (u - v).cross(self.axis)

    def jacobian_bound(self):
        return Bound(imaginary=self.k)


def test_a_users_force_with_a_flow_is_given_it(cpu64):
    bench = Particles(tp.Newtonian(forces=Magnus()), COUNT)
    _, v = start(bench)
    bench.run("rk4", 0.0, 1.0, 1 / 400, lanes=1)
    # v - u turns about the axis at k: v' = -k w x axis
    w, wind, (c, s) = v - [1, 2, 0], np.array([1.0, 2, 0]), (math.cos(2.0), math.sin(2.0))
    turned = np.stack([w[:, 0] * c - w[:, 1] * s, w[:, 0] * s + w[:, 1] * c, w[:, 2]], axis=1)
    np.testing.assert_allclose(bench.get("v"), wind + turned, atol=1e-8)


def test_bounds_of_systems_add_up():
    system = tp.Newtonian(forces=(tp.Gravity(), Magnus(), Magnus(k=3.0)))
    assert system.jacobian_bound() == Bound(imaginary=5.0)
    assert tp.Advected(flow=tp.Uniform() + WHIRL).jacobian_bound() == WHIRL.jacobian_bound()
    assert tp.Newtonian(forces=tp.Drag(time=0.1)).jacobian_bound() == Bound(real=10.0)


def test_a_law_without_a_bound_is_named():
    with pytest.raises(InputError, match="OneForce has no jacobian_bound"):
        tp.Newtonian(forces=OneForce()).jacobian_bound()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Newtonian(forces=tp.Uniform()), r"Newtonian\.forces: Uniform\(.*is no force"),
        (lambda: tp.Newtonian(forces=(tp.Gravity(), 3)), r"Newtonian\.forces: 3 is no force"),
        (lambda: tp.Newtonian(), r"Newtonian\.forces is missing"),
        (lambda: tp.Advected(flow=tp.Gravity()), r"Advected\.flow: Gravity\(.*is no flow"),
        (lambda: tp.Advected(flows=tp.Uniform()), r"Advected has no parameter 'flows'; did you mean 'flow'"),
    ],
)
def test_laws_that_do_not_fit_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
