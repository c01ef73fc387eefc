"""Schemes that are not built in, given as a user would give them, and an exact solution to measure them on."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from tparticles.schemes import (
    CATALOGUE,
    Op,
    OpKind,
    Scheme,
    Stability,
    adams,
    bdf,
    integrate,
    runge_kutta,
    splitting,
)

F = Fraction


def modified_euler(theta) -> Scheme:
    """Bridson's: k2 is taken a whole Euler step ahead and weighted with theta."""
    order = 2 if theta == F(1, 2) else 1
    return runge_kutta([[], [1]], [1 - theta, theta], name=f"modified-euler-{theta}", order=order)


_gamma = 0.4358665215084590  # irrational on purpose: its products carry rounding errors

PLUGINS = (
    modified_euler(F(2, 3)),
    modified_euler(1),
    runge_kutta([[], [0.5], [-1, 2]], [1 / 6, 2 / 3, 1 / 6], name="kutta-rk3", order=3, c=[0, 0.5, 1]),
    # A full square matrix, as numpy users write it. Ralston 1962.
    runge_kutta(
        np.array([[0, 0, 0], [1 / 2, 0, 0], [0, 3 / 4, 0]]), np.array([2, 3, 4]) / 9, name="ralston-rk3", order=3
    ),
    # One-parameter family of second order with an irrational parameter: only the tolerance makes it order 2.
    runge_kutta([[], [_gamma]], [1 - 1 / (2 * _gamma), 1 / (2 * _gamma)], name="irrational-rk2", order=2),
    # Ralston's RK4 of least error bound (1962) in closed form, with sqrt(5): order 4 only to rounding.
    runge_kutta(
        [
            [],
            [2 / 5],
            [(-2889 + 1428 * math.sqrt(5)) / 1024, (3785 - 1620 * math.sqrt(5)) / 1024],
            [
                (-3365 + 2094 * math.sqrt(5)) / 6040,
                (-975 - 3046 * math.sqrt(5)) / 2552,
                (467040 + 203968 * math.sqrt(5)) / 240845,
            ],
        ],
        [
            (263 + 24 * math.sqrt(5)) / 1812,
            (125 - 1000 * math.sqrt(5)) / 3828,
            (3426304 + 1661952 * math.sqrt(5)) / 5924787,
            (30 - 4 * math.sqrt(5)) / 123,
        ],
        name="ralston-rk4",
        order=4,
    ),
    runge_kutta(
        [
            [],
            [F(1, 5)],
            [F(3, 40), F(9, 40)],
            [F(44, 45), F(-56, 15), F(32, 9)],
            [F(19372, 6561), F(-25360, 2187), F(64448, 6561), F(-212, 729)],
            [F(9017, 3168), F(-355, 33), F(46732, 5247), F(49, 176), F(-5103, 18656)],
        ],
        [F(35, 384), 0, F(500, 1113), F(125, 192), F(-2187, 6784), F(11, 84)],
        name="dormand-prince-5",
        order=5,
        c=[0, F(1, 5), F(3, 10), F(4, 5), F(8, 9), 1],
    ),
    # Butcher 1964.
    runge_kutta(
        [
            [],
            [F(1, 3)],
            [0, F(2, 3)],
            [F(1, 12), F(1, 3), F(-1, 12)],
            [F(-1, 16), F(9, 8), F(-3, 16), F(-3, 8)],
            [0, F(9, 8), F(-3, 8), F(-3, 4), F(1, 2)],
            [F(9, 44), F(-9, 11), F(63, 44), F(18, 11), 0, F(-16, 11)],
        ],
        [F(11, 120), 0, F(27, 40), F(27, 40), F(-4, 15), F(-4, 15), F(11, 120)],
        name="butcher-6",
        order=6,
        c=[0, F(1, 3), F(2, 3), F(1, 3), F(1, 2), F(1, 2), 1],
    ),
)

# Crouzeix 1975: two stages, order 3, A-stable, gamma = (3 + sqrt 3) / 6.
_crouzeix = (3 + math.sqrt(3)) / 6

