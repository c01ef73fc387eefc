"""Several noises in a sum share the code of an octave."""

import numpy as np
import pytest
from law_probe import FlowProbe

import tparticles as tp
from tparticles.binding import Parameters
from tparticles.systems.terms import flow

A = tp.CurlNoise(speed=0.9, length=0.9, octaves=3, gain=0.6, drift=(0.25, 0.0, 1.6), period=1.6, ramp=0.5, seed=1)
B = tp.CurlNoise(speed=0.75, length=0.34, octaves=2, drift=(0.25, 0.0, 2.2), period=0.7, ramp=0.2, ground=-1.0, seed=2)
FROZEN = tp.CurlNoise(length=0.5, octaves=2, ramp=0.2)
FREE = tp.CurlNoise(length=0.5, octaves=2, period=1.0)

pytestmark = pytest.mark.usefixtures("cpu64")


@pytest.mark.parametrize(
    ("law", "octaves"),
    [
        (A + B, [5]),
        (A + tp.Uniform() + B, [5, None]),
        (B + A + B, [7]),
        (A + FROZEN, [3, 2]),
        (FREE + A + FROZEN + FREE, [4, 3, 2]),
        (A + B + B + B + A, [12]),
    ],
)
def test_noises_of_one_kind_become_one_term(law, octaves):
    pool = Parameters()
    terms = flow(law, pool, 0)
    assert [term.in_passes for term in terms] == [count is not None for count in octaves]
    assert all(float(count) in pool.scalars for count in octaves if count)


@pytest.mark.parametrize("parts", [(A, B), (B, A, B), (FROZEN, FROZEN), (FREE, FREE)])
def test_they_move_particles_as_each_of_them_says(parts):
    """Against the noises one by one."""
    first, *others = [part.as_octaves() for part in parts]
    joined = first
    for other in others:
        joined = joined.joined(other)
    x = np.random.default_rng(0).uniform(-2.0, 2.0, (500, 3))
    each = [FlowProbe(part)(x, 1.7) for part in parts]
    assert all(np.abs(u).max() > 0.5 for u in each)
    np.testing.assert_allclose(FlowProbe(joined)(x, 1.7), sum(each), rtol=0, atol=1e-12)
