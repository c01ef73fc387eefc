"""Sparks with response times from 0.1 s to 1 us at steps of 1/24 s: right or refused, never drawn wrong. f64 and f32."""

import numpy as np
import pytest
import taichi as ti
from fused_bench import SCHEMES, Particles
from small_scenes import group, scene, simulate

import tparticles as tp
from tparticles import backend, schemes
from tparticles.errors import InputError, RunError
from tparticles.stepping.control import Fixed, StabilityLimit, frame_step

FRAME = 1 / 24
TIMES = np.array([1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6])  # response times [s]
WIND, G = np.array([2.0, 0.0, 4.0]), np.array([0.0, 0.0, -9.81])
EXPLICIT = [s for s in SCHEMES if not s.implicit]
EXACT = {"f64": 1e-9, "f32": 2e-5}


class Sparks:
    """Drag towards an updraught, and gravity; the response time is 10^y: a particle's own."""

    @ti.func
    def acceleration(self, t, x, v):
        rate = ti.exp(-2.302585092994046 * x[1])
        return ti.Vector([(2.0 - v[0]) * rate, 0.0, (4.0 - v[2]) * rate - 9.81])


@pytest.fixture(scope="module", params=["f64", "f32"])
def precision(request):
    backend.stop()
    return backend.start(arch="cpu", threads=2, precision=request.param).precision


@pytest.fixture(scope="module")
def sparks(precision):
    return Particles(tp.Newtonian(forces=Sparks()), len(TIMES))


def launch(bench, times=TIMES):
    bench.set("x", np.stack([0 * TIMES, np.broadcast_to(np.log10(times), TIMES.shape), 0 * TIMES], axis=1))
    bench.set("v", (-3.0, 0.0, -5.0))
    bench.set("birth", 0.0)


def terminal(times):
    return WIND + np.multiply.outer(times, G)


@pytest.mark.parametrize("name", ["backward-euler", "semi-implicit-euler", "bdf2", "sdirk2", "sdirk3", "tr-bdf2"])
def test_l_stable_schemes_reach_the_terminal_velocity(sparks, precision, name):
    launch(sparks)
    for frame in range(72):
        sparks.run(name, frame * FRAME, (frame + 1) * FRAME, FRAME, lanes=1)
    np.testing.assert_allclose(sparks.get("v"), terminal(TIMES), rtol=EXACT[precision], atol=EXACT[precision])


def test_the_trapezoidal_rule_still_rings(sparks):
    launch(sparks)
    for frame in range(24):
        sparks.run("trapezoidal", frame * FRAME, (frame + 1) * FRAME, FRAME, lanes=1)
    off = np.abs(sparks.get("v") - terminal(TIMES)).max(axis=1)
    z = FRAME / TIMES
    np.testing.assert_allclose(off[2:], 9 * np.abs((1 - z / 2) / (1 + z / 2))[2:] ** 24, rtol=2e-2)
    assert off[-1] > 8.9


@pytest.mark.parametrize("time", TIMES)
@pytest.mark.parametrize("name", ["euler", "rk4"])
def test_stability_limit_reaches_the_terminal_velocity(sparks, precision, name, time):
    launch(sparks, time)
    bound = tp.Drag(time=time).jacobian_bound()
    dt = frame_step(StabilityLimit(), scheme=schemes.get(name), bound=bound, frame=FRAME)
    assert dt <= schemes.get(name).real_limit * time
    frames = {1e-1: 72, 1e-2: 72, 1e-3: 12}.get(time, 2)
    for frame in range(frames):
        sparks.run(name, frame * FRAME, (frame + 1) * FRAME, dt, lanes=1)
    np.testing.assert_allclose(
        sparks.get("v"), np.tile(terminal(time), (len(TIMES), 1)), rtol=EXACT[precision], atol=EXACT[precision]
    )


@pytest.mark.parametrize("time", TIMES)
@pytest.mark.parametrize("scheme", EXPLICIT, ids=lambda s: s.name)
def test_explicit_fixed_steps_that_cannot_are_refused(scheme, time):
    system = tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=time, flow=tp.Plume())))
    options = {"scheme": scheme, "bound": None, "frame": FRAME, "damping": system.damping}
    if scheme.real_limit * time >= FRAME:
        assert frame_step(Fixed(dt=FRAME), **options) == FRAME
        return
    message = (
        rf"steps of 0\.0417 s are unstable: .* '{scheme.name}' needs dt < .*StabilityLimit\(\), or an implicit scheme"
    )
    with pytest.raises(InputError, match=message):
        frame_step(Fixed(dt=FRAME), **options)


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if s.implicit], ids=lambda s: s.name)
def test_implicit_fixed_steps_are_not_refused(scheme):
    assert frame_step(Fixed(dt=FRAME), scheme=scheme, bound=None, frame=FRAME, damping=1e6) == FRAME


def test_light_sparks_move_with_the_plume(precision):
    # v = u(x) + time (g - du/dt): to a part in 1e5 the flow's velocity
    plume, time = tp.Plume(), 1e-6
    bench = Particles(tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=time, flow=plume))), 6)
    tracer = Particles(tp.Advected(flow=plume), 6, names=("v",))
    bench.set("x", [(0.1 * i, 0.02, 0.1 + 0.2 * i) for i in range(6)])
    bench.set("v", (3.0, -3.0, 3.0))
    for frame in range(8):
        bench.run("tr-bdf2", frame * FRAME, (frame + 1) * FRAME, FRAME, lanes=1)
    tracer.set("x", bench.get("x"))
    tracer.run("euler", 0.0, 0.0, FRAME, lanes=1)  # no time passes: what the flow is here
    assert np.linalg.norm(tracer.get("v"), axis=1).max() > 1
    np.testing.assert_allclose(bench.get("v"), tracer.get("v"), atol=1e-3 if precision == "f64" else 5e-3)


class Hidden:
    """Drag that does not say how fast it relaxes."""

    @ti.func
    def acceleration(self, t, x, v):
        return -1e6 * v


def film(force):
    return scene(group(system=tp.Newtonian(forces=force), velocity=tp.Cone(speed=3.0)), steps=Fixed(dt=FRAME))


def test_a_scene_that_cannot_is_refused_before_its_first_frame():
    with pytest.raises(InputError, match=r"steps of 0\.0417 s are unstable: velocities relax at 1e\+06 /s"):
        simulate(film(tp.Drag(time=1e-6, flow=tp.Plume())))


def test_a_law_that_hides_its_rate_ends_in_a_named_error():
    drawn = []
    with pytest.raises(RunError, match=r"frame \d+, group 'dots': particle 0: its state is not finite or more than"):
        drawn.extend(frame.report.frame for frame in simulate(film(Hidden())).frames())
    assert drawn in ([], [1])  # after one step it may be too far to be seen, but not yet too far to be true
