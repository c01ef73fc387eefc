"""Births inside frames under schemes that look back at earlier steps: alone or in a crowd the same, and accurate from birth on."""

import itertools

import numpy as np
import pytest
from fused_bench import SCHEMES, Particles
from test_fused_accuracy import COUNT, Oscillator, Swelling, slope, steps_for

import tparticles as tp

pytestmark = pytest.mark.usefixtures("cpu64")

MULTISTEP = [s for s in SCHEMES if not s.one_step]
T0, T1, FRAMES = 0.5, 2.0, 3
by_scheme = pytest.mark.parametrize("scheme", MULTISTEP, ids=lambda s: s.name)


@pytest.fixture(scope="module")
def swelling(cpu64):
    return Particles(tp.Advected(flow=Swelling()), COUNT)


@pytest.fixture(scope="module")
def oscillator(cpu64):
    return Particles(tp.Newtonian(forces=Oscillator()), COUNT)


def bench_of(scheme, swelling, oscillator):
    return swelling if 1 in scheme.system_orders else oscillator


def advance(bench, scheme, state, birth, dt, *, frames=FRAMES):
    """Run frames from T0 to T1; a particle's past is what the run before left behind, as in a slot that is used again."""
    for name, values in zip(bench.system.state, state, strict=True):
        bench.set(name, values)
    bench.set("birth", birth)
    times = np.linspace(T0, T1, frames + 1)
    for a, b in itertools.pairwise(times):
        bench.run(scheme, a, b, dt, lanes=4)
    return np.concatenate([bench.get(name) for name in bench.system.state], axis=1)


@by_scheme
def test_a_newborn_is_at_the_same_place_whatever_the_others_do(swelling, oscillator, scheme):
    bench, rng = bench_of(scheme, swelling, oscillator), np.random.default_rng(9)
    state = [rng.uniform(0.5, 1.5, (COUNT, 3)) for _ in bench.system.state]
    # in the first frame and in later ones, on frame times and between them
    birth = rng.choice([T0, 1.0, *rng.uniform(T0, T1, 8)], COUNT)
    crowd = advance(bench, scheme, state, birth, 0.05)
    assert np.isfinite(crowd).all()
    order = rng.permutation(COUNT)
    assert np.array_equal(advance(bench, scheme, [z[order] for z in state], birth[order], 0.05), crowd[order])
    for i in (0, 17, COUNT - 1):
        others = [rng.uniform(0.5, 9.0, (COUNT, 3)) for _ in state]
        times = rng.uniform(T0, T1, COUNT)
        times[i] = birth[i]
        for mine, other in zip(state, others, strict=True):
            other[i] = mine[i]
        assert np.array_equal(advance(bench, scheme, others, times, 0.05)[i], crowd[i])


def born(bench, birth):
    """Return the state at birth of particles on one and the same path through t = T0 per slot, and where they are at T1."""
    c = np.linspace(0.5, 1.5, COUNT)
    if bench.system.order == 1:
        return [Swelling.solution(birth, c)], Swelling.solution(T1, c)
    law, x0, v0 = bench.system.forces[0], np.stack([c, -c, 1 - c], axis=1), np.stack([c, c, 0 * c], axis=1)
    h = 1e-4
    at = lambda t: law.solution(np.reshape(t, (-1, 1)), x0, v0)  # noqa: E731
    v = (8 * (at(birth + h) - at(birth - h)) - at(birth + 2 * h) + at(birth - 2 * h)) / (12 * h)
    return [at(birth), v], at(np.full(COUNT, T1))


@by_scheme
def test_the_order_is_kept_from_birth(swelling, oscillator, scheme):
    bench, birth = bench_of(scheme, swelling, oscillator), np.linspace(T0, T0 + 1.0, COUNT)
    state, exact = born(bench, birth)
    errors = []
    for n in steps_for(scheme):
        z = advance(bench, scheme, state, birth, 1.5 / n, frames=1)
        errors.append(np.sqrt(((z[:, :3] - exact) ** 2).mean()))
    # Births are off the grid of steps, so the steps of each are of a size of its own: the slope is a little rough.
    assert slope(errors, steps_for(scheme)) > scheme.order - 0.25, errors


def test_a_death_and_a_birth_in_its_slot_do_not_inherit_a_past(swelling):
    # The slot's earlier owner went on for other frames.
    rng = np.random.default_rng(1)
    x, birth = [rng.uniform(0.5, 1.5, (COUNT, 3))], rng.uniform(T0, T1, COUNT)
    first = advance(swelling, "ab4", x, birth, 0.05)
    advance(swelling, "ab4", [rng.uniform(2, 3, (COUNT, 3))], np.full(COUNT, T0), 0.013)
    assert np.array_equal(advance(swelling, "ab4", x, birth, 0.05), first)


@by_scheme
def test_steps_of_the_starter_are_counted(swelling, oscillator, scheme):
    """Two frames of 8 steps: a particle that is born in the middle of a step starts anew at the next frame, but for schemes that
    take steps of any size."""
    bench = bench_of(scheme, swelling, oscillator)
    for name in bench.system.state:
        bench.set(name, np.ones((COUNT, 3)))
    late = COUNT // 3
    bench.set("birth", np.where(np.arange(COUNT) < late, 0.045, 0.0))
    first, second = (bench.run(scheme, a, a + 0.8, 0.1, lanes=4) for a in (0.0, 0.8))
    back = scheme.steps_back
    assert (first.steps, second.steps) == (8 * COUNT, 8 * COUNT)
    assert first.starting == back * COUNT
    assert second.starting == (0 if scheme.variable_steps else back * late)
    assert second.evaluations(scheme) == (8 * COUNT - second.starting) * scheme.evaluations + (
        second.starting * scheme.starter.evaluations
    )
