"""A simulation that is logged while it runs."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, RunError, unknown
from ..frame import Frame, FrameReport
from ..mesh_motion import MeshMotion
from ..output.files import remove_leftovers
from ..simulation import WHOLE, Share
from ..stepping.rows import Request
from . import layout
from .sink import LogWriter

if TYPE_CHECKING:
    from ..job import Job
    from ..scene import Scene

_STALE = 0.5  # [s] after which rows that do not fill their memory are written all the same
_SECTION = "log"  # of a checkpoint
_OPTIONS = ("fps", "size", "quality", "seed", "scheme", "precision")


@dataclass(frozen=True, kw_only=True)
class Logging:
    """What is logged: every n-th step, the vertices `ids` (`0-99,200`; all where it is None), and the `groups` (all where empty).

    Raises:
        InputError: a number that is none.
    """

    every: int = 1
    ids: str | None = None
    groups: tuple[str, ...] = ()

    def requests(self, scene: Scene) -> dict[str, Request]:
        """Return what to record of the meshes of a scene. Raises InputError: an unknown group, an id beyond a mesh."""
        names = [group.name for group in scene.groups]
        for name in self.groups:
            if name not in names:
                raise unknown("group", name, names)
        chosen = [group for group in scene.meshes if not self.groups or group.name in self.groups]
        return {g.name: Request(self.every, self._ids(g.name, g.mesh.vertex_count)) for g in chosen}

    def particles(self, scene: Scene) -> list[str]:
        """Return the names of the groups of particles that are logged."""
        return [group.name for group in scene.particles if not self.groups or group.name in self.groups]

    def check_share(self, scene: Scene, share: Share) -> None:
        """Refuse a log in parts. Raises InputError."""
        if share.count > 1 and (parts := self.particles(scene)):
            meshes = " ".join(f"--log-group {group.name}" for group in scene.meshes)
            advice = f"take {meshes}" if meshes else "leave out --shards"
            raise InputError(
                f"--log --shards: the particles of '{parts[0]}' are simulated in parts, meshes are not: {advice}"
            )

    def options(self) -> list[str]:
        """Return the options of the command line that ask for the same."""
        ids = [] if self.ids is None else ["--log-ids", self.ids]
        return ["--log", "--log-every", str(self.every), *ids, *(f"--log-group={name}" for name in self.groups)]

    def _ids(self, name: str, count: int) -> np.ndarray | None:
        if self.ids is None:
            return None
        ids = np.array(numbers(self.ids), np.int32)
        if ids[-1] >= count:
            raise InputError(f"ids '{self.ids}': mesh '{name}' has vertices 0-{count - 1}")
        return ids


def numbers(text: str) -> list[int]:
    """Return the numbers of ranges such as `0-99,200`, each once, rising. Raises InputError."""
    found: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", part.strip())
        if not match or int(match[2] or match[1]) < int(match[1]):
            raise InputError(f"ids '{text}': '{part.strip()}' is no number, and no range such as 0-99")
        found.update(range(int(match[1]), int(match[2] or match[1]) + 1))
    return sorted(found)


class LoggedSimulation:
    """A simulation as `shoot` takes it, whose frames are logged in the folder of a job.

    The log has the name of an unfinished one until the last frame. Checkpoints know how far it was: a run that goes on from one
    cuts off what came later.

    Arguments:
        job: what is rendered.
        logging: what is logged.
        share: the part of the particles that is simulated; their log would be in parts, too, so that meshes alone can be logged.
        folder: where the log goes, by default that of the job.

    Raises:
        InputError: an unknown group or vertex, a missing library, a group of particles that is simulated in parts.
    """

    def __init__(self, job: Job, logging: Logging, *, share: Share = WHOLE, folder: Path | None = None):
        layout.check_libraries("log", "h5py", "hdf5plugin")
        self._job, self._logging = job, logging
        self._folder = job.out if folder is None else folder
        requests = logging.requests(job.scene)
        logging.check_share(job.scene, share)
        self.simulation = job.simulation(share, records=requests)
        self.backend = self.simulation.backend
        motions = [group for group in self.simulation.groups if isinstance(group, MeshMotion)]
        self._meshes = [motion for motion in motions if motion.recorder]
        names = logging.particles(job.scene)
        self._particles = [g for g in self.simulation.groups if not isinstance(g, MeshMotion) and g.spec.name in names]
        self._whole = [motion.system.whole() for motion in self._meshes]
        self._ended = 0.0  # time of the last frame
        self._log: LogWriter | None = None
        self._earlier: dict[str, int] | None = None  # how much of an earlier log this one begins with

    def frames(self, numbers: Sequence[int], *, after: Callable[[int], None]) -> Iterator[Frame]:
        """Do as `Simulation.frames`, and log each frame that is simulated."""
        return self._logged(self.simulation.frames, numbers, after)

    def exposures(self, numbers: Sequence[int], *, after: Callable[[int], None]) -> Iterator[FrameReport]:
        """Do as `Simulation.exposures`, and log each frame that is simulated."""
        return self._logged(self.simulation.exposures, numbers, after)

    def _logged(self, take: Callable[..., Iterator[Any]], numbers: Sequence[int], after: Callable[[int], None]) -> Any:
        if not numbers:
            return  # there is a log already
        with self.opened() as log:

            def both(number: int) -> None:
                log(number)
                after(number)

            yield from take(numbers, after=both)

    @contextlib.contextmanager
    def opened(self) -> Iterator[Callable[[int], None]]:
        """Open the log; what this gives is to be called with the number of each frame when it has been simulated.

        Raises:
            RunError: it cannot be written.
        """
        path = self._folder / layout.UNFINISHED
        remove_leftovers(self._folder, re.escape(layout.UNFINISHED))
        log = self._log = LogWriter(path, header(self._job), *self._contents(), earlier=self._earlier)
        for motion, sink in zip(self._meshes, log.sinks, strict=True):
            assert motion.recorder
            motion.recorder.sink = sink
        try:
            yield functools.partial(self._after, log)
        except BaseException:
            with contextlib.suppress(RunError):  # what went wrong first is what is told
                self._finish(log, complete=False)
            raise
        self._finish(log, complete=True)
        os.replace(path, path.with_name(layout.NAME))

    def _finish(self, log: LogWriter, *, complete: bool) -> None:
        try:
            for motion in self._meshes:
                assert motion.recorder
                if complete and motion.alive:
                    motion.stepper.end_record(self._ended)
                motion.recorder.hand_over()
        finally:
            log.close(complete=complete)

    def _after(self, log: LogWriter, number: int) -> None:
        """Log what is logged once a frame."""
        t = self._ended = self.simulation.time(number)
        for n, motion in enumerate(self._meshes):
            assert motion.recorder
            if motion.system.tears and (torn := self._whole[n] & ~(whole := motion.system.whole())).any():
                log.torn(n, t, np.flatnonzero(torn))
                self._whole[n] = whole
            if time.monotonic() - log.sinks[n].given > _STALE:
                motion.recorder.hand_over()
        for n, group in enumerate(self._particles):
            log.particles(n, number, t, self._columns(group, t))

    def _contents(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        kind = "f8" if self.backend.precision == "f64" else "f4"
        meshes = []
        for motion in self._meshes:
            recorder, mesh = motion.recorder, motion.mesh
            assert recorder
            arrays = {
                name: getattr(mesh, name) for name in ("mass", "springs", "stiffness", "damping", "rest", "faces")
            }
            meshes.append(
                {
                    "name": motion.spec.name,
                    "attributes": {
                        "scheme": motion.scheme.name,
                        "every": recorder.every,
                        "vertices": mesh.vertex_count,
                        "gravity": motion.spec.gravity,
                        "energies": list(layout.ENERGIES),
                        "contact": list(layout.EVENT),
                        "units": "x [m], v [m/s], a [m/s^2], time and dt [s], energy [J]; the force on a vertex is mass * a",
                        "axes": "x, v, a: row, component, vertex (see id)",
                    },
                    "arrays": {"id": recorder.chosen, **arrays},
                    "vertices": len(recorder.chosen),
                    "kind": kind,
                }
            )
        return meshes, [
            {
                "name": group.spec.name,
                "attributes": {"scheme": group.scheme.name, "every": "frame"},
                "columns": {name: (a.shape[1], a.dtype.str) for name, a in self._columns(group, 0.0).items()},
            }
            for group in self._particles
        ]

    def _columns(self, group: Any, t: float) -> dict[str, np.ndarray]:
        """Return the attributes of the living that it takes to draw them, and T [K], each (count, components)."""
        state = group.snapshot()
        names = group.spec.attributes(streaks=self._job.scene.shutter > 0)
        columns = {name: np.ascontiguousarray(state[name].T) for name in names}
        if group.spec.appearance.uses_temperature:
            columns["T"] = group.view.temperatures(group.alive, t)[:, None]
        return columns

    def snapshot(self) -> Any:
        """Return the state after the latest frame, and how far the log is. Raises RunError if it cannot be written."""
        assert self._log
        recorders = [motion.recorder for motion in self._meshes if motion.recorder]
        for recorder in recorders:
            recorder.hand_over()
        marks = [list(recorder.mark()) for recorder in recorders]
        log = {"of": repr(self._logging), "marks": marks, "rows": json.dumps(self._log.mark())}
        return self.simulation.snapshot() | {_SECTION: log}

    def restore(self, state: Any) -> None:
        """Go on from a state. Raises InputError if no log, or one of other things, goes with it."""
        mark, path = state.get(_SECTION), self._folder / layout.UNFINISHED
        reason = "the checkpoint was made without a log" if mark is None else ""
        if mark and mark["of"] != repr(self._logging):
            reason = "the log of the checkpoint is of other steps, vertices or groups"
        elif mark and not path.is_file():
            reason = f"{path} is missing"
        if mark is None or reason:
            raise InputError(f"--log --resume: {reason}; begin anew without --resume")
        self.simulation.restore({name: values for name, values in state.items() if name != _SECTION})
        self._earlier = json.loads(mark["rows"])
        for motion, place in zip(self._meshes, mark["marks"], strict=True):
            assert motion.recorder
            motion.recorder.given, motion.recorder.step, motion.recorder.due = place
        self._whole = [motion.system.whole() for motion in self._meshes]

    def finished(self, number: int) -> None:
        """A frame is on the disk."""
        self.simulation.finished(number)


def header(job: Job) -> dict[str, Any]:
    """Return what a log says of its run: what run.json does, and what it takes to have the scene again."""
    options = {name: getattr(job.options, name) for name in _OPTIONS}
    settings = {name: value if isinstance(value, str) else str(value) for name, value in job.options.settings.items()}
    return job.header() | {
        "source": hashlib.sha256(job.script.source.encode()).hexdigest(),
        "options": options | {"settings": settings},
        "groups": [group.name for group in job.scene.groups],
        "duration": job.scene.duration,
    }
