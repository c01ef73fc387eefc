"""What a film in shards will take, before it begins: particles, memory, disk, and time from a short probe."""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from .job import Job
from .output import SHARDS
from .simulation import Share, room

_FILM_BYTES = 8 * 3 + 46  # per pixel: the sums, and what drawing them takes at its peak
_PIECE_BYTES = 4 * 3  # per pixel that is lit, at most where nothing is brighter than 128 times white
_WORTH_A_PROBE = 10**9  # particles times frames
_PROBED = 1 << 20  # particles of a probe, where there are so many: fewer would take their time for the pixels
_LONGEST = 10.0  # [s] of a probe


def estimate(job: Job, count: int, workers: int, command: Sequence[str]) -> str:
    """Return a line on what `count` shards will take with `workers` at a time.

    Memory is what the particles and the film of a shard take. Time is measured, where it is worth it, by a probe of the film's
    beginning with a share of the particles; a film that fills up with particles takes longer.
    """
    precision, pixels = job.options.precision, job.size[0] * job.size[1]
    particles, needed = room(job.scene, precision=precision, share=Share(0, count))
    memory = needed + _FILM_BYTES * pixels
    line = (
        f"{count} shards on {workers} workers: room for {particles} particles and {_mib(memory)} each, "
        f"pieces of at most {_mib(_PIECE_BYTES * pixels)} a frame"
    )
    if count * particles * len(job.frames) < _WORTH_A_PROBE:
        return line
    seconds = _probe(job, count, particles, command)
    if seconds is None:
        return f"{line}; a probe of {_LONGEST:g} s drew no frame, so the time is unknown"
    return f"{line}; about {_duration(seconds * -(-count // workers))}, if the film goes on as it begins"


def _probe(job: Job, count: int, particles: int, command: Sequence[str]) -> float | None:
    """Return how long a shard will take [s], or None if that cannot be told."""
    parts = max(count, count * particles // _PROBED)  # of the particles: one is probed
    with tempfile.TemporaryDirectory(prefix="tparticles-", ignore_cleanup_errors=True) as folder:
        probe = [
            *command,
            "--shards",
            str(parts),
            "--shard",
            "1",
            "--out",
            folder,
            "--checkpoint-every",
            "off",
            "--quiet",
        ]
        process = subprocess.Popen(
            probe, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        until = time.monotonic() + _LONGEST
        try:
            while process.poll() is None and time.monotonic() < until:
                time.sleep(0.05)
        finally:
            process.terminate()
            process.wait()
        rows = []
        with suppress(OSError, ValueError, LookupError):
            rows = json.loads((Path(folder) / SHARDS / f"1-of-{parts}" / "run.json").read_bytes())["frames"]
    if not rows:
        return None
    first, *others = (sum(row["ms"].values()) / 1e3 for row in rows)
    each = sum(others) / len(others) if others else first
    return (first + each * (len(job.frames) - 1)) * parts / count


def _mib(size: float) -> str:
    return f"{size / 2**20:.0f} MiB" if size < 2**30 else f"{size / 2**30:.1f} GiB"


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"
