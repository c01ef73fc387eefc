"""The fused stepper inside the real engine, births, cooling and kill included, against a bare loop and against lane blocks off.

`python -m tests.bench fused`. The three take turns in one run; medians of the rates and of their ratios.
"""

import statistics
import time

import tparticles as tp
from tests.bench.bare import Bare
from tests.bench.table import Table
from tparticles.stepping.fused import FusedStepper

COUNT = 1 << 20
ROUNDS = 9


def scene(scheme: str) -> tp.Scene:
    """About 2^20 particles in a steady state: each lives half a second, 43 690 are born and die in every frame."""
    life = 0.5
    particles = tp.Group(
        name="noise",
        system=tp.Advected(flow=tp.CurlNoise(speed=1.0, length=1.0)),
        emitters=tp.Emitter(
            births=tp.Rate(rate=COUNT / life),
            shape=tp.Box(low=(0.0, 0.0, 0.0), high=(8.0, 8.0, 8.0)),
            temperature=tp.Spread(mean=1500.0, variance=100.0),
            lifetime=life,
            preroll=life,
        ),
        cooling=tp.Exponential(time=1.0),
    )
    return tp.Scene(
        groups=particles,
        camera=tp.Camera(position=(4.0, -12.0, 4.0), target=(4.0, 4.0, 4.0)),
        look=tp.Look(ev=0.0),
        duration=2.0,
        scheme=scheme,
        steps=tp.Fixed(dt=1 / 96),
        shutter=0.0,
    )


class Engine:
    """The scene, advanced a frame at a time, with a given number of lanes per block."""

    def __init__(self, scheme: str, lanes: int | None = None):
        self.simulation = tp.Simulation(scene(scheme), size=(64, 64), arch="cpu")
        if lanes:
            (group,) = self.simulation.groups
            group.stepper = FusedStepper(
                group.spec.system,
                cooling=group.spec.cooling,
                scheme=self.simulation.scene.scheme,
                clamp="equal",
                columns=group.columns,
                size=0.01,
                lanes=lanes,
            )
        self.frame = 1
        self.simulation.advance_to(self.frame)

    def rate(self) -> float:
        """Advance a frame; return particle-steps per second, everything but drawing included."""
        self.frame += 1
        start = time.perf_counter()
        report = self.simulation.advance_to(self.frame)
        return report.steps / (time.perf_counter() - start)


def main() -> None:
    table = Table(
        "fused stepper, 2^20 particles in curl noise, 4 steps a frame [M particle-steps/s]",
        ("scheme", "engine", "bare loop", "lanes off", "engine / bare", "engine / lanes off"),
    )
    for scheme in ("midpoint", "rk4"):
        runs = {"engine": Engine(scheme), "off": Engine(scheme, lanes=1), "bare": Bare(scheme, COUNT)}
        runs["bare"].rate()
        rates = {name: [] for name in runs}
        for _ in range(ROUNDS):
            for name, run in runs.items():
                rates[name].append(run.rate())
        median = {name: statistics.median(values) / 1e6 for name, values in rates.items()}
        ratio = {
            name: statistics.median(a / b for a, b in zip(rates["engine"], rates[name], strict=True))
            for name in ("bare", "off")
        }
        table.add(
            scheme,
            f"{median['engine']:.1f}",
            f"{median['bare']:.1f}",
            f"{median['off']:.1f}",
            f"{ratio['bare']:.2f} (wanted: 0.80)",
            f"{ratio['off']:.1f} (wanted: 3)",
        )
    table.print()
