"""Commands in processes of their own, and what a batch leaves behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
SCENE = '''"""Dots in a vortex."""
import tparticles as tp


def scene(quality, *, rate: float = 60.0, seed: int = 1, note: str = "", trouble: str = "") -> tp.Scene:
    if trouble == "refuse":
        raise ValueError("no such film")
    group = tp.Group(
        name="dots",
        system=tp.Advected(flow=tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=20.0, core=0.4)),
        emitters=tp.Emitter(births=tp.Rate(rate=rate), shape=tp.Sphere(radius=1.0), size=0.2, lifetime=1.0, preroll=0.25),
        appearance=tp.Ramp(colors=((1.0, 0.6, 0.2),), span=1.0),
    )
    camera = tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0))
    return tp.Scene(groups=group, camera=camera, duration=1200.0, size=(64, 36), seed=seed, shutter=0.0)
'''
FAST = ("--arch", "cpu", "--no-mp4", "--frames", "1-3")
SLOW = ("--arch", "cpu", "--no-mp4", "--frames", "1-28000")


@dataclass
class Running:
    """A command in a process of its own; results once it has ended."""

    process: subprocess.Popen[str]
    out: str = ""
    err: str = ""
    code: int = -1

    def end(self, timeout: float = 240.0) -> Running:
        """Wait for it."""
        self.out, self.err = self.process.communicate(timeout=timeout)
        self.code = self.process.returncode
        return self

    def refused(self, code: int, *parts: str) -> str:
        """Check that it left with `code` and that stderr ends in one clear line with `parts`; return the line."""
        assert self.code == code, self
        assert "Traceback" not in self.err, self.err
        line = self.err.splitlines()[-1]
        assert line.startswith("error: ")
        for part in parts:
            assert part in line, line
        return line

    @property
    def events(self) -> list[dict[str, Any]]:
        """What it printed with --json."""
        return [json.loads(line) for line in self.out.splitlines()]


@dataclass
class Commands:
    """Runs commands in a folder, and ends those that a failed test leaves behind."""

    folder: Path
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def start(self, *arguments: object) -> Running:
        """Begin with a command."""
        return self.python(
            "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from tparticles.cli import main; main()",
            *arguments,
        )

    def python(self, code: str, *arguments: object) -> Running:
        """Begin with a program."""
        process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)],
            cwd=self.folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.started.append(process)
        return Running(process)

    def __call__(self, *arguments: object) -> Running:
        """Run a command to its end."""
        return self.start(*arguments).end()

    def close(self) -> None:
        """End what is still running."""
        for process in self.started:
            if process.poll() is None:
                process.kill()
            process.wait()
            for pipe in (process.stdout, process.stderr):
                if pipe:
                    pipe.close()


def until(true: Callable[[], object], running: Running | None = None, seconds: float = 120.0) -> None:
    """Wait until something is so, while `running` runs."""
    deadline = time.monotonic() + seconds
    while not true():
        if running is not None and running.process.poll() is not None:
            raise AssertionError(f"it ended before: {running.end()}")
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)


def hashes(folder: Path) -> dict[int, str]:
    """Return the pixel hashes of the finished frames of a film."""
    return {row["frame"]: row["sha256"] for row in json.loads((folder / "run.json").read_text())["frames"]}


def states(folder: Path) -> dict[str, str]:
    """Return the states of the jobs of a batch."""
    return {row["name"]: row["state"] for row in json.loads((folder / "batch.json").read_text())["jobs"]}


def children(pid: int, needle: str) -> list[int]:
    """Return the processes that `pid` started and whose command line holds `needle`."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            line = (entry / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
        if parent == pid and needle in line:
            found.append(int(entry.name))
    return found


def alive(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill(pid: int) -> None:
    """Kill a process that the test started."""
    os.kill(pid, signal.SIGKILL)
