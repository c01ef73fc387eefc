"""Memory: bytes of state per particle of swirl, and the peak of a 10-million-particle run.

`python -m tests.bench memory`
"""

import json
import resource
import subprocess
import sys
import tempfile

from tests.bench.table import Table

COUNT = 10_000_000


def tparticles(*arguments: str) -> str:
    command = [sys.executable, "-m", "tparticles", *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def main() -> None:
    table = Table("memory", ("what", "value"))
    (group,) = json.loads(tparticles("describe", "scenes/swirl.py", "--json"))["groups"]
    table.add("state of swirl, bytes per particle (wanted: at most 24)", group["bytes_per_particle"])
    with tempfile.TemporaryDirectory() as out:
        wanted = ("--set", f"count={COUNT}", "--frames", "1-2", "--no-mp4", "--quiet", "--out", out)
        tparticles("render", "scenes/swirl.py", *wanted)
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    table.add(f"peak resident memory of swirl with {COUNT:,} particles [MiB]", f"{peak / 1024:.0f}")
    table.add("of it the state [MiB]", f"{COUNT * group['bytes_per_particle'] / 2**20:.0f}")
    table.print()
