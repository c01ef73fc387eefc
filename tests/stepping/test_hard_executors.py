"""Every scheme in both executors, on a system that both can run: particles, and a mesh of free vertices."""

import numpy as np
import pytest
import taichi as ti
from fused_bench import SCHEMES, Particles
from mesh_bench import FRAME, motion, run

import tparticles as tp
from tparticles.errors import InputError

pytestmark = pytest.mark.usefixtures("cpu64")

COUNT, FRAMES, STEPS = 20, 3, 4
GUST = 3.0  # [1/s], of the wind's phase
NEEDS_FREE = "velocity-free forces"


class Gust:
    """A wind that changes with time and place."""

    @ti.func
    def velocity(self, t, x):
        return ti.Vector([2.0 * ti.cos(GUST * t) + x[1] * x[2], x[2] - x[0] * x[1], ti.sin(x[0])])


class Well:
    """A pull towards the vertical axis that stiffens with the distance and swings with time."""

    velocity_free = True

    @ti.func
    def acceleration(self, t, x, v):
        r2 = x[0] * x[0] + x[1] * x[1]
        return -(5.0 + r2 + ti.cos(GUST * t)) * ti.Vector([x[0], x[1], 0.0])


DRAGGED = (tp.Gravity(), tp.Drag(time=0.2, flow=Gust()))
PULLED = (tp.Gravity(), Well())
# A mesh makes its one linear solve with the symmetric part of each vertex's Jacobian: here that is all of it.
SYMMETRIC = (*PULLED, tp.Drag(time=0.2, flow=tp.Uniform(wind=(1.0, 2.0, 0.0))))


def start():
    """Return where particles and vertices set out, x [m] and v [m/s], shape (2, n, 3)."""
    return np.random.default_rng(7).uniform(-1.0, 1.0, (2, COUNT, 3))


def free_vertices():
    """Return vertices without springs, of different masses: accelerations do not depend on them."""
    x, v = start()
    return tp.Mesh(x=x, v=v, mass=np.linspace(0.5, 3.0, COUNT))


def fused(bench, scheme):
    for name, values in zip(("x", "v"), start(), strict=True):
        bench.set(name, values)
    bench.set("birth", 0.0)
    for k in range(FRAMES):
        bench.run(scheme, k * FRAME, (k + 1) * FRAME, FRAME / STEPS)
    return np.stack([bench.get("x"), bench.get("v")])


def staged(scheme, forces):
    bench = motion(free_vertices(), scheme=scheme, dt=FRAME / STEPS, forces=forces)
    if scheme.implicit:
        bench.stepper.solver.tolerance = 1e-13  # of a metre; by default 1e-8 of a spring
    run(bench, FRAMES)
    return np.stack(bench.system.read())


@pytest.fixture(scope="module")
def particles(cpu64):
    return {forces: Particles(tp.Newtonian(forces=forces), COUNT) for forces in (DRAGGED, PULLED, SYMMETRIC)}


def forces_for(scheme):
    """Return forces that the scheme runs under either executor."""
    if NEEDS_FREE in scheme.needs:
        return PULLED
    return SYMMETRIC if any(op.linear for op in scheme.ops) else DRAGGED


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_fused_and_staged_give_the_same_result(particles, scheme):
    forces = forces_for(scheme)
    ours, theirs = fused(particles[forces], scheme), staged(scheme, forces)
    assert np.abs(ours - start()).max() > 0.1
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-7 if scheme.implicit else 1e-14)


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if NEEDS_FREE in s.needs], ids=lambda s: s.name)
def test_both_refuse_drag_under_a_scheme_that_needs_forces_without_velocity(scheme):
    particles = tp.Group(
        name="dots",
        system=tp.Newtonian(forces=DRAGGED),
        emitters=tp.Emitter(births=tp.Burst(count=COUNT)),
        appearance=tp.Ramp(colors=((1.0, 1.0, 1.0),), span=1.0),
    )
    vertices = tp.MeshGroup(name="mesh", mesh=free_vertices(), forces=DRAGGED)
    camera = tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0))
    for group in (particles, vertices):
        why = f"scheme '{scheme.name}' cannot run group '{group.name}': .*do not depend on the velocity"
        with pytest.raises(InputError, match=why):
            tp.Scene(groups=group, camera=camera, duration=1.0, scheme=scheme)
