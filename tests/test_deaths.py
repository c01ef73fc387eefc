"""Who dies, and when: of age, outside the region, too cold to glow; and the books of every frame."""

import dataclasses

import numpy as np
import pytest
from small_scenes import STILL, group, scene, simulate

import tparticles as tp
from tparticles.errors import RunError
from tparticles.systems.mortality import Mortality

BURST = tp.Burst(count=400, time=0.05)


def test_death_of_age():
    film = scene(group(births=BURST, lifetime=(0.5, 0.4)), duration=1.2)
    sim = simulate(film)
    people = sim.groups[0].population
    born = died = 0
    expected: dict[int, float] = {}
    for number in range(1, film.frame_count + 1):
        report = sim.advance_to(number)
        if number == 2:
            expected = dict(zip(people.read("id").tolist(), people.read("lifetime").tolist(), strict=True))
            assert len(expected) == 400 and min(expected.values()) > 0.1
        born, died = born + report.born, died + report.died
        assert report.alive == people.alive == born - died
        age = np.float32(report.time - 0.05)
        assert people.read("id").tolist() == [i for i, life in expected.items() if age < life], "order and set"
    assert (born, died, report.alive) == (400, 400, 0)


DRIFT = {"system": tp.Advected(flow=tp.Uniform(wind=(3.0, 0.0, 0.0))), "births": BURST, "shape": tp.Sphere(radius=1.0)}


@pytest.fixture(scope="module")
def drift():
    """Where everybody is in each frame if nobody dies, and in which order."""
    sim, found = simulate(scene(group(**DRIFT))), {}
    for number in range(2, 25):
        sim.advance_to(number)
        found[number] = sim.groups[0].population.read("x")
    return sim.groups[0].population.read("id"), found


@pytest.mark.parametrize("region", [tp.Box(low=(-9, -9, -9), high=(1.0, 9, 9)), tp.Sphere(radius=1.25)])
def test_death_by_leaving_the_region(region, drift):
    sim = simulate(scene(group(**DRIFT, region=region)))
    (ids, places), inside, left = drift, True, []
    for number in range(2, 25):
        report = sim.advance_to(number)
        x = places[number]
        inside = inside & (x[:, 0] <= 1.0 if isinstance(region, tp.Box) else (x**2).sum(axis=1) <= 1.25**2)
        assert np.array_equal(sim.groups[0].population.read("id"), ids[inside])
        assert report.alive == inside.sum()
        left.append(report.alive)
    assert left[0] > left[6] > 0 == left[-1]


LOOK = tp.Look(ev=6.0, dither=False)


def ember(ev=6.0, size=0.03, too_cold=True):
    """One ember at the centre of the middle pixel, on black, cooling; 65 x 37 pixels, 1 px is 10 cm."""
    return scene(
        group(
            appearance=tp.Glow(emissivity=0.8),
            births=tp.Burst(count=1),
            temperature=1500.0,
            size=size,
            cooling=tp.Exponential(time=1.0),
            too_cold=too_cold,
        ),
        look=dataclasses.replace(LOOK, ev=ev),
        camera=tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0), fov=40.0),
        size=(65, 37),
        duration=2.0,
    )


@pytest.fixture(scope="module")
def deaths():
    """Simulate embers: (ev, size) -> (first frame without it, T there, brightest film value by frame if nobody dies)."""
    found = {}
    for ev, size in ((6.0, 0.03), (9.0, 0.03), (6.0, 0.9)):
        sim = simulate(ember(ev, size))
        last = next((n for n in range(1, 49) if not sim.advance_to(n).alive), None)
        sim = simulate(ember(ev, size, too_cold=False))
        peaks, temperatures = {}, {}
        for frame in sim.frames((last - 1, last)):
            peaks[frame.number] = frame.linear().max()
            temperatures[frame.number] = float(frame.state()["dots"]["T"][0])
            steps = frame.image.max()
            assert steps <= 1
        found[ev, size] = last, temperatures[last], peaks, sim.scene.look.threshold()
    return found


def test_death_of_cold_is_where_it_stops_to_show(deaths):
    for (ev, size), (last, T, peaks, threshold) in deaths.items():
        # alive while its brightest pixel would show half a display step, dead when not
        assert peaks[last] < threshold <= peaks[last - 1] * 1.001, (ev, size, last, T)


def test_a_brighter_exposure_and_a_larger_dot_live_longer(deaths):
    assert deaths[9.0, 0.03][0] < deaths[6.0, 0.03][0] < deaths[6.0, 0.9][0]


def test_capacity_reckons_with_wide_dots():
    # The middle of a wide dot is twice as bright as its disc; births without pause until the first deaths and after.
    base = ember(size=2.0)
    emitter = dataclasses.replace(base.groups[0].emitters[0], births=tp.Rate(rate=2000.0))
    film = dataclasses.replace(base, groups=dataclasses.replace(base.groups[0], emitters=emitter), duration=3.0)
    sim = simulate(film)
    report = sim.advance_to(film.frame_count)
    assert report.died > 0
    assert report.alive <= sim.groups[0].columns.capacity < report.born


def test_nobody_dies_without_a_reason():
    film = scene(group(system=STILL, births=BURST))
    sim = simulate(film)
    assert sim.advance_to(24).died == 0
    assert sim.groups[0].mortality.dead is None, "no memory for marks that nobody sets"


@pytest.mark.parametrize("count", [1, 15, 16, 17, 5000])
def test_blocks_of_lanes_and_single_particles_get_the_same_verdicts(count):
    film = scene(
        group(
            births=tp.Burst(count=count),
            shape=tp.Sphere(radius=1.0),
            temperature=(1000.0, 300.0),
            size=(0.02, 0.01),
            lifetime=(0.5, 0.4),
            cooling=tp.Exponential(time=1.0),
            appearance=tp.Glow(),
            region=tp.Box(low=(-9.0, -9.0, -9.0), high=(0.8, 9.0, 9.0)),
        ),
        look=LOOK,
    )
    sim = simulate(film)
    (one,) = sim.groups
    one.population.emit(0.0, 1.0)
    found = []
    for vectorised in (False, True):
        mortality = Mortality(
            one.columns, one.view, region=film.groups[0].region, frost=one.projector, ages=True, vectorised=vectorised
        )
        died = mortality.mark(count, 0.3, sim._camera(0.3))
        lanes = sim.backend.lanes
        marks = mortality.dead.to_numpy()[:, None] >> np.arange(lanes) & 1
        assert died == marks.sum() == marks.ravel()[:count].sum()
        found.append(marks.ravel()[:count])
    assert np.array_equal(*found) and (count < 5000 or 1000 < found[0].sum() < 4000)
    one.columns["x"][1][count - 1] = np.nan
    for vectorised in (False, True):
        mortality = Mortality(one.columns, one.view, region=None, frost=None, ages=True, vectorised=vectorised)
        with pytest.raises(RunError, match=f"particle {count - 1}: its state is not finite"):
            mortality.mark(count, 0.3, sim._camera(0.3))
