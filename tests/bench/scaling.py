"""Cost per frame against the number of particles, 10^3 to 10^7: a table, a fitted slope, a plot in renders/bench/.

`python -m tests.bench scaling`
"""

import math
import statistics
import time
from pathlib import Path

import tparticles as tp
from tests.bench.table import Table
from tparticles import library

COUNTS = [10**k for k in range(3, 8)]
PLOT = Path("renders/bench/scaling.png")


def cost(count: int) -> tuple[float, float]:
    """Return the milliseconds of a step and of a drawing of a frame of swirl with `count` tracers, 1920x1080."""
    script = library.load("scenes/swirl.py")
    scene = script.build(quality="final", settings={"count": count, "spin_up": 0.1})
    frames = tp.Simulation(scene, arch="cpu").frames(range(1, 4 if count > 10**6 else 12))
    reports = [frame.report for frame in frames][1:]
    return tuple(statistics.median(r.ms[part] for r in reports) for part in ("step", "draw"))


def slope(counts: list[int], times: list[float]) -> float:
    """Return the least-squares slope of log time over log count."""
    x, y = [math.log(c) for c in counts], [math.log(t) for t in times]
    return statistics.linear_regression(x, y).slope


def main() -> None:
    start = time.perf_counter()
    costs = [cost(count) for count in COUNTS]
    table = Table("swirl, cost per frame at 1920x1080 [ms]", ("particles", "step", "draw", "M particles/s"))
    for count, (step, draw) in zip(COUNTS, costs, strict=True):
        table.add(f"{count:,}", f"{step:.2f}", f"{draw:.1f}", f"{count / (step + draw) / 1e3:.2f}")
    totals = [step + draw for step, draw in costs]
    steepest = slope(COUNTS[-3:], totals[-3:])
    table.add(
        "slope, 10^5 to 10^7", f"{slope(COUNTS[-3:], [s for s, _ in costs[-3:]]):.2f}", "", f"total {steepest:.2f}"
    )
    table.print()
    plot(totals, [s for s, _ in costs], steepest)
    print(f"({time.perf_counter() - start:.0f} s; plot in {PLOT})")


def plot(totals: list[float], steps: list[float], steepest: float) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4))
    axes.loglog(COUNTS, totals, "o-", label=f"frame (slope {steepest:.2f} from 10^5 on)")
    axes.loglog(COUNTS, steps, "s--", label="simulation alone")
    axes.set(xlabel="particles", ylabel="ms per frame", title="swirl, 1920x1080")
    axes.grid(alpha=0.3)
    axes.legend()
    PLOT.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PLOT, dpi=110, bbox_inches="tight")
