"""The film at 1920x1080: 1 M dots, soft dots, streaks, develop and clear, and whether the number of threads changes a bit.

`python -m tests.bench film`

The peer, moderngl's additive point sprites, runs where moderngl can be imported. It draws the same dots in the same run,
alternating with the film, so that a busy machine slows both.
"""

import hashlib
import importlib.util
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from tests.bench.table import Table
from tparticles import backend

THREADS = 2
ROUNDS = 9
SIZE = WIDTH, HEIGHT = 1920, 1080
SIGMA = 0.66  # [px]; the widest dot of 5x5 pixels


def once(work: Callable[[], object]) -> float:
    """Return how long one call takes [ms]."""
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)


def scene(count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Random dots on the whole film, float32."""
    rng = np.random.default_rng(seed)
    u, v = rng.random(count, dtype=np.float32) * WIDTH, rng.random(count, dtype=np.float32) * HEIGHT
    return {"u": u, "v": v, "energy": rng.random((count, 3), dtype=np.float32)}


def streaks(count: int, length: float) -> dict[str, np.ndarray]:
    """Streaks of one length [px] in all directions."""
    angle = 2 * np.pi * np.random.default_rng(1).random(count)
    return {**scene(count), "du": length * np.cos(angle), "dv": length * np.sin(angle)}


def digest(threads: int) -> str:
    """Return a hash of the sums of dots and streaks drawn by a process of its own."""
    code = f"from tests.bench import film; film.print_digest({threads})"
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout


def print_digest(threads: int) -> None:
    """Print a hash of the sums of 200 000 dots and streaks."""
    backend.start(arch="cpu", threads=threads)
    from tparticles.render.film import Dots, Film

    film, dots, rng = Film(*SIZE), Dots(200_000), np.random.default_rng(8)
    sigma = rng.choice([0.5, 0.66, 2.0], 200_000)
    columns = {**scene(200_000, seed=7), "du": rng.normal(0, 4, 200_000), "dv": rng.normal(0, 9, 200_000)}
    film.add(dots, dots.upload(**columns, sigma=sigma))
    print(hashlib.sha256(film.sums().tobytes()).hexdigest())


def against_peer(table: Table, film, dots) -> None:
    """Time 1 M dots, alternating with the peer if there is one, and compare the two pictures."""
    columns = scene(1_000_000)
    count = dots.upload(**columns, sigma=SIGMA)
    if importlib.util.find_spec("moderngl") is None:
        row(table, "1 M dots, 5x5", [once(lambda: film.add(dots, count)) for _ in range(ROUNDS)], "no peer: moderngl")
        return
    from tests.bench.peer_moderngl import point_sprites

    name, draw, read = point_sprites(**columns, sigma=SIGMA, size=SIZE)
    both = [(once(lambda: film.add(dots, count)), once(draw)) for _ in range(ROUNDS)]
    ours, theirs = (list(times) for times in zip(*both, strict=True))
    ratio = statistics.median(b / a for a, b in both)
    film.clear(), read()
    film.add(dots, count), draw()
    linear = film.linear()
    apart = np.abs(linear - read())[8:-8, 8:-8].mean() / linear.mean()
    row(table, "1 M dots, 5x5", ours, f"{ratio:.1f}x faster than the peer")
    row(table, "peer: moderngl point sprites", theirs, f"{name}; mean difference {apart:.2%}")


def row(table: Table, name: str, times: list[float], note: str = "") -> None:
    table.add(name, f"{min(times):.1f}", f"{statistics.median(times):.1f}", note)


def cleared(film, light: Callable[[], object]) -> float:
    """Return how long it takes to clear the film of some light [ms]."""
    light()
    return once(film.clear)


def main() -> None:
    """Print the table; leave with 1 if threads change a bit."""
    backend.start(arch="cpu", threads=THREADS)
    from tparticles.render.film import Dots, Film

    film, dots = Film(*SIZE), Dots(1_000_000)
    curve = np.linspace(0.0, 255.0, 4096)
    one = dots.upload(100.0, 100.0, sigma=SIGMA, energy=(1.0, 1.0, 1.0))
    works = [lambda: film.add(dots, one), film.clear, lambda: film.develop(curve, 1.0)]
    first = [once(work) for work in works]
    table = Table(f"Film, {WIDTH}x{HEIGHT}, {THREADS} threads, {ROUNDS} rounds", ("work", "min [ms]", "median", ""))
    against_peer(table, film, dots)
    kinds = {"2000 soft dots, sigma 10 px": (scene(2000), 10.0)}
    kinds |= {f"20 000 streaks of {n} px": (streaks(20_000, n), SIGMA) for n in (45, 300)}
    for name, (columns, sigma) in kinds.items():
        count = dots.upload(**columns, sigma=sigma)
        row(table, name, [once(lambda n=count: film.add(dots, n)) for _ in range(ROUNDS)])
    row(table, "develop, all lit", [once(works[2]) for _ in range(ROUNDS)])
    film.set_background(np.full((HEIGHT, WIDTH, 3), 0.01))
    works[2]()
    row(table, "develop with a background, all lit", [once(works[2]) for _ in range(ROUNDS)])
    whole = film.sums()
    row(table, "clear, all lit", [cleared(film, lambda: film.merge(whole)) for _ in range(ROUNDS)])
    few = {name: 0.3 * column if name in ("u", "v") else column for name, column in scene(2000).items()}
    count = dots.upload(**few, sigma=5.0)
    row(table, "clear, a tenth lit", [cleared(film, lambda: film.add(dots, count)) for _ in range(ROUNDS)])
    film.add(dots, count)
    works[2]()
    row(table, "develop, a tenth lit", [once(works[2]) for _ in range(ROUNDS)])
    row(table, "sums to NumPy", [once(film.sums) for _ in range(ROUNDS)])
    table.print()
    print(
        "\nFirst calls (compiled, or from the cache): "
        + ", ".join(f"{name} {ms:.0f} ms" for name, ms in zip(("add", "clear", "develop"), first, strict=True))
    )
    same = digest(1) == digest(2)
    print(f"1 and 2 threads: {'the same bits' if same else 'DIFFERENT BITS'}")
    sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
