"""The same bits for one thread or two, with a cold kernel cache or a warm one. Enough particles that threads share loops."""

import numpy as np
import pytest
from small_scenes import group, scene, simulate

import tparticles as tp
from tparticles import backend

CROWD = scene(
    group(
        system=tp.Advected(flow=tp.Vortex(circulation=5.0)),
        appearance=tp.Glow(),
        births=(tp.Burst(count=30_000), tp.Burst(count=10_000, time=0.05)),
        shape=tp.Sphere(radius=1.0),
        temperature=(1400.0, 400.0),
        size=(0.01, 0.005),
        lifetime=(0.2, 0.19),
        cooling=tp.Exponential(time=0.3),
        region=tp.Sphere(radius=1.05),
    ),
    shutter=0.5,
    look=tp.Look(ev=8.0),
)


def bits(**options):
    """Return what the second and the fourth frame are made of."""
    parts = []
    for frame in simulate(CROWD, **options).frames((2, 4)):
        report = frame.report
        parts += [frame.image, frame.linear(), [report.born, report.died, report.steps, report.dt_min, report.dt_max]]
        parts += list(frame.state()["dots"].values())
    return parts


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """An empty kernel cache."""
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("cache")
        patch.setenv("TPARTICLES_CACHE", str(folder))
        yield folder


@pytest.fixture(scope="module")
def cold(cache):
    assert not list(cache.rglob("*.tic"))
    return bits(threads=2)


def same(first, second):
    return len(first) == len(second) and all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_the_crowd_is_seen_and_dies(cold):
    assert cold[0].max() > 30 and cold[0].std() > 3
    born, died, steps, *_ = cold[2]
    assert born == 40_000 and 2_000 < died < 30_000 and steps > 200_000


def test_a_cold_cache_and_a_warm_one(cache, cold):
    backend.stop()  # what writes the cache
    assert list(cache.rglob("*.tic")), "no kernel was cached"
    assert same(bits(threads=2), cold)


def test_one_thread_and_two(cold):
    assert same(bits(threads=1), cold)
