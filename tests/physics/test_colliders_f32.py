"""Colliders in f32, as films run."""

import numpy as np
import pytest
from collider_cases import CASES, POINTS, Ask

import tparticles as tp

pytestmark = pytest.mark.usefixtures("cpu32")


@pytest.mark.parametrize(("collider", "exact"), CASES.values(), ids=CASES)
def test_distances_and_normals(collider, exact):
    ask = Ask(collider)
    x = POINTS.astype(np.float32)
    np.testing.assert_allclose(ask.distance(x), exact(x.astype(float)), atol=2e-6)
    np.testing.assert_allclose(np.linalg.norm(ask.normal(x), axis=1), 1.0, rtol=1e-6)


def test_the_last_cell_holds_the_far_corner():
    # (high - low) * per_metre may round to a hair above or below the last sample
    for n in (3, 7, 50, 1001):
        heights = np.tile(np.linspace(0, 1, n), (n, 1)) ** 2
        ask = Ask(tp.Heightfield(heights=heights, low=(0.1, 0.1), high=(0.7, 0.7)))
        d, normal = ask.distance([[0.7, 0.7, 1.0]]), ask.normal([[0.7, 0.7, 1.0]])
        assert d == pytest.approx(0.0, abs=1e-4) and np.isfinite(normal).all()
