"""The vectorised functions against double precision, in units in the last place of f32."""

import numpy as np
import pytest
import taichi as ti
from law_probe import Probe

from tparticles.physics import elementary

RNG = np.random.default_rng(0)


@ti.func
def all_functions(law: ti.template(), row):
    q, x, s, c = row[0], row[1], row[2], row[3]
    sine, cosine = elementary.sin_cos(q)
    fade, mean = elementary.fading(s)
    return ti.Vector([sine, cosine, elementary.exp(x), fade, mean, elementary.cube_root(c)])


@pytest.fixture
def evaluate(cpu32):
    return Probe(None, all_functions, arguments=4, width=6)


def units(found, exact):
    """Return the largest error in units in the last place of the exact value."""
    found, exact = np.asarray(found, np.float64), np.asarray(exact, np.float64)
    spacing = np.spacing(np.abs(exact).astype(np.float32)).astype(np.float64)
    return float(np.max(np.abs(found - exact) / spacing))


@pytest.mark.parametrize("turns", [0.5, 10.0, 1600.0, 1e5])
def test_sine_and_cosine(evaluate, turns):
    q = np.concatenate([RNG.uniform(-turns, turns, 300_000), np.arange(-8, 9) / 8]).astype(np.float32)
    found = evaluate(q, 0.0, 1.0, 1.0)
    # exact reduction of the f32 input: what is left is the error of the polynomial
    r = q.astype(np.float64) - np.round(q.astype(np.float64))
    sine, cosine = np.sin(2 * np.pi * r), np.cos(2 * np.pi * r)
    # the spacing halves just below 1; where it does, 4 units are 2.4e-7
    for column, exact in ((0, sine), (1, cosine)):
        away = np.abs(exact) > 1e-12
        assert units(found[away, column], exact[away]) <= 4
        assert np.abs(found[:, column] - exact).max() < 2.4e-7


def test_exact_points_of_sine_and_cosine(evaluate):
    q = np.array([0.0, 0.25, 0.5, 0.75, 1.0, -0.25, 1e6, -0.5])
    found = evaluate(q, 0.0, 1.0, 1.0)
    np.testing.assert_allclose(found[:, 0], [0, 1, 0, -1, 0, -1, 0, 0], atol=1e-7)
    np.testing.assert_allclose(found[:, 1], [1, 0, -1, 0, 1, 0, 1, -1], atol=1e-7)


def test_exponential(evaluate):
    x = RNG.uniform(-30, 30, 300_000).astype(np.float32)
    exact = np.exp(x.astype(np.float64))
    found = evaluate(0.0, x, 1.0, 1.0)[:, 2]
    # x log2(e) is rounded, which makes as large an error as the rounding of x itself
    assert (np.abs(found / exact - 1) < 1e-7 * (1 + np.abs(x))).all()


def test_exponential_far_out(evaluate):
    found = evaluate(0.0, np.array([-1e9, -200.0, -86.0, 86.0, 1e9]), 1.0, 1.0)[:, 2]
    assert found[0] == found[1] == 0
    np.testing.assert_allclose(found[2:4], np.exp([-86.0, 86.0]), rtol=1e-5)
    assert np.isfinite(found).all()


def test_fading_and_its_mean(evaluate):
    s = np.concatenate([np.geomspace(1e-30, 60, 200_000), [0.0, 0.5]]).astype(np.float32)
    found = evaluate(0.0, 0.0, s, 1.0)
    exact = s.astype(np.float64)
    mean = np.where(exact > 0, -np.expm1(-exact) / np.maximum(exact, 1e-300), 1.0)
    assert units(found[:, 4], mean) <= 4
    np.testing.assert_allclose(found[:, 3], np.exp(-exact), rtol=5e-6)


def test_cube_root(evaluate):
    c = np.geomspace(1e-25, 1e25, 300_000).astype(np.float32)
    assert units(evaluate(0.0, 0.0, 1.0, c)[:, 5], np.cbrt(c.astype(np.float64))) <= 4
