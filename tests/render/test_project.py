"""Particles on the film: where a dot lands, how much light it brings, and when it is too cold to show."""

import math

import numpy as np
import pytest
from PIL import Image

import tparticles as tp
from tparticles.render.appearance import Gradient, Picture, Ramp, film_background
from tparticles.render.blackbody import BlackbodyTable
from tparticles.render.look import Look, srgb_decode

CAMERA = tp.Camera(position=(0.4, -5.0, 0.8), target=(0.0, 0.0, 0.5), fov=38.0)
SIZE = (200, 120)
LOOK = Look(ev=3.0)
FPS = 24


def film_of(*, at=(0.0, 0.0, 0.5), size=0.02, T=1400.0, wind=(0.0, 0.0, 0.0), shutter=0.0, appearance=None, **options):
    """Return (linear film, simulation) of one particle born at time 0, drawn at the first frame."""
    appearance = appearance or tp.Glow()
    glows = appearance.uses_temperature
    group = tp.Group(
        name="one",
        system=tp.Advected(flow=tp.Uniform(wind=wind)),
        emitters=tp.Emitter(
            births=tp.Burst(count=1, time=options.pop("born", 0.0)),
            shape=tp.Point(position=at),
            size=size,
            temperature=T if glows else None,
        ),
        appearance=appearance,
        **options,
    )
    scene = tp.Scene(groups=group, camera=CAMERA, look=LOOK, duration=0.5, fps=FPS, shutter=shutter)
    simulation = tp.Simulation(scene, size=SIZE, arch="cpu", threads=2)
    return next(iter(simulation.frames([1]))).linear(), simulation


def expected_energy(at, size, T):
    """Radiance times exposure times the disc's area on the film [film value px^2], in float64."""
    _, _, depth = CAMERA.pose(1 / FPS).project(np.array([at]), *SIZE)
    diameter = size * CAMERA.pose(0.0).focal(SIZE[1]) / depth[0]
    table = BlackbodyTable.build(adaptation=LOOK.adaptation())
    return LOOK.exposure * table.lookup(np.array(T)) * math.pi / 4 * diameter**2


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.5), (0.9, 1.5, 0.2), (-0.7, -1.0, 1.0)])
def test_a_dot_lands_where_the_camera_sees_it_with_the_light_of_its_disc(at):
    film, _ = film_of(at=at, size=0.03)
    u, v, _ = CAMERA.pose(1 / FPS).project(np.array([at]), *SIZE)
    red = film[..., 0]
    rows, columns = np.indices(red.shape) + 0.5
    assert abs((red * columns).sum() / red.sum() - u[0]) < 5e-3
    assert abs((red * rows).sum() / red.sum() - v[0]) < 5e-3
    assert film.sum(axis=(0, 1)) == pytest.approx(expected_energy(at, 0.03, 1400.0), rel=1e-3, abs=1e-5)


def test_a_streak_has_the_light_of_the_dot_and_the_length_of_the_path():
    dot, _ = film_of(born=-0.0)
    streak, _ = film_of(wind=(60.0, 0.0, 0.0), at=(-1.2, 0.0, 0.5), shutter=0.5)
    assert streak.sum() == pytest.approx(dot.sum(), rel=0.1)  # the disc is a little farther from the camera
    lit = np.flatnonzero(streak[..., 0].sum(axis=0) > 0.02 * streak[..., 0].sum(axis=0).max())
    length = lit[-1] - lit[0]
    on_film = 60.0 * 0.5 / FPS * CAMERA.pose(0.0).focal(SIZE[1]) / 5.0
    assert abs(length - on_film) < 5
    column = streak[..., 0].sum(axis=0)[lit[4] : lit[-4]]
    assert column.max() / column.min() < 1.06  # evenly along the path


def test_born_with_the_shutter_open_it_brings_light_in_proportion():
    whole, _ = film_of(shutter=0.5)
    late, _ = film_of(shutter=0.5, born=1 / FPS - 0.125 / FPS)  # open for 0.5 / 24 s, alive for a quarter of that
    assert late.sum() == pytest.approx(0.25 * whole.sum(), rel=1e-3)


def test_behind_the_camera_nothing_is_drawn():
    film, _ = film_of(at=(0.4, -7.0, 0.8))
    assert not film.any()


