"""Tiles: only where light may be is cleared and developed, and nobody can tell by the picture."""

import numpy as np
import pytest

from tparticles.backend import Backend
from tparticles.render import splat
from tparticles.render.film import Dots, Film
from tparticles.render.look import Look

# Neither is divisible by the size of a tile, of a block or of the dither matrix; the second is less than one tile.
SIZES = [(131, 71), (21, 5)]
TONES = ("linear", "reinhard", "filmic")


@pytest.fixture(scope="module", params=SIZES, ids=lambda size: "x".join(map(str, size)))
def film(request: pytest.FixtureRequest, cpu: Backend) -> Film:
    return Film(*request.param, capacity=1)


@pytest.fixture(scope="module")
def dots(cpu: Backend) -> Dots:
    return Dots(1 << 10)


def scatter(film: Film, dots: Dots, seed: int, n: int = 12) -> None:
    """Add small and wide dots and streaks, also beyond the borders."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(-4, film.width + 4, n), rng.uniform(-4, film.height + 4, n)
    kinds = {"sigma": rng.choice([0.4, 0.6, 1.5, 4.0], n), "energy": rng.uniform(-0.1, 1.0, (n, 3))}
    moving = rng.random(n) < 0.3
    film.add(dots, dots.upload(u, v, du=moving * rng.normal(0, 9, n), dv=moving * rng.normal(0, 9, n), **kinds))


def gradient(film: Film, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 0.1, (film.height, film.width, 3))


def developed_whole(film: Film, look: Look) -> np.ndarray:
    """Develop every tile of what is on the film: merging light says that it may be anywhere."""
    film.merge(np.zeros((film.height, film.width, 3), np.int64))
    return film.develop(*look.display_table(), dither=look.dither)


def test_clear_leaves_no_light_anywhere(film: Film, dots: Dots) -> None:
    for seed in range(30):
        scatter(film, dots, seed)
        assert film.sums().any()
        film.clear()
        assert not film.light.to_numpy().any()  # not in the padding either
        assert not film.bands.marks.to_numpy().any()


def test_merged_light_is_cleared_as_well(film: Film) -> None:
    film.clear()
    film.merge(np.ones((film.height, film.width, 3), np.int64))
    film.clear()
    assert not film.light.to_numpy().any()


@pytest.mark.parametrize("dither", [True, False])
@pytest.mark.parametrize("tone", TONES)
@pytest.mark.parametrize("lit", [True, False])
def test_developing_the_marked_tiles_is_developing_all(
    film: Film, dots: Dots, tone: str, dither: bool, lit: bool
) -> None:
    look = Look(tone=tone, dither=dither)  # pyright: ignore[reportArgumentType]
    film.set_background(gradient(film, 1) if lit else None)
    try:
        for seed in range(4):
            film.clear()
            scatter(film, dots, seed, n=2)
            image = film.develop(*look.display_table(), dither=dither)
            assert np.array_equal(image, developed_whole(film, look))
    finally:
        film.set_background(None)


def test_light_that_moves_on_leaves_no_trace(film: Film, dots: Dots) -> None:
    table, film_max = Look().display_table()
    film.set_background(gradient(film, 2))
    try:
        film.clear()
        empty = film.develop(table, film_max)
        scatter(film, dots, seed=3)
        assert not np.array_equal(film.develop(table, film_max), empty)
        film.clear()
        assert np.array_equal(film.develop(table, film_max), empty)
    finally:
        film.set_background(None)


def test_the_dark_part_follows_every_argument(film: Film) -> None:
    """One film is asked for one picture after the other; each is the same as when nothing is kept."""
    looks = [Look(), Look(dither=False), Look(tone="linear"), Look(white=2.0), Look()]
    try:
        for seed in (4, 5, None):
            film.set_background(None if seed is None else gradient(film, seed))
            for look in looks:
                for _first_and_later in range(3):  # the second picture of a look keeps its dark part
                    film.clear()
                    image = film.develop(*look.display_table(), dither=look.dither)
                    assert np.array_equal(image, developed_whole(film, look))
        table, film_max = Look().display_table()
        film.set_background(gradient(film, 4))
        film.clear()
        assert (film.develop(table, film_max) >= film.develop(table, 2 * film_max)).all()
        assert (film.develop(table, film_max) != film.develop(table, 2 * film_max)).any()
    finally:
        film.set_background(None)


def test_a_picture_may_be_painted_over(film: Film) -> None:
    table, film_max = Look().display_table()
    film.clear()
    film.develop(table, film_max)[:] = 77
    assert not film.develop(table, film_max).any()


def test_few_tiles_are_marked(cpu: Backend, dots: Dots) -> None:
    film = Film(640, 360, capacity=1)
    film.add(dots, dots.upload([100.0, 500.0], [100.0, 200.0], sigma=1.0, energy=[1.0, 1.0, 1.0]))
    marks = film.bands.marks.to_numpy()
    assert 2 <= marks.sum() <= 8
    assert marks.size == -(-360 // splat.BAND) * splat.tiles(640)
