"""Tiny scenes, and what a command leaves behind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
# The backend that the session's `cpu` fixture starts: another one would drop the fields of other tests.
SAME_BACKEND = ("--arch", "cpu", "--threads", "2")

SCENE = '''"""A tiny film."""
import taichi as ti
import tparticles as tp
{head}

def scene(quality, *, rate: float = 60.0, seed: int = 1, note: str = "") -> tp.Scene:
    group = tp.Group(
        name="dots",
        system={system},
        emitters=tp.Emitter(births={births}, shape=tp.Sphere(radius=1.0), size={dot}, preroll={preroll}{emitter}),
        appearance={look},
    )
    return tp.Scene(
        groups={groups}, camera={camera}, duration={duration}, size={size}, seed=seed, shutter=0.0{more}
    )
'''
PARTS = {
    "head": "",
    "system": "tp.Advected(flow=tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=20.0, core=0.4))",
    "births": "tp.Rate(rate=rate)",
    "dot": "0.2",
    "preroll": "0.25",
    "emitter": "",
    "look": "tp.Ramp(colors=((1.0, 0.6, 0.2),), span=1.0)",
    "groups": "group",
    "camera": "tp.Camera(position=(0.0, -5.0, 0.0), target=(0.0, 0.0, 0.0))",
    "duration": "0.25",
    "size": "(64, 36)",
    "more": "",
}
# A law of the user's own, to be filled with what its velocity returns.
LAW = """
class Odd:
    @ti.func
    def velocity(self, t, x):
        return {}
"""


@dataclass(frozen=True)
class Result:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Standard output, which must be one strict JSON document."""
        return json.loads(self.out, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))

    def refused(self, code: int, *parts: str) -> str:
        """Check that this is one clear line on stderr, that stdout is clean, and what the line says; return the line."""
        assert (self.code, self.out) == (code, ""), self
        (line,) = self.err.splitlines()
        assert line.startswith("error: ")
        for part in parts:
            assert part in line, line
        for noise in ("Traceback", "pydantic", "http", " at 0x"):
            assert noise not in line
        return line


Run = Callable[..., Result]
Write = Callable[..., Path]


def write_scene(path: Path, **parts: str) -> Path:
    """Write a scene script, with other text in some of `PARTS`, or of `law` alone."""
    if law := parts.pop("law", None):
        parts |= {"head": LAW.format(law), "system": "tp.Advected(flow=Odd())"}
    path.write_text(SCENE.format(**PARTS | parts))
    return path


def command(*arguments: object) -> list[str]:
    """Return the command line of a process of its own. SIGINT is ours again where a shell has it ignored."""
    take_signal = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    start = "from tparticles.cli import main; main()"
    return [sys.executable, "-c", take_signal + start, *map(str, arguments)]


def run_process(
    *arguments: object, wrapper: tuple[str, ...] = (), folder: Path | None = None, **environment: str
) -> Result:
    """Run a command in a process of its own."""
    done = subprocess.run(
        [*wrapper, *command(*arguments)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    return Result(done.returncode, done.stdout, done.stderr)
