"""How long the stepper's kernel takes to compile from an empty cache, and whether another scheme compiles anything else again.

`python -m tests.bench compile`. The largest schemes, on tracers in curl noise; each in a process and a cache of its own. Wanted:
under 4 s, and no kernel but the stepper's for another scheme.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.bench.table import Table

SCHEMES = ("rk4", "dormand-prince", "dop853", "abm4", "milne", "tr-bdf2", "rk4 doubled")


def film(name: str):
    """Return tracers in curl noise, a frame of which is drawn."""
    import tparticles as tp

    scheme, doubled = name.split()[0], name.endswith("doubled")
    group = tp.Group(
        name="noise",
        system=tp.Advected(flow=tp.CurlNoise(speed=1.0, length=1.0, octaves=3)),
        emitters=tp.Emitter(births=tp.Burst(count=1000), shape=tp.Box(low=(0.0,) * 3, high=(1.0,) * 3)),
        appearance=tp.Ramp(colors=((1.0, 1.0, 1.0),), span=1.0),
    )
    return tp.Scene(
        groups=group,
        camera=tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0)),
        duration=1.0,
        scheme=scheme,
        steps=tp.ErrorControl() if doubled else tp.Fixed(dt=1 / 96),
        size=(64, 36),
        shutter=0.0,
    )


def report(name: str) -> None:
    """Draw a frame; print the seconds of the stepper's first launch, then of its second."""
    import time

    import tparticles as tp

    simulation = tp.Simulation(film(name), arch="cpu")
    (group,) = simulation.groups
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        group.stepper.advance(1, 0.0, 0.0, group.dt, camera=simulation._camera(0.0))
        seconds.append(time.perf_counter() - start)
    next(iter(simulation.frames([1])))
    print(*seconds)


def run(name: str, cache: Path) -> list[float]:
    """Draw a frame in a process of its own with this cache."""
    code = f"from tests.bench import compile; compile.report({name!r})"
    done = subprocess.run(
        [sys.executable, "-c", code],
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, "TPARTICLES_CACHE": str(cache)},
    )
    return [float(word) for word in done.stdout.split()]


def kernels(cache: Path) -> set[str]:
    """Return the compiled kernels of a cache."""
    return {path.name for path in cache.rglob("*") if path.is_file() and path.suffix in (".ll", ".bc", ".tic")}


def main() -> None:
    table = Table(
        "the stepper's kernel in curl noise of three octaves [s]",
        ("scheme", "empty cache (wanted: 4)", "cached", "kernels", "new after rk4"),
    )
    with tempfile.TemporaryDirectory() as folder:
        shared = Path(folder) / "shared"
        run("rk4", shared)
        for name in SCHEMES:
            cache = Path(folder) / name.replace(" ", "-")
            cold = run(name, cache)[0]
            warm = run(name, cache)[0]
            before = kernels(shared)
            run(name, shared)
            table.add(name, f"{cold:.2f}", f"{warm:.2f}", len(kernels(cache)), len(kernels(shared) - before))
    table.print()
