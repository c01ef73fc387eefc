"""What it costs to log every step of a cloth of 64 x 64 (velocity Verlet, f32): the steps alone, and a whole render.

`python -m tests.bench log`

Runs with and without a log take turns in one process; the log's writer is another one. The wall clock of the steps wants two cores
to itself; processor time says what the run spends, and its writer, whoever else is on the machine.
"""

import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.bench.table import Table
from tparticles import backend
from tparticles.job import Job, Options
from tparticles.log.source import LoggedSimulation, Logging

SCENE = '''"""A cloth that falls onto a ball."""
import tparticles as tp


def scene(quality, *, damping: float = 0.0):
    sheet = tp.cloth(counts=(64, 64), size=(2.0, 2.0), mass=0.4, stiffness=200.0, damping=damping)
    ball = tp.Ball(center=(0.3, 0.0, 0.0), radius=0.6, restitution=0.0, friction=0.4)
    cloth = tp.MeshGroup(
        name="cloth", mesh=sheet.moved((0, 0, 1)), scheme="velocity-verlet", steps=tp.StabilityLimit(), colliders=ball
    )
    camera = tp.Camera(position=(0, -6, 1.2), target=(0, 0, 0))
    return tp.Scene(groups=cloth, camera=camera, duration=60, size=(480, 270))
'''
ROUNDS, FRAMES = 12, 2
FILM, SIZES, RENDERS = "1-96", ("480x270", "1920x1080"), 5


def job(folder: Path, damping: float, **options: object) -> Job:
    (folder / "cloth.py").write_text(SCENE)
    (folder / "out").mkdir(exist_ok=True)
    settings = {"damping": str(damping)}
    return Job(
        str(folder / "cloth.py"), Options(out=folder / "out", settings=settings, arch="cpu", mp4=False, **options)
    )


def stepping(folder: Path, damping: float) -> tuple[np.ndarray, float, float]:
    """Return microseconds a step, wall and processor, of plain and logged rounds, (rounds, 2, 2); the writer's; bytes a step."""
    asked = job(folder, damping)
    plain, logged = asked.simulation(), LoggedSimulation(asked, Logging())
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    found, steps = [], 0
    with logged.opened() as log:
        for n in range(1, ROUNDS + 1):
            pair = []
            for simulation in (plain, logged.simulation):
                wall, spent = time.perf_counter(), time.process_time()
                taken = simulation.advance_to(n * FRAMES, after=log if simulation is logged.simulation else abs).steps
                pair.append(((time.perf_counter() - wall) / taken, (time.process_time() - spent) / taken))
            steps += taken
            found.append(pair)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    writer = (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) / steps
    backend.stop()
    size = (folder / "out/log.h5").stat().st_size / steps
    (folder / "out/log.h5").unlink()
    return np.array(found[1:]) * 1e6, writer * 1e6, size


def render(folder: Path, size: str, *, log: bool) -> float:
    """Return the seconds of a render, by a process of its own. It has no film to replace: to give up a large log takes a while."""
    shutil.rmtree(folder / "film", ignore_errors=True)
    command = [sys.executable, "-m", "tparticles", "render", str(folder / "cloth.py"), "--frames", FILM, "--no-mp4"]
    command += ["--out", str(folder / "film"), "--size", size, "--arch", "cpu", "--quiet", *["--log"] * log]
    start = time.perf_counter()
    subprocess.run(command, check=True)
    return time.perf_counter() - start


def main() -> None:
    table = Table("log", ("64 x 64, every step logged", "without", "with", "ratio"))
    with tempfile.TemporaryDirectory() as folder:
        for damping in (0.0, 0.002):
            found, writer, size = stepping(Path(folder), damping)
            ratios = np.median(found[:, 1] / found[:, 0], axis=0)
            for clock, name in enumerate(("wall clock", "processor")):
                plain, logged = np.median(found[:, :, clock], axis=0)
                what = f"a step, damping {damping:g}, {name} [us]"
                table.add(what, f"{plain:.0f}", f"{logged:.0f}", f"{ratios[clock]:.2f}")
            table.add("its writer, another process [us]", "", f"{writer:.0f}", "")
            table.add(f"bytes a step, {9 * 4 * 64 * 64} uncompressed", "", f"{size:.0f}", "")
        for size in SIZES:
            times = np.array([[render(Path(folder), size, log=log) for log in (False, True)] for _ in range(RENDERS)])
            plain, logged = np.median(times, axis=0)
            what = f"a render of {FILM} frames, {size} [s]"
            table.add(what, f"{plain:.1f}", f"{logged:.1f}", f"{np.median(times[:, 1] / times[:, 0]):.2f}")
    table.add("wanted: less than", "", "", "1.30")
    table.print()
