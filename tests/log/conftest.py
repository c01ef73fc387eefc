"""One small film, logged: a box that bounces, a cloth, and sparks."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tparticles import backend
from tparticles.errors import InputError
from tparticles.job import Job, Options
from tparticles.log.read import Log
from tparticles.log.source import LoggedSimulation, Logging

SCENE = '''"""A box, a cloth and sparks."""
import tparticles as tp


def scene(quality, *, width: float = 0.05, tear: float = float("inf")):
    room = tp.Room(low=(-3, -3, 0), high=(3, 3, 6), restitution=0.6, friction=0.2)
    strain = tp.Wires(by="strain", colors=((0, 0, 1), (1, 1, 1), (1, 0, 0)), low=-0.1, high=0.1, width=width, dot=0.1)
    box = tp.MeshGroup(
        name="box", mesh=tp.spring_box(stiffness=400.0, tear=tear).moved((0, 0, 0.9)).launched((0.5, 0, -1.5), spin=(1, 2, 0)),
        colliders=room, appearance=strain, steps=tp.Fixed(dt=0.004),
    )
    sheet = tp.cloth(counts=(5, 4), size=(1.0, 1.0), mass=0.2, stiffness=50.0).moved((1.5, 0, 1))
    cloth = tp.MeshGroup(
        name="cloth", mesh=sheet, scheme="velocity-verlet", appearance=tp.Wires(by="speed", width=width, high=3.0),
        steps=tp.StabilityLimit(),
    )
    sparks = tp.Group(
        name="sparks", system=tp.Newtonian(forces=(tp.Gravity(),)), cooling=tp.Exponential(time=0.5),
        emitters=tp.Emitter(
            births=tp.Rate(rate=200.0), velocity=tp.Cone(angle=30.0, speed=(3.0, 1.0)), temperature=(1700.0, 200.0),
            size=(0.05, 0.02), lifetime=0.2,
        ),
    )
    return tp.Scene(
        groups=(box, cloth, sparks), camera=tp.Camera(position=(0, -6, 1), target=(0, 0, 1)), duration=0.5, size=(96, 54),
        scheme="rk4",
    )
'''
FRAMES = 12


@dataclass(frozen=True)
class Film:
    """A rendered and logged film."""

    folder: Path
    script: Path
    run: dict[str, Any]

    @property
    def log(self) -> Path:
        return self.folder / "log.h5"


def film(folder: Path, logging: Logging | None, **settings: str) -> Film:
    """Render the scene, logged or not."""
    script = folder.parent / "small.py"
    if not script.exists():
        script.write_text(SCENE)
    job = Job(str(script), Options(out=folder, settings=settings, arch="cpu", threads=2, mp4=False))
    run = job.run(source=None if logging is None else lambda: LoggedSimulation(job, logging))
    return Film(folder, script, run)


@pytest.fixture(scope="session")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Film:
    """The film with all logged."""
    backend.stop()
    return film(tmp_path_factory.mktemp("film") / "out", Logging())


@pytest.fixture
def log(logged: Film) -> Iterator[Log]:
    """Its log, open."""
    with Log(logged.log) as opened:
        yield opened


def pixels(path: Path) -> str:
    """Return a hash of a picture's pixels."""
    from PIL import Image

    with Image.open(path) as image:
        return hashlib.sha256(np.asarray(image).tobytes()).hexdigest()


def refused(text: str, *parts: str) -> Any:
    """Expect an InputError of one line with these parts."""
    return pytest.raises(InputError, match=".*".join([text, *parts]))