PLUGINS += (
    runge_kutta([[_crouzeix], [1 - 2 * _crouzeix, _crouzeix]], [0.5, 0.5], name="crouzeix", order=3),
    # An explicit first stage, and weights that are not the last row (Radau IA's): the result is combined.
    runge_kutta([[], [F(1, 3), F(1, 3)]], [F(1, 4), F(3, 4)], name="explicit-first", order=3),
    adams([F(1901, 720), F(-2774, 720), F(2616, 720), F(-1274, 720), F(251, 720)], name="ab5", order=5),
    adams([F(3, 2), F(-1, 2)], [F(5, 12), F(8, 12), F(-1, 12)], name="abm23", order=3),
    adams([1], [0.5, 0.5], name="euler-trapezoidal", order=2),
    adams([F(3, 2), F(-1, 2)], [F(5, 12), F(8, 12), F(-1, 12)], mode="PEC", name="pec3", order=3),
    bdf(1, name="bdf1"),
    splitting([0.5, 0.5], [1], name="classic-verlet", order=2),
    # McLachlan and Atela 1992, second order with the smallest error.
    splitting(
        [1 / math.sqrt(2), 1 - 1 / math.sqrt(2)], [1 - 1 / math.sqrt(2), 1 / math.sqrt(2)], first="drift", name="ma2"
    ),
    # Ruth 1983, third order.
    splitting([F(7, 24), F(3, 4), F(-1, 24)], [F(2, 3), F(-2, 3), 1], first="kick", name="ruth3", order=3),
)

SCHEMES = (*CATALOGUE.values(), *PLUGINS)
BY_NAME = {scheme.name: scheme for scheme in SCHEMES}


def make(**changes) -> Scheme:
    """Return a minimal scheme, Euler's, with some fields replaced."""
    parts = {
        "name": "trial",
        "order": 1,
        "ops": (Op(OpKind.EVALUATE), Op(OpKind.COMBINE, weights=(1.0,))),
        "slopes": 1,
        "stability": Stability(numerator=(1, 1)),
    }
    return Scheme(**{**parts, **changes})


FIRST_ORDER = tuple(scheme for scheme in SCHEMES if 1 in scheme.system_orders)
ONE_STEP_EXPLICIT = tuple(scheme for scheme in FIRST_ORDER if scheme.one_step and not scheme.implicit)


def run(scheme: Scheme, f, z, dt, steps: int):
    """Return z after `steps` equal steps from t = 0."""
    return integrate(scheme, f, 0.0, z, dt, steps)[-1]


def smooth_rhs(t: float, z: np.ndarray) -> np.ndarray:
    """Nonlinear, with time on the right-hand side; `smooth_solution` solves it."""
    x, y = z
    return np.array([-2 * t * x**2, math.cos(t) + ((2 + math.sin(t)) ** 2 - y**2) / 4])


def smooth_solution(t: float) -> np.ndarray:
    return np.array([1 / (1 + t**2), 2 + math.sin(t)])


def smooth_motion(t: float) -> np.ndarray:
    """Position and velocity that `velocity_free_rhs` and `velocity_rhs` lead to."""
    return np.array([[1 + math.sin(t)], [math.cos(t)]])


def velocity_free_rhs(t: float, z: np.ndarray) -> np.ndarray:
    (x,), (X,) = z[0], smooth_motion(t)[0]
    return np.array([z[1], [-math.sin(t) - x**3 + X**3]])


def velocity_rhs(t: float, z: np.ndarray) -> np.ndarray:
    (x, v), (X, V) = z[:, 0], smooth_motion(t)[:, 0]
    return np.array([z[1], [-math.sin(t) - x**3 + X**3 - (1 + x) * v - v**3 + (1 + X) * V + V**3]])


def growth(scheme: Scheme, direction: complex, reach: float, steps: int = 2000) -> np.ndarray:
    """Return |z| after each of `steps` steps, dt = 1, of x' = direction reach x, from 1, until it passes 1e200.

    Splittings run v' = -reach v for direction -1 and x'' = -reach^2 x for direction 1j.
    """
    if scheme.system_orders == {2}:
        z0 = np.array([0.0, 1.0]) if direction == -1 else np.array([1.0, 0.0])
        A = np.array([[0, 1], [0, -reach] if direction == -1 else [-(reach**2), 0]])
        weights = np.array([0, 1]) if direction == -1 else np.array([1, 1 / reach])

        def f(t, z):
            return A @ z
    else:
        z0, rate, weights = 1 + 0j, direction * reach, 1

        def f(t, z):
            return rate * z

    with np.errstate(all="ignore"):
        sizes = np.abs([np.abs(z * weights).max() for z in integrate(scheme, f, 0.0, z0, 1.0, steps)])
    beyond = ~(sizes <= 1e200)
    return sizes[: np.argmax(beyond)] if beyond.any() else sizes
