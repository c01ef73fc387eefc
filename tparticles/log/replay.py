"""A log drawn again, without simulating: the scene is built from its script, and each picture gets the state of its moment."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from .. import output
from ..errors import InputError, RunError
from ..frame import FrameReport
from ..job import Job, Options
from ..mesh_motion import MeshMotion
from ..output.files import atomic_file, reason
from ..scene import Scene
from ..simulation import Simulation
from ..spec import Vec3
from .read import Log, MeshLog, ParticleLog, State, row_range

_SLACK = 1e-9  # of a frame


@dataclass(frozen=True, kw_only=True)
class View:
    """What a replay shows otherwise than the run did; None is as it was.

    `settings`: parameters of the scene, by name; `position`, `target` [m] and `fov` [degrees] of the camera. `changed`: draw with a
    script that is not the one any more that the run was of.
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    fps: str | None = None
    size: tuple[int, int] | None = None
    quality: str | None = None
    position: Vec3 | None = None
    target: Vec3 | None = None
    fov: float | None = None
    arch: str = "auto"
    threads: int | None = None
    changed: bool = False


class Replay:
    """A log and the scene that it is of.

    Raises:
        InputError: the scene is gone or another now, a setting, a size, or the log holds too little to be drawn.
    """

    def __init__(self, log: Log, view: View):
        self.log = log
        self.job = _job(log, view)
        camera = {name: getattr(view, name) for name in ("position", "target", "fov")}
        changes = {name: value for name, value in camera.items() if value is not None}
        scene = self.job.scene
        self.scene = (
            dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, **changes)) if changes else scene
        )
        for mesh in log.meshes.values():
            _check_mesh(mesh, self.scene)

    def simulation(self) -> Simulation:
        """Return the scene, allocated."""
        o = self.job.options
        with self.job.script.blamed():
            return Simulation(self.scene, quality=o.quality, arch=o.arch, threads=o.threads, precision=o.precision)

    def times(self, group: MeshLog | ParticleLog, steps: str | None, speed: float) -> list[float]:
        """Return the times [s] of the pictures: a range of steps of a group, all by default, `speed` times as fast as it was.

        Raises:
            InputError: the range leaves the log.
        """
        rows = row_range(steps, group)
        first, last = float(group.time[rows[0]]), float(group.time[rows[-1]])
        pace = Fraction(speed).limit_denominator(10**6) / self.scene.fps
        count = int((last - first) / float(pace) + _SLACK) + 1
        return [first + float(n * pace) for n in range(count)]

    def pictures(self, times: list[float]) -> Iterator[np.ndarray]:
        """Yield the picture of each time [s], which rise, (h, w, 3) uint8."""
        simulation = self.simulation()
        for number, t in enumerate(times, start=1):
            for group in simulation.groups:
                logged = self.log.groups.get(group.spec.name)
                if logged is not None and len(logged):
                    _place(group, logged, t)
            yield simulation.draw(FrameReport(number, t))


def _job(log: Log, view: View) -> Job:
    header, changes = log.header, {"fps": view.fps, "size": view.size, "quality": view.quality}
    options = header["options"] | {name: value for name, value in changes.items() if value is not None}
    if view.quality is not None and view.size is None:
        options["size"] = None
    size = options["size"]
    options |= {"size": tuple(size) if size else None, "settings": {**options["settings"], **view.settings}}
    job = Job(header["script"], Options(**options, mp4=False, arch=view.arch, threads=view.threads))
    if hashlib.sha256(job.script.source.encode()).hexdigest() != header["source"] and not view.changed:
        raise InputError(
            f"{header['script']} has changed since '{log.path}' was made; draw with it all the same by --changed"
        )
    return job


def scene_of(log: Log, *, changed: bool = False) -> Scene:
    """Return the scene that a log is of. Raises InputError as `Replay`."""
    return _job(log, View(changed=changed)).scene


def _check_mesh(logged: MeshLog, scene: Scene) -> None:
    """Refuse a log that cannot be drawn with the scene."""
    spec = next((group for group in scene.meshes if group.name == logged.name), None)
    if spec is None:
        raise InputError(f"the scene has no mesh '{logged.name}' (it has: {', '.join(g.name for g in scene.groups)})")
    if len(logged.ids) < logged.vertex_count:
        raise InputError(
            f"mesh '{logged.name}': {len(logged.ids)} of its {logged.vertex_count} vertices are logged, and all are needed to "
            "draw it; plot and export take it as it is"
        )
    if (
        not np.array_equal(spec.mesh.springs, logged.springs["springs"])
        or spec.mesh.vertex_count != logged.vertex_count
    ):
        raise InputError(f"mesh '{logged.name}' of the scene has other springs now than in the log")


def _place(group: Any, logged: MeshLog | ParticleLog, t: float) -> None:
    """Give a group the state it had at time `t` [s]."""
    state = logged.at(t)
    if isinstance(logged, ParticleLog):
        return _place_particles(group, state)
    assert isinstance(group, MeshMotion)
    group.born = True
    group.system.write(state.x, state.v)  # type: ignore[arg-type]
    if len(torn := logged.torn(t)):
        group.system.lose(np.isin(np.arange(len(logged.springs["springs"])), torn))
    return None


def _place_particles(group: Any, state: State) -> None:
    """Put the living into their slots; a slope or a step that a stepper keeps is nothing to a picture."""
    blank = group.snapshot()
    count = len(state.columns["id"])
    arrays = {
        name: np.zeros((len(value), count), value.dtype)
        for name, value in blank.items()
        if isinstance(value, np.ndarray)
    }
    for name in set(arrays) & set(state.columns):
        arrays[name] = np.ascontiguousarray(state.columns[name].T.astype(arrays[name].dtype))
    group.restore({**blank, **arrays, "born": count, "died": 0})


def write(
    pictures: Iterator[np.ndarray], path: Path, *, fps: Fraction, size: tuple[int, int], progress: Callable[[int], None]
) -> None:
    """Write pictures to `path`: a `.png` of the first, a film for `.mp4`, else numbered files in a folder.

    Raises:
        RunError: it cannot be written.
    """
    if path.suffix == ".png":
        try:
            with atomic_file(path) as file:
                file.write(output.encode_png(next(pictures), {}))
        except OSError as error:
            raise RunError(f"cannot write {path}: {reason(error)}") from error
        return
    writer = output.Mp4(path, fps=fps, size=size) if path.suffix == ".mp4" else output.PngSequence(path)
    with output.Pipeline([writer]) as pipeline:
        for number, image in enumerate(pictures, start=1):
            pipeline.submit(output.OutputFrame(number, image))
            progress(number)
