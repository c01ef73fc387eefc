"""PixelTolerance(0.5) on campfire and grinder: the largest error of a dot after two seconds, and what it costs against fixed steps.

`python -m tests.bench pixels`. Wanted: at most 1 pixel against a converged reference in f64, at a cost no higher than that of the
cheapest fixed steps that meet it. Both may choose their scheme.
"""

import dataclasses

import numpy as np

from tests.bench.table import Table
from tparticles import library, schemes
from tparticles.errors import InputError, RunError
from tparticles.stepping.control import Fixed, PixelTolerance
from tparticles.studies import pixels

FRAME, SIZE = 48, (1920, 1080)
FIXED = {
    "midpoint": (4, 5, 6, 8, 12, 16),
    "rk3": (2, 3, 4, 6, 8),
    "rk4": (1, 2, 3, 4),
    "dormand-prince": (1, 2, 3),
    "ab4": (6, 8, 12),
    "abm4": (3, 4, 5, 6, 8),
}
GROWTHS = (2.0, 4.0, 16.0, 64.0)
ADAPTIVE = ("bogacki-shampine", "dormand-prince")


def main() -> None:
    for name in ("campfire", "grinder"):
        scene = library.load(name).build(quality="final", settings={})
        truth = pixels.reference(scene, FRAME, size=SIZE)
        table = Table(
            f"{name}, frame {FRAME}, {SIZE[0]}x{SIZE[1]}, f64",
            ("scheme", "steps", "largest error [px]", "median [px]", "evaluations [M]", "stepper [ms]"),
        )
        fixed = [
            measured(table, scene, truth, scheme, Fixed(dt=1 / 24 / n), f"{n} a frame")
            for scheme, counts in FIXED.items()
            for n in counts
        ]
        for scheme in ADAPTIVE:
            for growth in GROWTHS:
                control = PixelTolerance(px=0.5, growth=growth)
                measured(table, scene, truth, scheme, control, f"PixelTolerance(0.5, growth={growth:g})")
        chosen = [
            measured(table, scene, truth, scheme, PixelTolerance(px=0.5), "PixelTolerance(0.5)") for scheme in ADAPTIVE
        ]
        table.print()
        good, ours = ([row for row in rows if row and row[0] <= 1] for rows in (fixed, chosen))
        if ours and good:
            px, work, seconds = min(ours, key=lambda row: row[1])
            print(
                f"PixelTolerance(0.5): {px:.2f} px (wanted: 1); against the cheapest fixed steps within 1 px "
                f"{work / min(row[1] for row in good):.2f} times the evaluations and "
                f"{seconds / min(row[2] for row in good):.2f} times the time (wanted: 1)"
            )


def measured(table, scene, truth, scheme, control, label):
    """Add a row; return largest error [px], evaluations and seconds, None where it blew up."""
    film = dataclasses.replace(scene, scheme=schemes.get(scheme), steps=control, clamp="equal")
    try:
        runs = [pixels.track(film, FRAME, precision="f64", size=SIZE) for _ in range(2)]
    except (InputError, RunError) as error:
        table.add(scheme, label, str(error)[:40], "", "", "")
        return None
    off, _ = pixels.distances(runs[0].dots, truth, film, FRAME, SIZE)
    seconds = min(run.seconds for run in runs)
    work = runs[0].evaluations
    table.add(scheme, label, f"{off.max():.3f}", f"{np.median(off):.2g}", f"{work / 1e6:.3f}", f"{1e3 * seconds:.0f}")
    return off.max(), work, seconds