@pytest.mark.parametrize(("size", "depth"), [(0.002, 0.0), (0.002, 8.0), (0.02, 0.0), (0.3, 2.0)])
def test_too_cold_means_the_brightest_pixel_stays_below_half_a_display_step(size, depth):
    """The kill temperature of the kernel, bisected, against the brightest pixel of films drawn around it."""
    at = (0.4, depth, 0.8)
    group = tp.Group(
        name="many",
        system=tp.Advected(flow=tp.Uniform()),
        emitters=tp.Emitter(
            births=tp.Burst(count=3000),
            shape=tp.Point(position=at),
            size=size,
            temperature=tp.Spread(mean=1500.0, variance=900.0),
        ),
        cooling=tp.Exponential(time=1e9),
    )
    scene = tp.Scene(groups=group, camera=CAMERA, look=LOOK, duration=0.5, fps=FPS)
    simulation = tp.Simulation(scene, size=SIZE, arch="cpu", threads=2)
    coldest = float(next(iter(simulation.frames([1]))).state()["many"]["T"].min())
    # half a display step, for a dot centred on a pixel: the brightest that it can be
    share = LOOK.exposure * brightest_share(size, at)
    table = BlackbodyTable.build(adaptation=LOOK.adaptation())
    dimmer, brighter = share * table.lookup(np.array([coldest - 6.0, coldest + 1.0])).max(axis=1)
    assert dimmer < LOOK.threshold() < brighter
    film, _ = film_of(at=at, size=size, T=coldest - 6.0)
    assert film.max() < LOOK.threshold() * 1.02


def brightest_share(size, at):
    """Return the film value of a centred dot's middle pixel for unit colour, by direct summation in float64."""
    _, _, depth = CAMERA.pose(0.0).project(np.array([at]), *SIZE)
    diameter = size * CAMERA.pose(0.0).focal(SIZE[1]) / depth[0]
    sigma = math.sqrt(0.55**2 + diameter**2 / 16)
    taps = np.exp(-0.5 * (np.arange(-200, 201) / sigma) ** 2)
    return math.pi / 4 * diameter**2 / taps.sum() ** 2


def test_a_brighter_exposure_kills_later():
    def coldest(ev):
        group = tp.Group(
            name="one",
            system=tp.Advected(flow=tp.Uniform()),
            emitters=tp.Emitter(
                births=tp.Burst(count=400), temperature=tp.Spread(mean=900.0, variance=300.0), size=0.02
            ),
            cooling=tp.Exponential(time=1e9),
        )
        scene = tp.Scene(groups=group, camera=CAMERA, look=Look(ev=ev), duration=0.5)
        simulation = tp.Simulation(scene, size=SIZE, arch="cpu", threads=2)
        return next(iter(simulation.frames([1]))).state()["one"]["T"].min()

    assert coldest(0.0) + 50 < coldest(4.0)


def test_a_ramp_goes_through_its_colours_with_age():
    colors = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    film, _ = film_of(appearance=Ramp(colors=colors, span=2 / FPS, brightness=1.0))  # age 1/24 s: half of the span
    total = film.sum(axis=(0, 1))
    assert total / total[1] == pytest.approx([0, 1, 0], abs=1e-3)
    film, _ = film_of(appearance=Ramp(colors=colors, span=4 / FPS))  # a quarter: half red, half green, in linear light
    total = film.sum(axis=(0, 1))
    assert total / total[0] == pytest.approx([1, 1, 0], abs=1e-3)


def test_growth_and_fades():
    plain, _ = film_of(size=0.02)
    grown, _ = film_of(size=0.02, appearance=tp.Glow(growth=0.02 * FPS))  # twice the diameter after a frame
    assert grown.sum() == pytest.approx(4 * plain.sum(), rel=1e-3)


@pytest.mark.parametrize("tone", ["linear", "reinhard", "filmic"])
def test_a_background_is_shown_in_its_own_colours(tone, tmp_path, cpu32):
    look = Look(tone=tone, dither=False)
    gradient = Gradient(top=(0.02, 0.1, 0.3), bottom=(0.9, 0.5, 0.2))
    wanted = gradient.picture(32, 48)
    assert 255 * look.encode(film_background(gradient, look, 32, 48)) == pytest.approx(255 * wanted, abs=0.05)
    assert wanted[0, 0] == pytest.approx((0.02, 0.1, 0.3), abs=0.02) and np.all(np.diff(wanted[:, 0, 0]) > 0)
    path = tmp_path / "sky.png"
    Image.new("RGB", (64, 96), (10, 20, 200)).save(path)
    shown = 255 * look.encode(film_background(Picture(path=str(path)), look, 32, 48))
    assert shown == pytest.approx(np.broadcast_to((10.0, 20.0, 200.0), shown.shape), abs=0.05)


def test_ramp_stops_are_linear_light():
    assert srgb_decode(0.5) == pytest.approx(0.2140, abs=1e-4)
