"""Gravity and drag. In f64."""

import numpy as np
import pytest
import taichi as ti
from law_probe import Probe

import tparticles as tp
from tparticles.errors import InputError
from tparticles.physics.law import Bound, jacobian_bound

pytestmark = pytest.mark.usefixtures("cpu64")


@ti.func
def free(law: ti.template(), row):
    return law.acceleration(row[0], ti.Vector([row[1], row[2], row[3]]), ti.Vector([row[4], row[5], row[6]]))


@ti.func
def in_flow(law: ti.template(), row):
    v = ti.Vector([row[0], row[1], row[2]])
    return law.acceleration(0.0, v * 0.0, v, ti.Vector([row[3], row[4], row[5]]))


def test_gravity_is_the_same_everywhere():
    rows = np.random.default_rng(0).normal(size=(7, 20))
    assert (Probe(tp.Gravity(), free, arguments=7, width=3)(*rows) == [0.0, 0.0, -9.81]).all()
    assert tp.Gravity().jacobian_bound() == Bound()


def test_drag_pulls_towards_the_flow():
    rows = np.random.default_rng(0).normal(size=(6, 20))
    drag = Probe(tp.Drag(time=0.25), in_flow, arguments=6, width=3)
    # the flow is evaluated apart and handed over
    np.testing.assert_allclose(drag(*rows), ((rows[3:] - rows[:3]) / 0.25).T)


def largest_root(time, g):
    return np.abs(np.roots([1.0, 1.0 / time, -g / time])).max()


@pytest.mark.parametrize("time", [0.01, 0.3, 5.0])
def test_the_bound_of_drag_covers_the_roots_with_any_gradient_of_the_flow(time):
    """x' = v, v' = (G x - v) / time: every eigenvalue g of G gives l^2 + l / time = g / time."""
    assert tp.Drag(time=time).jacobian_bound().real == pytest.approx(1 / time)
    flow = tp.ABC()
    most = flow.jacobian_bound().real
    bound = tp.Drag(time=time, flow=flow).jacobian_bound().real
    roots = [largest_root(time, most * r * np.exp(1j * a)) for r in (0.1, 1.0) for a in np.linspace(0, 2 * np.pi, 25)]
    assert max(roots) <= bound * (1 + 1e-12)
    assert bound <= 1.01 * max(roots)


def test_bounds_add_up_and_name_a_law_that_has_none():
    class Push:
        pass

    total = jacobian_bound([tp.Gravity(), tp.Drag(time=0.5), tp.Drag(time=0.25)])
    assert total == Bound(real=6.0)
    with pytest.raises(InputError, match=r"Push has no jacobian_bound"):
        jacobian_bound([tp.Gravity(), Push()])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: tp.Drag(), r"Drag\.time is missing"),
        (lambda: tp.Drag(time=0.0), r"Drag\.time = 0\.0: should be greater than 0"),
        (lambda: tp.Drag(time=1.0, flow=3), r"Drag\.flow: 3 is no flow"),
        (lambda: tp.Gravity(g=(0, 0)), r"Gravity\.g\[2\] is missing"),
    ],
)
def test_wrong_forces_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()
