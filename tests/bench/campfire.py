"""The campfire film at final quality: wall time against encoding the same frames alone, and the time to the first frame.

`python -m tests.bench campfire`
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image

from tests.bench.table import Table
from tparticles.output import Mp4, OutputFrame, Pipeline, PngSequence

ROUNDS = 3


def command(out: Path) -> list[str]:
    return [sys.executable, "-m", "tparticles", "render", "scenes/campfire.py", "--out", str(out), "--quiet"]


def render(out: Path) -> float:
    """Render the film; return the seconds of the whole process."""
    start = time.perf_counter()
    subprocess.run(command(out), check=True)
    return time.perf_counter() - start


def encode(images: list[np.ndarray], out: Path) -> float:
    """Write the same frames with the same settings and nothing else; return seconds."""
    height, width, _ = images[0].shape
    start = time.perf_counter()
    writers = [Mp4(out / "film.mp4", fps=Fraction(24), size=(width, height)), PngSequence(out / "frames")]
    with Pipeline(writers) as pipeline:
        for number, image in enumerate(images, start=1):
            pipeline.submit(OutputFrame(number, image))
    return time.perf_counter() - start


def first_frame(out: Path, cache: Path) -> float:
    """Return the seconds from the start of the process to the first frame on disk."""
    start = time.perf_counter()
    process = subprocess.Popen(command(out), env={**os.environ, "TPARTICLES_CACHE": str(cache)})
    while not (out / "frames" / "000001.png").exists() and process.poll() is None:
        time.sleep(0.01)
    elapsed = time.perf_counter() - start
    process.terminate()
    process.wait()
    return elapsed


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        films, encodes = [], []
        render(base / "warm-up")
        images = [np.asarray(Image.open(p)) for p in sorted((base / "warm-up" / "frames").glob("*.png"))]
        for i in range(ROUNDS):
            films.append(render(base / f"film{i}"))
            encodes.append(encode(images, base / f"encode{i}"))
        ratio = sorted(a / b for a, b in zip(films, encodes, strict=True))[ROUNDS // 2]
        table = Table("campfire, 240 frames of 1920x1080, PNG and MP4", ("what", "seconds"))
        table.add("whole process, from start to exit", f"{sorted(films)[ROUNDS // 2]:.1f}")
        table.add("encoding the same frames alone", f"{sorted(encodes)[ROUNDS // 2]:.1f}")
        table.add("ratio, median of pairs (wanted: at most 1.5)", f"{ratio:.2f}")
        rows = json.loads((base / "film0" / "run.json").read_text())["frames"]
        for part in ("births", "step", "draw"):
            table.add(f"of it in {part}, main thread", f"{sum(r['ms'][part] for r in rows) / 1e3:.1f}")
        table.add("of it in encode, worker threads", f"{sum(r['ms']['encode'] for r in rows) / 1e3:.1f}")
        empty = first_frame(base / "cold", base / "cache")
        warm = first_frame(base / "warm", base / "cache-warm") and first_frame(base / "warm2", base / "cache-warm")
        table.add("first frame on disk, empty kernel cache (wanted: 8)", f"{empty:.1f}")
        table.add("first frame on disk, warm (wanted: 2)", f"{warm:.1f}")
        table.print()
