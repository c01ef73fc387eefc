"""Two shards on two workers against one worker, each worker on a core of its own: a film of 10 M particles, bit-equal.

`python -m tests.bench shards`

Half of the processor time of the two, merging included, is what they would take with two cores to themselves: the ratio to look at
where others use the machine too.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.table import Table

COUNT, SPIN_UP, FRAMES = 10_000_000, 1.0, 12


def processor() -> float:
    """Return the processor time of programs that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def render(out: Path, *options: str, cores: set[int]) -> tuple[float, float, list[str]]:
    """Render on some cores; return wall and processor time [s], from start to exit, and the hashes of the pictures."""
    command = [sys.executable, "-m", "tparticles", "render", "scenes/swirl.py", "--set", f"count={COUNT}", "--no-mp4"]
    command += ["--set", f"spin_up={SPIN_UP}", "--frames", f"1-{FRAMES}", "--quiet", "--out", str(out), *options]
    wall, used = time.perf_counter(), processor()
    subprocess.run(command, check=True, preexec_fn=lambda: os.sched_setaffinity(0, cores))
    wall, used = time.perf_counter() - wall, processor() - used
    return wall, used, [row["sha256"] for row in json.loads((out / "run.json").read_text())["frames"]]


def main() -> None:
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        sys.exit("two cores are needed")
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        one, one_used, hashes = render(base / "one", "--threads", "1", cores={cores[0]})
        two, two_used, sums = render(base / "two", "--shards", "2", "--threads", "1", cores=set(cores))
    assert sums == hashes, "the films differ"
    title = f"swirl, {COUNT} particles, {FRAMES} frames of 1920x1080 to PNG, start-up and spin-up included; bit-equal"
    table = Table(title, ("what", "wall [s]", "processor [s]"))
    table.add("one worker, one core", f"{one:.1f}", f"{one_used:.1f}")
    table.add("two shards, two workers and the sum, two cores", f"{two:.1f}", f"{two_used:.1f}")
    table.add("ratio (wanted: at least 1.6)", f"{one / two:.2f}", f"{one_used / (two_used / 2):.2f}")
    table.print()
