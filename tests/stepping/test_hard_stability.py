"""Every scheme in the fused stepper at its own stability limits, on decay and on pure rotation, and Wright's instability.

Rates are data: the third component of a particle's place is its rate, so one kernel serves all rates. A particle born n steps
before the end takes n steps, so one launch shows a whole sequence.
"""

import math

import numpy as np
import pytest
import taichi as ti
from fused_bench import SCHEMES, Particles

import tparticles as tp
from tparticles import schemes
from tparticles.errors import InputError
from tparticles.stepping.control import check_fit

pytestmark = pytest.mark.usefixtures("cpu64")

COUNT = 500
BY_NAME = {"ids": lambda s: s.name}
FIRST_ORDER = [s for s in SCHEMES if 1 in s.system_orders]
SPLITTINGS = [s for s in SCHEMES if 1 not in s.system_orders]


class Linear:
    """(x, y) turns with rate z; x decays with rate -z where z < 0."""

    @ti.func
    def velocity(self, t, x):
        turns = x[2] > 0.0
        return ti.Vector([ti.select(turns, -x[2] * x[1], x[2] * x[0]), ti.select(turns, x[2] * x[0], 0.0), 0.0])


class LinearForce:
    """x'' = -z^2 x; v' = z v where z < 0."""

    @ti.func
    def acceleration(self, t, x, v):
        return ti.Vector([ti.select(x[2] > 0.0, -x[2] * x[2] * x[0], x[2] * v[0]), 0.0, 0.0])


@pytest.fixture(scope="module")
def flow(cpu64):
    return Particles(tp.Advected(flow=Linear()), COUNT)


@pytest.fixture(scope="module")
def force(cpu64):
    return Particles(tp.Newtonian(forces=LinearForce()), COUNT)


@pytest.fixture(scope="module")
def benches(flow, force):
    """By order."""
    return {1: flow, 2: force}


def sizes(benches, scheme, direction, reach, steps=COUNT):
    """Return |z| after `steps` (1, 2, ... or those of a list) steps of size 1 from |z| = 1."""
    steps = np.arange(1, steps + 1) if isinstance(steps, int) else np.array(steps)
    splits = scheme in SPLITTINGS
    bench = benches[2 if splits else 1]
    bench.set("x", (0.0 if splits and direction == -1 else 1.0, 0.0, -reach if direction == -1 else reach))
    if splits:
        bench.set("v", (1.0 if direction == -1 else 0.0, 0.0, 0.0))
    bench.count = len(steps)
    bench.set("birth", -1.0 * steps)
    report = bench.run(scheme, -1.0 - steps.max(), 0.0, 1.0, lanes=1)
    assert report.steps == steps.sum()
    x = bench.get("x")
    found = np.abs(x[:, 0])
    if splits:
        v = bench.get("v")[:, 0]
        found = np.abs(v) if direction == -1 else np.hypot(found, v / reach)
    elif direction == 1j:
        found = np.hypot(found, x[:, 1])
    bench.count = COUNT
    return found


def assert_grows_at_the_computed_rate(benches, scheme, direction, reach):
    rate = math.log(scheme.stability.amplification(direction * reach))
    assert rate > 0
    # late, where the largest root rules, and over swings of pairs of complex roots
    end = int(min(4000, 150 / rate))
    start = end // 2
    found = sizes(benches, scheme, direction, reach, [*range(start - 19, start + 1), *range(end - 19, end + 1)])
    first, last = (math.log(part.max()) for part in np.split(found, 2))
    assert last > first
    assert (last - first) / (end - start) == pytest.approx(rate, rel=0.05, abs=2e-5)


@pytest.mark.parametrize("axis", ["real", "imaginary"])
@pytest.mark.parametrize("scheme", SCHEMES, **BY_NAME)
def test_the_limits_separate_bounded_from_growing(benches, scheme, axis):
    direction, limit = {"real": (-1, scheme.real_limit), "imaginary": (1j, scheme.imaginary_limit)}[axis]
    if limit == math.inf:
        for reach in (0.3, 10.0, 1e4):
            found = sizes(benches, scheme, direction, reach, 100)
            assert found[20:].max() <= 1 + 1e-6
    elif limit > 0:
        found = sizes(benches, scheme, direction, 0.99 * limit)
        assert found[COUNT // 2 :].max() <= 1.01 * found[: COUNT // 2].max() and found.max() < 100
        assert_grows_at_the_computed_rate(benches, scheme, direction, 1.01 * limit)
    else:
        assert_grows_at_the_computed_rate(benches, scheme, direction, 1.0)


def test_slide_15_euler_multiplies_by_minus_ten(benches):
    bench = benches[1]
    bench.set("x", (1.0, 0.0, -1.0))
    bench.set("birth", 0.0)
    seen = []
    for n in range(5):
        seen.append(bench.get("x")[0, 0])
        bench.run("euler", 11.0 * n, 11.0 * (n + 1), 11.0, lanes=1)
    assert seen == [1, -10, 100, -1000, 10000]


def slide_15(benches, scheme, steps):
    bench, seen = benches[1], []
    bench.set("x", (1.0, 0.0, -1.0))
    bench.set("birth", 0.0)
    for n in range(steps):
        bench.run(scheme, 11.0 * n, 11.0 * (n + 1), 11.0, lanes=1)
        seen.append(bench.get("x")[0, 0])
    return np.array(seen)


@pytest.mark.parametrize("name", ["backward-euler", "semi-implicit-euler"])
def test_slide_15_backward_euler_divides_by_twelve(benches, name):
    np.testing.assert_allclose(slide_15(benches, name, 8), 12.0 ** -np.arange(1, 9), rtol=1e-8)


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if s.l_stable or s.name.startswith("bdf")], **BY_NAME)
def test_slide_15_l_stable_schemes_decay(benches, scheme):
    seen = np.abs(slide_15(benches, scheme, 20))
    assert seen[-1] < 1e-6 and seen[10:].max() < seen[:10].max() <= 1


