"""The campfire film at final quality: wall time against encoding the same frames alone, and the time to the first frame.

`python -m tests.bench campfire`

Processor time, of this process and the programs it started, is what to look at where others use the machine too.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from statistics import median

import numpy as np
from PIL import Image

from tests.bench.table import Table
from tparticles.output import Mp4, OutputFrame, Pipeline, PngSequence

ROUNDS = 3


def command(out: Path) -> list[str]:
    return [sys.executable, "-m", "tparticles", "render", "scenes/campfire.py", "--out", str(out), "--quiet"]


def processor() -> float:
    """Return the processor time so far [s], with that of programs that have ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def measured(work: Callable[[], object]) -> tuple[float, float]:
    """Return the wall time and the processor time of one call [s]."""
    wall, used = time.perf_counter(), processor()
    work()
    return time.perf_counter() - wall, processor() - used


def render(out: Path) -> None:
    """Render the film, in a process of its own."""
    subprocess.run(command(out), check=True, env=environment())


def encode(images: list[np.ndarray], out: Path) -> None:
    """Write the same frames with the same settings and nothing else."""
    height, width, _ = images[0].shape
    writers = [Mp4(out / "film.mp4", fps=Fraction(24), size=(width, height)), PngSequence(out / "frames")]
    with Pipeline(writers) as pipeline:
        for number, image in enumerate(images, start=1):
            pipeline.submit(OutputFrame(number, image))


def environment(**more: str) -> dict[str, str]:
    """Return the environment of a user's process, which keeps the bytecode of what it imports."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | more


def first_frame(out: Path, cache: Path) -> float:
    """Return the seconds from the start of the process to the first frame on disk."""
    start = time.perf_counter()
    process = subprocess.Popen(command(out), env=environment(TPARTICLES_CACHE=str(cache)))
    while not (out / "frames" / "000001.png").exists() and process.poll() is None:
        time.sleep(0.01)
    elapsed = time.perf_counter() - start
    process.terminate()
    process.wait()
    return elapsed


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        render(base / "warm-up")
        images = [np.asarray(Image.open(p)) for p in sorted((base / "warm-up" / "frames").glob("*.png"))]
        pairs = []
        for i in range(ROUNDS):
            film = measured(lambda out=base / f"film{i}": render(out))
            pairs.append((film, measured(lambda out=base / f"encode{i}": encode(images, out))))
        films, encodes = zip(*pairs, strict=True)
        wall, used = (median(film[k] / encoding[k] for film, encoding in pairs) for k in (0, 1))
        table = Table("campfire, 240 frames of 1920x1080, PNG and MP4", ("what", "wall [s]", "processor [s]"))
        for name, runs in (("whole process, from start to exit", films), ("encoding the same frames alone", encodes)):
            table.add(name, *(f"{median(times):.1f}" for times in zip(*runs, strict=True)))
        table.add("ratio, median of pairs (wanted of wall: at most 1.5)", f"{wall:.2f}", f"{used:.2f}")
        rows = json.loads((base / "film0" / "run.json").read_text())["frames"]
        for part in ("births", "step", "draw"):
            table.add(f"of it in {part}, main thread", f"{sum(r['ms'][part] for r in rows) / 1e3:.1f}", "")
        table.add("of it in encode, worker threads", f"{sum(r['ms']['encode'] for r in rows) / 1e3:.1f}", "")
        empty = first_frame(base / "cold", base / "cache")
        first_frame(base / "filling", base / "cache-warm")
        warm = median(first_frame(base / f"warm{i}", base / "cache-warm") for i in range(ROUNDS))
        table.add("first frame on disk, empty kernel cache (wanted: 8)", f"{empty:.1f}", "")
        table.add("first frame on disk, warm (wanted: 2)", f"{warm:.1f}", "")
        table.print()
