"""The film: what a dot and a streak leave on it, that the sums are exact, and how they become pixels."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tparticles.backend import Backend
from tparticles.errors import InputError
from tparticles.render import splat
from tparticles.render.film import Dots, Film, _Pieces
from tparticles.render.look import Look, bayer

WIDTH, HEIGHT = 96, 80
# Largest error of a streak against the exact time average, relative to its brightest pixel; measured 0.0035.
STREAK_ERROR = 0.004


@pytest.fixture(scope="module")
def film(cpu: Backend) -> Film:
    return Film(WIDTH, HEIGHT, capacity=1)


@pytest.fixture(scope="module")
def dots(film: Film) -> Dots:
    return Dots(1 << 14)


def drawn(film: Film, dots: Dots, u: object, v: object, **kinds: object) -> np.ndarray:
    count = dots.upload(u, v, **kinds)  # pyright: ignore[reportArgumentType]
    film.clear()
    film.add(dots, count)
    return film.sums()


def weights(p: np.ndarray, sigma: float, size: int) -> np.ndarray:
    """Float64 twin of one axis: weights of dots at positions p [px], shape (len(p), size)."""
    R = max(2, int(np.ceil(3 * sigma)))
    centre = np.floor(np.asarray(p, dtype=np.float64))[:, None]
    k = np.arange(-R, R + 1)
    w = np.exp(-0.5 * ((centre + k + 0.5 - np.asarray(p)[:, None]) / sigma) ** 2)
    w /= w.sum(axis=1, keepdims=True)
    out = np.zeros((len(w), size + 2 * R + 1))
    column = (centre + k).astype(int)
    inside = (column >= 0) & (column < size)
    np.put_along_axis(out, np.where(inside, column, size + k + R), w, axis=1)
    return out[:, :size]


def exact(u: float, v: float, sigma: float, du: float = 0.0, dv: float = 0.0, *, nodes: int = 1000) -> np.ndarray:
    """Float64 average of a dot along its path, for energy 1, shape (HEIGHT, WIDTH)."""
    s = (np.arange(nodes) + 0.5) / nodes if du or dv else np.zeros(1)
    u, v, du, dv, sigma = (float(np.float32(x)) for x in (u, v, du, dv, sigma))
    return weights(v + s * dv, sigma, HEIGHT).T @ weights(u + s * du, sigma, WIDTH) / len(s)


@pytest.mark.parametrize("sigma", [0.3, 0.5, 0.66, 0.7, 1.0, 1.9, 3.0, 8.0])
def test_dot_matches_float64(film: Film, dots: Dots, sigma: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(8):
        u, v = rng.uniform((10, 10), (WIDTH - 10, HEIGHT - 10))
        energy = np.array([1.0, 300.0, -0.25])
        got = drawn(film, dots, [u], [v], sigma=sigma, energy=energy) * splat.QUANTUM
        assert np.abs(got - exact(u, v, sigma)[..., None] * energy).max(axis=(0, 1)) == pytest.approx(
            0, abs=splat.QUANTUM + 300 * 4e-7
        )


@pytest.mark.parametrize("sigma", [0.3, 0.55, 1.2, 4.0, 12.0])
@pytest.mark.parametrize("length", [0.0, 0.7, 20.0])
def test_energy_is_conserved(film: Film, dots: Dots, sigma: float, length: float) -> None:
    rng = np.random.default_rng(1)
    for angle in rng.uniform(0, 2 * np.pi, 6):
        du, dv = length * np.cos(angle), length * np.sin(angle)
        u, v = np.array([WIDTH, HEIGHT]) / 2 + rng.uniform(-0.5, 0.5, 2) - (du / 2, dv / 2)
        energy = 1e4
        got = drawn(film, dots, [u], [v], sigma=sigma, energy=[energy] * 3, du=du, dv=dv).sum(axis=(0, 1))
        if 3 * sigma + length / 2 < HEIGHT / 2 - 1:
            assert got * splat.QUANTUM == pytest.approx(energy, rel=1e-5)


@pytest.mark.parametrize("sigma", [0.5, 0.8, 1.5, 3.0])
@pytest.mark.parametrize("length", [0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 45.0])
def test_streak_is_the_time_average(film: Film, dots: Dots, sigma: float, length: float) -> None:
    for angle in np.linspace(0, 2 * np.pi, 9):
        du, dv = length * np.cos(angle), length * np.sin(angle)
        u, v = 48.3 - du / 2, 40.6 - dv / 2
        got = drawn(film, dots, [u], [v], sigma=sigma, energy=[1e3] * 3, du=du, dv=dv)[..., 0] * splat.QUANTUM / 1e3
        want = exact(u, v, sigma, du, dv)
        assert np.abs(got - want).max() < STREAK_ERROR * want.max()


def test_streak_ends_may_be_swapped(film: Film, dots: Dots) -> None:
    a = drawn(film, dots, [20.25], [30.5], sigma=0.75, energy=[1] * 3, du=[32.5], dv=[-8.25])
    b = drawn(film, dots, [52.75], [22.25], sigma=0.75, energy=[1] * 3, du=[-32.5], dv=[8.25])
    assert np.abs(a - b).max() <= 20


def test_streak_without_length_is_the_dot(film: Film, dots: Dots) -> None:
    kinds = {"sigma": 0.9, "energy": [3.0, 2.0, 1.0]}
    dot = drawn(film, dots, [40.3], [31.8], **kinds)
    assert np.array_equal(dot, drawn(film, dots, [40.3], [31.8], du=[0.0], dv=[-0.0], **kinds))


@pytest.mark.parametrize("sigma", [0.5, 2.5])
def test_mirrored_dots_mirror_the_film(film: Film, dots: Dots, sigma: float) -> None:
    u, v = 40.3125, 31.8125
    kinds = {"sigma": sigma, "energy": [1.0, 1.0, 1.0]}
    image = drawn(film, dots, [u], [v], **kinds)
    assert np.abs(image - drawn(film, dots, [WIDTH - u], [v], **kinds)[:, ::-1]).max() <= 4
    assert np.abs(image - drawn(film, dots, [u], [HEIGHT - v], **kinds)[::-1]).max() <= 4


def test_partly_visible_dots_match_a_larger_film(film: Film, dots: Dots) -> None:
    wide = Film(WIDTH + 64, HEIGHT + 64, capacity=1)
    rng = np.random.default_rng(2)
    n = 4000
    # Multiples of 1/64: the shift by 32 pixels is exact in f32.
    u = np.round(rng.uniform(-30, WIDTH + 30, n) * 64) / 64
    v = np.round(rng.uniform(-30, HEIGHT + 30, n) * 64) / 64
    kinds = {
        "sigma": rng.choice([0.4, 0.6, 1.0, 2.0, 5.0, 11.0], n),
        "energy": rng.uniform(0, 0.01, (n, 3)),
        "du": np.where(rng.random(n) < 0.5, 0, np.round(rng.normal(0, 20, n))),
        "dv": np.where(rng.random(n) < 0.5, 0, np.round(rng.normal(0, 20, n))),
    }
    near = drawn(film, dots, u, v, **kinds)
    far = drawn(wide, dots, u + 32, v + 32, **kinds)[32:-32, 32:-32]
    assert near.any()
    assert np.abs(near - far).max() <= 200  # a few roundings of positions in each of some hundred streak dots


def test_invisible_and_broken_dots_draw_nothing(film: Film, dots: Dots) -> None:
    bad = [np.nan, np.inf, -np.inf, 3e38]
    good = {"u": 40.0, "v": 40.0, "sigma": 1.0, "du": 0.0, "dv": 0.0, "r": 1.0}
    rows = [{**good, name: value} for name in good for value in bad[: 3 if name in ("sigma", "r") else 4]]
    rows += [{**good, "sigma": 0.0}, {**good, "sigma": -1.0}]
    rows += [{**good, "u": x} for x in (-4.0, WIDTH + 4.0, -1e6, 1e7)]
    rows += [{**good, "v": y} for y in (-4.0, HEIGHT + 4.0, -1e6, 1e7)]
    column = {name: np.array([row[name] for row in rows]) for name in good}
    energy = np.stack([column.pop("r"), np.ones(len(rows)), np.ones(len(rows))], axis=1)
    with np.errstate(over="ignore"):
        assert not drawn(film, dots, column.pop("u"), column.pop("v"), energy=energy, **column).any()


def test_huge_values_stay_in_their_limits(film: Film, dots: Dots) -> None:
    got = drawn(film, dots, [40.5], [40.5], sigma=0.5, energy=[3e38, -3e38, 0.0])
    assert got.sum(axis=(0, 1)) * splat.QUANTUM == pytest.approx([splat.ENERGY_MAX, -splat.ENERGY_MAX, 0.0], rel=1e-5)
    assert drawn(film, dots, [40.5], [40.5], sigma=1e6, energy=[1e9] * 3).min() > 0


def test_giant_streaks_are_quick_and_right(film: Film, dots: Dots) -> None:
    start = time.perf_counter()
    got = drawn(film, dots, [-5e6] * 50, [40.5] * 50, sigma=0.5, energy=[1e6] * 3, du=1e7) * splat.QUANTUM
    drawn(film, dots, [-9e5] * 50, [-8e5] * 50, sigma=200.0, energy=[1e6] * 3, du=2e6, dv=1.7e6)
    assert time.perf_counter() - start < 10.0
    # 50 streaks of 1e6 / 1e7 per pixel of length; positions of f32 are 0.5 px apart out there
    assert got[:, 5:-5].sum(axis=0) == pytest.approx(5.0, rel=0.2)
    assert not got[:37].any() and not got[44:].any()


@pytest.fixture(scope="module")
def crowd() -> dict[str, np.ndarray]:
    """Dots and streaks of all kinds; a third of them touches every band, so that the lists need several rounds."""
    rng = np.random.default_rng(3)
    n = 1 << 14
    tall = rng.random(n) < 0.33
    return {
        "u": rng.uniform(-5, WIDTH + 5, n),
        "v": np.where(tall, -3.0, rng.uniform(-5, HEIGHT + 5, n)),
        "sigma": rng.choice([0.4, 0.6, 1.2, 3.0], n),
        "energy": rng.uniform(-0.1, 1.0, (n, 3)),
        "du": rng.normal(0, 3, n) * (rng.random(n) < 0.3),
        "dv": np.where(tall, HEIGHT + 6.0, 0.0),
    }


def test_sums_depend_on_no_order_and_no_split(film: Film, dots: Dots, crowd: dict[str, np.ndarray]) -> None:
    n = len(crowd["u"])
    whole = drawn(film, dots, **crowd)
    order = np.random.default_rng(4).permutation(n)
    assert np.array_equal(whole, drawn(film, dots, **{name: x[order] for name, x in crowd.items()}))
    film.clear()
    for part in np.array_split(order, 5):
        film.add(dots, dots.upload(**{name: x[part] for name, x in crowd.items()}))
    assert np.array_equal(whole, film.sums())


def test_merged_shards_are_the_whole(film: Film, dots: Dots, crowd: dict[str, np.ndarray]) -> None:
    whole = drawn(film, dots, **crowd)
    half = drawn(film, dots, **{name: x[::2] for name, x in crowd.items()})
    drawn(film, dots, **{name: x[1::2] for name, x in crowd.items()})
    film.merge(half)
    assert np.array_equal(whole, film.sums())
    assert np.array_equal(film.linear(), whole / 2**24)
    with pytest.raises(InputError, match="cannot be merged"):
        film.merge(half[1:])


ELSEWHERE = """
import sys, numpy as np
from tparticles import backend
from tparticles.errors import BackendError
arch, threads, precision, out = sys.argv[1:]
try:
    backend.start(arch=arch, threads=int(threads), precision=precision)
