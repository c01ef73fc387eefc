"""`tparticles check` of all scenes: kernels compiled anew, and from the cache.

`python -m tests.bench check`
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time

from tests.bench.table import Table

COMMAND = [sys.executable, "-m", "tparticles", "check", "--tolerant", "--json"]


def processor() -> float:
    """Return the processor time of programs that have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    table = Table(
        "tparticles check of all scenes (wanted: under 60 s)", ("kernels", "wall [s]", "processor [s]", "scenes")
    )
    with tempfile.TemporaryDirectory() as cache:
        for kernels in ("compiled", "from the cache"):
            wall, used = time.perf_counter(), processor()
            environment = {**os.environ, "TPARTICLES_CACHE": cache}
            done = subprocess.run(COMMAND, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
            wall, used = time.perf_counter() - wall, processor() - used
            rows = json.loads(done.stdout)["scenes"]
            each = ", ".join(f"{row['scene']} {row['seconds']:.1f}" for row in rows)
            table.add(kernels, f"{wall:.1f}", f"{used:.1f}", each)
    table.print()
