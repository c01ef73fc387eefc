"""Groups that are alike: one kernel steps them, in one set of columns, and none of them sees the others."""

import numpy as np
import pytest
import taichi as ti
from small_scenes import WHITE, group, scene, simulate

import tparticles as tp

FLOW = tp.Vortex(circulation=2.0) + tp.CurlNoise(speed=0.8, octaves=2, period=0.7)
BREEZE = tp.Vortex(circulation=-1.0) + tp.CurlNoise(speed=0.3, octaves=3, period=1.1)
DISC = tp.Disc(radius=0.4)


def advected(name, flow, **options):
    return group(name, system=tp.Advected(flow=flow), shape=DISC, births=tp.Rate(rate=90.0), **options)


def thrown(name, time, **options):
    forces = (tp.Gravity(), tp.Drag(time=time, flow=FLOW))
    options |= {"shape": DISC, "births": tp.Rate(rate=70.0), "velocity": tp.Cone(angle=30.0, speed=(4.0, 1.0))}
    return group(name, system=tp.Newtonian(forces=forces), **options)


def sparks(name, time, **options):
    options |= {"appearance": tp.Glow(), "temperature": (1700.0, 200.0), "size": (0.002, 0.001)}
    return thrown(name, time, cooling=tp.Char(), **options)


# two that are alike, and one that is not: they differ in values, in what is stored beside the state, in how they die
FAMILIES = {
    "advected": (
        advected("a", FLOW, lifetime=(0.3, 0.1)),
        advected("b", BREEZE, region=tp.Box(low=(-0.5, -1, -1), high=(0.5, 1, 1))),
        advected("c", tp.Uniform(wind=(1.0, 0.0, 0.0)), lifetime=0.2),
    ),
    "newtonian": (
        thrown("a", 0.4, lifetime=(0.3, 0.1)),
        thrown("b", 0.1, preroll=0.2, lifetime=0.25),
        advected("c", FLOW),
    ),
    "heated": (sparks("a", 0.4, lifetime=(0.2, 0.1)), sparks("b", 0.2), thrown("c", 0.3)),
}
STEPS = {
    "rk4": {},
    "ab2": {"scheme": "ab2"},
    "backward-euler": {"scheme": "backward-euler"},
    "pixels": {"scheme": "dormand-prince", "steps": tp.PixelTolerance(px=0.5)},
    "pixels with a past": {"scheme": "abm5-pec", "steps": tp.PixelTolerance(px=0.5)},
}


def states(groups, count=8, **options):
    """Return the states of the groups after some frames, and the simulation."""
    simulation = simulate(scene(*groups, steps=options.pop("steps", tp.Fixed(dt=1 / 96)), **options))
    *_, last = simulation.frames(range(1, count + 1))
    return last.state(), simulation


def same(one, other):
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("kind", FAMILIES)
def test_a_group_is_the_same_with_its_like_and_alone(kind, steps):
    groups = FAMILIES[kind]
    together, simulation = states(groups, **STEPS[steps])
    first, second, third = (g.stepper for g in simulation.groups)
    assert first.compiled is second.compiled is first
    assert third.compiled is third
    assert any(own.population.died for own in simulation.groups)
    for g, own in zip(groups, simulation.groups, strict=True):
        assert set(own.columns.names) >= set(g.attributes(streaks=False))
        apart, _ = states([g], **STEPS[steps])
        assert same(apart[g.name], together[g.name])


def test_a_checkpoint_holds_each_of_them():
    groups = FAMILIES["advected"]
    whole, _ = states(groups, 12)
    _, simulation = states(groups, 6)
    kept = simulation.snapshot()
    assert "lifetime" in kept["group a"] and "lifetime" not in kept["group b"]
    resumed = simulate(simulation.scene)
    resumed.restore(kept)
    *_, last = resumed.frames(range(7, 13))
    assert all(same(last.state()[name], whole[name]) for name in whole)


class Gust(tp.Flow):
    """A law with a constant of the kernel, `axis`, and a number, `speed`."""

    def __init__(self, speed, axis):
        self.speed, self.axis = float(speed), axis

    def jacobian_bound(self):
        return tp.Bound()

    @ti.func
    def velocity(self, t, x):
        u = ti.Vector([0.0, 0.0, 0.0])
        u[ti.static(self.axis)] = self.speed
        return u


def test_constants_of_a_users_law_tell_groups_apart():
    gusts = {"slow": Gust(1, 0), "quick": Gust(2, 0), "up": Gust(1, 2)}
    groups = [group(name, system=tp.Advected(flow=flow), births=tp.Burst(count=3)) for name, flow in gusts.items()]
    found, simulation = states(groups)
    slow, quick, up = (g.stepper.compiled for g in simulation.groups)
    assert slow is quick and up is not slow
    np.testing.assert_allclose(found["slow"]["x"][:, 0] * 2, found["quick"]["x"][:, 0], rtol=1e-5)
    assert (found["up"]["x"][:, 2] > 0).all() and (found["up"]["x"][:, 0] == 0).all()


def test_many_particles_have_columns_of_their_own():
    groups = [
        tp.Group(
            name=name,
            system=tp.Advected(flow=FLOW),
            emitters=tp.Emitter(births=tp.Burst(count=70_000)),
            appearance=WHITE,
        )
        for name in "ab"
    ]
    _, simulation = states(groups, 1)
    assert [g.stepper.compiled is g.stepper for g in simulation.groups] == [True, True]
    assert all(g.columns.first == 0 for g in simulation.groups)
