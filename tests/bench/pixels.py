"""PixelTolerance(0.5) on campfire and grinder: the largest error of any dot in the film, and what it costs against fixed steps.

`python -m tests.bench pixels`. Wanted: at most 1 pixel against a converged reference in f64, at a cost no higher than that of the
cheapest fixed steps that meet it. Both may choose their scheme. Errors are looked at four times a second, in the whole film: of a
single frame the largest is a matter of luck, as it is a single spark's that passed a stagnation point.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median

from tests.bench.table import Table
from tparticles import library, schemes
from tparticles.errors import InputError, RunError
from tparticles.scene import Scene
from tparticles.stepping.control import Fixed, PixelTolerance
from tparticles.studies import pixels

EVERY, SIZE, ROUNDS = 6, (1920, 1080), 7
# per frame; after the first that meets a pixel a scheme is left
FIXED = {
    "midpoint": (6, 8, 12, 16, 24, 32),
    "rk3": (3, 4, 6, 8, 10),
    "rk4": (3, 4, 6, 7, 8),
    "bogacki-shampine": (3, 4, 6, 8),
    "dormand-prince": (2, 3, 4, 5, 6),
    "ab4": (10, 12, 14, 16, 18, 20),
    "abm4": (4, 5, 6, 8, 10, 12),
    "abm5-pec": (5, 6, 7, 8, 10, 11, 12),
}
OTHERS = ("dormand-prince",)
PIXELS = (2.0, 0.5, 0.125)


@dataclass(frozen=True)
class Film:
    """A scene, its frames, and where its dots should be."""

    scene: Scene
    frames: range
    truth: tuple[pixels.Dots, ...]

    def run(self, scheme: str, control: Fixed | PixelTolerance) -> pixels.Track:
        """Run the film."""
        film = dataclasses.replace(self.scene, scheme=schemes.get(scheme), steps=control, clamp="equal")
        return pixels.track(film, self.frames, precision="f64", size=SIZE)


@dataclass(frozen=True)
class Row:
    """What a scheme under a control gave: largest error [px], evaluations."""

    scheme: str
    control: Fixed | PixelTolerance
    largest: float
    work: int


def main() -> None:
    for name in ("campfire", "grinder"):
        scene = library.load(name).build(quality="final", settings={})
        frames = range(2 * EVERY, scene.frame_count + 1, EVERY)
        film = Film(scene, frames, pixels.reference(scene, frames, size=SIZE))
        table = Table(
            f"{name}, {len(frames)} frames, {SIZE[0]}x{SIZE[1]}, f64",
            ("scheme", "steps", "largest error [px]", "frames above 1 px", "evaluations [M]", "stepper [ms]"),
        )
        fixed = [row for scheme, counts in FIXED.items() for row in sweep(film, table, scheme, counts)]
        for scheme in OTHERS:
            add(film, table, scheme, PixelTolerance(px=0.5), "PixelTolerance(0.5)")
        ours = [add(film, table, "abm5-pec", PixelTolerance(px=px), f"PixelTolerance({px:g})") for px in PIXELS]
        table.print()
        good, chosen = [row for row in fixed if row.largest <= 1], ours[PIXELS.index(0.5)]
        if chosen and good:
            cheapest = min(good, key=lambda row: row.work)
            print(
                f"PixelTolerance(0.5): {chosen.largest:.2f} px (wanted: 1); against {cheapest.scheme}, the cheapest fixed steps "
                f"within 1 px, {chosen.work / cheapest.work:.2f} times the evaluations and {times(film, chosen, cheapest):.2f} "
                "times the time (wanted: 1)"
            )


def times(film: Film, one: Row, other: Row) -> float:
    """Return how many times as long one takes in the stepper as another, the median of runs in turn."""
    ratios = [
        film.run(one.scheme, one.control).seconds / film.run(other.scheme, other.control).seconds for _ in range(ROUNDS)
    ]
    return median(ratios)


def sweep(film: Film, table: Table, scheme: str, counts: tuple[int, ...]) -> Iterator[Row]:
    """Yield what fixed steps of a scheme give, up to the first that meet a pixel."""
    for n in counts:
        row = add(film, table, scheme, Fixed(dt=1 / 24 / n), f"{n} a frame")
        if row:
            yield row
            if row.largest <= 1:
                return


def add(film: Film, table: Table, scheme: str, control: Fixed | PixelTolerance, label: str) -> Row | None:
    """Add a row to the table; return what was measured, None where it blew up."""
    try:
        track = film.run(scheme, control)
    except (InputError, RunError) as error:
        table.add(scheme, label, str(error)[:40], "", "", "")
        return None
    worst = [
        pixels.distances(dots, truth, film.scene, frame, SIZE)[0].max()
        for dots, truth, frame in zip(track.dots, film.truth, film.frames, strict=True)
    ]
    above, work = sum(px > 1 for px in worst) / len(worst), track.evaluations
    table.add(scheme, label, f"{max(worst):.3f}", f"{above:.0%}", f"{work / 1e6:.3f}", f"{1e3 * track.seconds:.0f}")
    return Row(scheme, control, max(worst), work)
