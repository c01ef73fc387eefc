"""The same functions in f64 lose nothing."""

import numpy as np
import pytest
from law_probe import Probe
from test_elementary import all_functions

RNG = np.random.default_rng(1)


@pytest.fixture(scope="module")
def evaluate(cpu64):
    return Probe(None, all_functions, arguments=4, width=6)


def test_double_precision(evaluate):
    q, x = RNG.uniform(-10, 10, 10_000), RNG.uniform(-30, 30, 10_000)
    s, c = np.geomspace(1e-12, 60, 10_000), np.geomspace(1e-30, 1e30, 10_000)
    found = evaluate(q, x, s, c)
    r = q - np.round(q)
    exact = [np.sin(2 * np.pi * r), np.cos(2 * np.pi * r), np.exp(x), np.exp(-s), -np.expm1(-s) / s, np.cbrt(c)]
    for column, values in zip(found.T, exact, strict=True):
        # 2 pi r is rounded here, where ours is not: near a zero that is all there is
        np.testing.assert_allclose(column, values, rtol=4e-15, atol=5e-16)