@pytest.mark.parametrize("w_dt", [1e-3, 0.1, 1.0])
def test_euler_leaves_a_rotation_by_the_exact_factor(benches, w_dt):
    found = sizes(benches, schemes.get("euler"), 1j, w_dt)
    np.testing.assert_allclose(found, np.exp(0.5 * np.log1p(w_dt**2) * np.arange(1, COUNT + 1)), rtol=1e-11)


@pytest.mark.parametrize("name", ["trapezoidal", "implicit-midpoint"])
def test_neutral_schemes_keep_the_radius_over_ten_thousand_turns(benches, name):
    bench = benches[1]
    bench.count = 4
    bench.set("x", [(r, 0.0, 1.0) for r in (1.0, 2.0, 0.1, 100.0)])
    bench.set("birth", 0.0)
    dt, frames = 0.7, 20
    frame = 1e4 * 2 * math.pi / frames
    for k in range(frames):
        bench.run(name, k * frame, (k + 1) * frame, dt, lanes=1)
    x = bench.get("x")
    bench.count = COUNT
    np.testing.assert_allclose(np.hypot(x[:, 0], x[:, 1]), [1.0, 2.0, 0.1, 100.0], rtol=1e-10)


def omegas(bench, frame):
    w = np.linspace(2.4, 3.3, COUNT)
    bench.set("x", np.stack([np.ones(COUNT), np.zeros(COUNT), w / frame], axis=1))
    if bench.system.order == 2:
        bench.set("v", (0.0, 0.0, 0.0))
    bench.set("birth", 0.0)
    return w


def size(bench, w):
    x = bench.get("x")
    return np.hypot(x[:, 0], bench.get("v")[:, 0] / w if bench.system.order == 2 else x[:, 1])


def steps_of_a_frame(benches, scheme, clamp, frames=100):
    """Return omega * frame, and by how much a frame of a step of 0.6 and what the clamp makes of the rest multiplies the motion."""
    bench, frame = benches[2 if scheme == "velocity-verlet" else 1], 1 / 24
    w, found = omegas(bench, frame), []
    for k in range(frames):
        bench.run(scheme, k * frame, (k + 1) * frame, 0.6 * frame, clamp=clamp, lanes=1)
        if k + 1 in (frames // 2, frames):
            found.append(size(bench, w / frame))
    return w, found[1], found[0]


def pair_of_verlet(first, second):
    """Return the spectral radius of two steps on the unit oscillator: [1 - h^2/2, h; -h (1 - h^2/4), 1 - h^2/2]."""
    A, B = (
        np.array([[1 - h * h / 2, h], [-h * (1 - h * h / 4), 1 - h * h / 2]]).transpose(2, 0, 1)
        for h in (first, second)
    )
    return np.abs(np.linalg.eigvals(B @ A)).max(axis=1)


def test_slide_32_breaks_velocity_verlet_where_theory_says(benches):
    w, end, middle = steps_of_a_frame(benches, "velocity-verlet", "slide32-anyway")
    assert 0.6 * w.max() < 2  # each step is stable alone
    radius = pair_of_verlet(0.6 * w, 0.4 * w)
    grows = radius > 1.02
    assert grows.any()
    np.testing.assert_allclose((end / middle)[grows] ** (1 / 50), radius[grows], rtol=0.01)
    calm = (w < 2.57) | (w > 3.17)
    assert end[calm].max() < 100
    unstable = w[end > 1e3]
    assert unstable.min() == pytest.approx(2.58, abs=0.05) and unstable.max() == pytest.approx(3.16, abs=0.05)


@pytest.mark.parametrize(
    ("scheme", "clamp"), [("velocity-verlet", "equal"), ("velocity-verlet", "dyadic"), ("rk4", "slide32")]
)
def test_equal_steps_and_commuting_ones_are_immune(benches, scheme, clamp):
    _, end, middle = steps_of_a_frame(benches, scheme, clamp)
    assert max(end.max(), middle.max()) < 3


def test_alternating_stable_steps_grow_by_1_087_a_pair(benches):
    # frames of 1.35 and 1.47 in turn, each one step
    bench = benches[2]
    bench.set("x", (1.0, 0.0, 1.0))
    bench.set("v", (0.0, 0.0, 0.0))
    bench.set("birth", 0.0)
    t, seen = 0.0, []
    for _ in range(200):
        for h in (1.35, 1.47):
            bench.run("velocity-verlet", t, t + h, h, lanes=1)
            t += h
        seen.append(np.hypot(bench.get("x")[0, 0], bench.get("v")[0, 0]))
    assert (seen[-1] / seen[99]) ** (1 / 100) == pytest.approx(1.087, abs=5e-4)
    for h in (1.35, 1.47):
        assert sizes(benches, schemes.get("velocity-verlet"), 1j, h).max() < 2


@pytest.mark.parametrize("scheme", SCHEMES, **BY_NAME)
def test_slide32_is_refused_with_its_reason_where_it_may_destroy(scheme):
    check_fit(tp.Fixed(dt=0.1), "slide32-anyway", scheme)
    if scheme.one_step and 1 in scheme.system_orders:
        check_fit(tp.Fixed(dt=0.1), "slide32", scheme)
        return
    kind = "splitting" if scheme.one_step else "multistep scheme"
    message = rf"'slide32' .* make a {kind} such as '{scheme.name}' unstable .*Wright's effect"
    with pytest.raises(InputError, match=message):
        check_fit(tp.Fixed(dt=0.1), "slide32", scheme)