except BackendError as error:
    sys.exit(str(error))
from tparticles.render.film import Dots, Film
film, dots = Film(200, 150), Dots(20000)
rng = np.random.default_rng(5)
n = 20000
length = np.where(rng.random(n) < 0.1, 20.0, 0.0)
count = dots.upload(rng.uniform(-5, 205, n), rng.uniform(-5, 155, n), sigma=rng.choice([0.4, 0.6, 1.5, 4.0], n),
                    energy=rng.uniform(-0.01, 0.1, (n, 3)), du=length * rng.normal(0, 1, n), dv=length * rng.normal(0, 1, n))
film.add(dots, count)
film.set_background(np.full((150, 200, 3), 0.25))
np.savez(out, sums=film.sums(), image=film.develop(np.linspace(0, 255, 500), 1.0))
"""


def draw_elsewhere(
    out: Path, *, arch: str = "cpu", threads: int = 2, precision: str = "f32"
) -> tuple[np.ndarray, np.ndarray]:
    command = [sys.executable, "-c", ELSEWHERE, arch, str(threads), precision, str(out)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=Path(__file__).parents[2])
    if result.returncode == 1 and "is not available" in result.stderr:
        pytest.skip(result.stderr.strip().splitlines()[-1])
    assert result.returncode == 0, result.stderr
    with np.load(out) as arrays:
        return arrays["sums"], arrays["image"]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> tuple[np.ndarray, np.ndarray]:
    return draw_elsewhere(tmp_path_factory.mktemp("film") / "two.npz")


def test_one_thread_draws_the_same_bits(tmp_path: Path, reference: tuple[np.ndarray, np.ndarray]) -> None:
    sums, image = draw_elsewhere(tmp_path / "one.npz", threads=1)
    assert reference[0].any()
    assert np.array_equal(sums, reference[0])
    assert np.array_equal(image, reference[1])


def test_pieces_of_the_gpu_path_are_the_bands(film: Film, dots: Dots, crowd: dict[str, np.ndarray]) -> None:
    bands = drawn(film, dots, **crowd)
    film.pieces = _Pieces()
    try:
        pieces = drawn(film, dots, **crowd)
    finally:
        film.pieces = None
    assert np.abs(bands - pieces).max() <= 64  # last bits of f32 in a few of the dots that overlap


def test_gpu_path_draws_the_same(tmp_path: Path, reference: tuple[np.ndarray, np.ndarray]) -> None:
    """Same arithmetic, but a GPU contracts multiply and add in other places: last bits of f32 differ, hence quanta."""
    sums, image = draw_elsewhere(tmp_path / "gpu.npz", arch="vulkan")
    assert np.abs(sums - reference[0]).max() <= 64
    assert np.abs(image.astype(int) - reference[1]).max() <= 1
    assert (image != reference[1]).mean() < 1e-3


def test_f64_backend_draws_the_same(tmp_path: Path, reference: tuple[np.ndarray, np.ndarray]) -> None:
    sums, _ = draw_elsewhere(tmp_path / "f64.npz", precision="f64")
    assert np.abs(sums - reference[0]).max() <= 64


def develop_twin(linear: np.ndarray, table: np.ndarray, film_max: float, dither: bool) -> tuple[np.ndarray, np.ndarray]:
    """NumPy twin in float64: the picture, and how far each value is from the next rounding border [display steps]."""
    s = np.sqrt(np.clip(linear / film_max, 0, 1)) * (len(table) - 1)
    code = np.interp(s, np.arange(len(table)), table)
    height, width = linear.shape[:2]
    d = np.tile(bayer(), (height // 8 + 1, width // 8 + 1))[:height, :width, None] if dither else 0.0
    level = code + 0.5 + d
    return np.clip(np.floor(level), 0, 255).astype(np.uint8), np.abs(level - np.round(level))


@pytest.mark.parametrize("dither", [True, False])
@pytest.mark.parametrize("columns", [0, 1, WIDTH])
def test_develop_matches_its_twin(
    film: Film, dots: Dots, crowd: dict[str, np.ndarray], dither: bool, columns: int
) -> None:
    table, film_max = Look().display_table()
    background = np.random.default_rng(6).uniform(-0.2, 1.0, (HEIGHT, columns, 3)).astype(np.float32)
    sums = drawn(film, dots, **{**crowd, "energy": crowd["energy"] * 0.02})
    film.set_background(background if columns else None)
    try:
        image = film.develop(table, film_max, dither=dither)
    finally:
        film.set_background(None)
    want, margin = develop_twin(sums * splat.QUANTUM + (background if columns else 0.0), table, film_max, dither)
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
    assert len(np.unique(image)) > 30
    # f32 against float64: equal but for values within 1e-3 of a rounding border
    assert np.array_equal(image[margin > 1e-3], want[margin > 1e-3])
    assert (image == want).mean() > 0.999


def test_black_stays_black_and_white_stays_white(film: Film, dots: Dots) -> None:
    table, film_max = Look().display_table()
    film.clear()
    assert not film.develop(table, film_max).any()
    film.merge(np.full((HEIGHT, WIDTH, 3), -(1 << 30)))
    assert not film.develop(table, film_max).any()
    film.clear()
    film.merge(np.full((HEIGHT, WIDTH, 3), 1 << 50))
    assert (film.develop(table, film_max) == 255).all()
    assert (film.develop([0.0, 255.0], 0.5, dither=False) == 255).all()


def test_dither_keeps_the_mean_of_a_dark_gradient(film: Film, dots: Dots) -> None:
    """8x8 tiles of one value each, 0.6 to 3 display steps: every tile's mean is within 1/64 step of the value."""
    table = np.linspace(0.0, 255.0, 4096) ** 1.0
    tiles = np.linspace(0.6, 3.0, (HEIGHT // 8) * (WIDTH // 8)).reshape(HEIGHT // 8, WIDTH // 8)
    # value [steps] = 255 sqrt(film / film_max)
    linear = np.repeat(np.repeat((tiles / 255.0) ** 2, 8, axis=0), 8, axis=1)[..., None] * np.ones(3)
    film.clear()
    film.set_background(linear)
    try:
        image = film.develop(table, 1.0)
        plain = film.develop(table, 1.0, dither=False)
    finally:
        film.set_background(None)
    means = image.reshape(HEIGHT // 8, 8, WIDTH // 8, 8, 3).mean(axis=(1, 3))
    assert np.abs(means - tiles[..., None]).max() <= 1 / 64 + 1e-3
    assert abs(image.mean() - tiles.mean()) < abs(plain.mean() - tiles.mean()) + 1e-3


def test_develop_returns_a_new_array(film: Film) -> None:
    film.clear()
    first, second = (film.develop([0.0, 255.0], 1.0) for _ in range(2))
    assert not np.shares_memory(first, second)


def test_refusals(cpu: Backend, film: Film, dots: Dots) -> None:
    for width, height in [(0, 5), (5, -1), (40000, 20000)]:
        with pytest.raises(InputError, match=f"{width}x{height} is not allowed"):
            Film(width, height)
    with pytest.raises(InputError, match="capacity = 0"):
        Dots(0)
    with pytest.raises(InputError, match="count = 99999 dots"):
        film.add(dots, 99999)
    with pytest.raises(InputError, match="do not fit"):
        dots.upload(np.zeros(20000), 0, sigma=1, energy=(1, 1, 1))
    with pytest.raises(InputError, match="must be finite and of the film's shape"):
        film.set_background(np.zeros((3, 3, 3)))
    with pytest.raises(InputError, match="must be finite"):
        film.set_background(np.full((HEIGHT, WIDTH, 3), np.nan))
    for table, film_max in [([0.0], 1.0), ([0.0, 1.0], 0.0), (np.zeros(9999), 1.0)]:
        with pytest.raises(InputError, match="are needed"):
            film.develop(table, film_max)
