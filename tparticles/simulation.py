"""The join: allocates a scene, advances it from frame time to frame time, draws it.

births -> advance t_k..t_k+1 (sub-steps) -> deaths, compaction -> film -> picture. Time is `frame * den / num`, a fraction, so no
frame is off by accumulated rounding.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from . import backend
from .errors import InputError, RunError
from .frame import Frame, FrameReport
from .particle_motion import ParticleMotion, Plan, allocated
from .render.appearance import film_background
from .render.film import Dots, Film
from .render.project import camera_row
from .scene import Scene
from .stepping.control import check_precision
from .stepping.rows import Request
from .systems.attributes import bytes_allocated
from .systems.population import WHOLE, Share
from .systems.terms import LawError

if TYPE_CHECKING:
    from .mesh_motion import MeshMotion

_FEW_DOTS, _MOST_DOTS = 1 << 14, 1 << 20  # dots handed to the film at a time: room for at least, at most


class Simulation:
    """A scene at work. One simulation at a time owns the backend of a process, on the thread that made it.

    Fields of an old simulation stay allocated until `backend.stop()`.

    Arguments:
        scene: what to simulate.
        quality: which size to draw if the scene names none.
        size, fps, seed, scheme: in place of the scene's own.
        arch, threads, precision: see `backend.start`.
        share: the part of the particles to simulate; all by default.
        records: what to record of the meshes, by name; each needs a sink before it runs.

    Raises:
        InputError, BackendError: before anything is allocated.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        quality: str = "final",
        size: tuple[int, int] | None = None,
        fps: Fraction | int | str | None = None,
        seed: int | None = None,
        scheme: Any = None,
        arch: str = "auto",
        threads: int | None = None,
        precision: str = "f32",
        share: Share = WHOLE,
        records: Mapping[str, Request] | None = None,
    ):
        if not isinstance(scene, Scene):
            raise InputError(f"Simulation takes a Scene, not {type(scene).__name__}")
        options = {"size": size, "fps": fps, "seed": seed, "scheme": scheme}
        self.scene = dataclasses.replace(scene, **{k: v for k, v in options.items() if v is not None})
        self.backend = backend.start(arch=arch, threads=threads, precision=precision)
        scene = self.scene
        self.width, self.height = scene.resolution(quality)
        self.frame_seconds = 1 / scene.fps
        check_precision(scene.steps, self.backend.precision)
        plans = [Plan.of(group, scene, share) for group in scene.particles]
        _check_memory(plans, self.backend.precision)
        self._camera_at = 0.0, camera_row(scene.camera.pose(0.0), self.width, self.height)
        # A cached kernel fits if its fields were created in the same order and laid out with the same others. So the film
        # comes first, in a size that most scenes share, and then each group by itself.
        most = max([1, *(plan.capacity for plan in plans), *(m.mesh.spring_count for m in scene.meshes)])
        room = 1 << (most - 1).bit_length()
        room = min(_MOST_DOTS, max(_FEW_DOTS, room))
        self.film, self.dots = make_film(scene, (self.width, self.height), capacity=room), Dots(room)
        self.groups: list[ParticleMotion | MeshMotion] = [*allocated(plans, scene, share)]
        for spec in scene.meshes if share.index == 0 else ():  # whose vertices depend on each other: no shares of them
            from .mesh_motion import MeshMotion  # here: a film without meshes starts sooner

            self.groups.append(
                MeshMotion(
                    spec,
                    scheme=scene.scheme,
                    steps=scene.steps,
                    clamp=scene.clamp,
                    look=scene.look,
                    frame=float(self.frame_seconds),
                    record=(records or {}).get(spec.name),
                )
            )
        self.table, self.film_max = scene.look.display_table()
        self._frame = scene.first_frame
        self._report: FrameReport | None = None  # what has been counted towards the next frame that is asked for

    def finished(self, number: int) -> None:
        """A frame is on the disk: nothing of it is kept here."""

    def time(self, frame: int) -> float:
        """Return the time [s] that a frame shows: frame * den / num, rounded once."""
        return float(Fraction(frame) / self.scene.fps)

    def frames(
        self, numbers: Sequence[int] | None = None, *, after: Callable[[int], None] = lambda number: None
    ) -> Iterator[Frame]:
        """Simulate and yield the frames `numbers` (rising, from 1), all of them by default; the others are not drawn.

        `after` is called with the number of each simulated frame, drawn or not, when a `snapshot` may be taken.

        Raises:
            RunError: a particle went astray, a group overflowed; names frame, group and particle or emitter.
        """
        for report in self.exposures(numbers, after=after):
            yield Frame(report.frame, self.develop(report), report, self)

    def exposures(
        self, numbers: Sequence[int] | None = None, *, after: Callable[[int], None] = lambda number: None
    ) -> Iterator[FrameReport]:
        """Do as `frames`, and leave the film undeveloped; yield the reports."""
        last = self.scene.frame_count
        for number in range(1, last + 1) if numbers is None else numbers:
            if not 1 <= number <= last:
                raise InputError(f"frame {number} leaves the film, which has frames 1-{last}")
            if number <= self._frame:
                raise InputError(f"frame {number} is past: the simulation has reached frame {self._frame}")
            report = self.advance_to(number, after=after)
            self._expose(report)
            yield report
            after(number)

    def advance_to(self, number: int, *, after: Callable[[int], None] = lambda number: None) -> FrameReport:
        """Advance to a frame without drawing; return the counts since the last frame that was asked for.

        `after` is called for the frames on the way.
        """
        report = self._report = self._report or FrameReport(number, 0.0)
        report.frame, report.time = number, self.time(number)
        while self._frame < number:
            end = min(0, self._frame + self.scene.stride) if self._frame < 0 else self._frame + 1
            t0, t1 = self.time(self._frame), self.time(end)
            for group in self.groups:
                self._advance(group, report, t0, t1)
            self._frame = end
            if self._frame < number:
                after(self._frame)
        report.alive = sum(group.alive for group in self.groups)
        self._report = None
        return report

    def snapshot(self) -> dict[str, dict[str, np.ndarray | int | float]]:
        """Return all that the frames to come depend on: counters of the frame on the way, and what each group says of itself."""
        counts = dataclasses.asdict(self._report or FrameReport(self._frame, 0.0))
        counts |= {f"ms {part}": ms for part, ms in counts.pop("ms").items()}
        del counts["solves"]  # of the last frame alone
        return {"film": counts | {"frame": self._frame}} | {f"group {g.spec.name}": g.snapshot() for g in self.groups}

    def restore(self, state: Mapping[str, Mapping[str, np.ndarray | int | float]]) -> None:
        """Go on from a `snapshot` of a simulation of the same scene: the frames to come have the same bits.

        Raises:
            RunError: it is of another scene; InputError: a log goes with it, which this does not continue.
        """
        if "log" in state:
            raise InputError(
                "the checkpoint is of a run with a log: resume with the same --log, or begin anew without --resume"
            )
        if list(state) != ["film", *(f"group {group.spec.name}" for group in self.groups)]:
            raise RunError(f"the state holds {', '.join(state)}: it is of another scene")
        for group in self.groups:
            group.restore(state[f"group {group.spec.name}"])
        counts: dict[str, Any] = dict(state["film"])
        ms = {part: counts.pop(f"ms {part}") for part in ("births", "step", "draw")}
        self._frame = counts["frame"]
        self._report = FrameReport(**counts, ms=ms)

    def _advance(self, group: ParticleMotion | MeshMotion, report: FrameReport, t0: float, t1: float) -> None:
        start = time.perf_counter()
        report.born += group.emit(t0, t1)
        middle = time.perf_counter()
        try:
            steps, died = group.advance(t0, t1, self._camera(t1))
        except LawError as error:
            raise InputError(f"group '{group.spec.name}': {error.reason}") from None
        except RunError as error:
            raise RunError(
                f"frame {self._frame + 1}, group '{group.spec.name}': {error} "
                f"(t = {t1:.6g} s, scheme {group.scheme.name}, dt <= {group.dt:.3g} s)"
            ) from None
        report.add_steps(group.spec.name, steps)
        report.died += died
        report.ms["births"] += (middle - start) * 1e3
        report.ms["step"] += (time.perf_counter() - middle) * 1e3

    def _camera(self, t: float) -> np.ndarray:
        if self._camera_at[0] != t:
            self._camera_at = t, camera_row(self.scene.camera.pose(t), self.width, self.height)
        return self._camera_at[1]

    def draw(self, report: FrameReport) -> np.ndarray:
        """Draw the present state; return the picture, (h, w, 3) uint8."""
        self._expose(report)
        return self.develop(report)

    def _expose(self, report: FrameReport) -> None:
        start = time.perf_counter()
        self.film.clear()
        shutter = self.scene.shutter * float(self.frame_seconds)
        for group in self.groups:
            group.draw(self.film, self.dots, t=report.time, shutter=shutter, camera=self._camera(report.time))
        report.ms["draw"] += (time.perf_counter() - start) * 1e3

    def develop(self, report: FrameReport) -> np.ndarray:
        """Return the picture of what was drawn last, (h, w, 3) uint8."""
        start = time.perf_counter()
        image = self.film.develop(self.table, self.film_max, dither=self.scene.look.dither)
        report.ms["draw"] += (time.perf_counter() - start) * 1e3
        return image


def make_film(scene: Scene, size: tuple[int, int], *, capacity: int) -> Film:
    """Return a film of `size` (width, height) [px] with the scene's background, for dots `capacity` at a time."""
    film = Film(*size, capacity=capacity)
    film.set_background(film_background(scene.background, scene.look, *size))
    return film


def _check_memory(plans: Sequence[Plan], precision: str) -> None:
    """Refuse what cannot fit before it is allocated."""
    needed = [plan.capacity * bytes_allocated(plan.names, precision, plan.more) for plan in plans]
    available = backend.memory()
    if sum(needed) > available:
        largest = plans[needed.index(max(needed))]
        raise InputError(
            f"group '{largest.spec.name}': room for {largest.capacity} particles takes {max(needed) / 2**30:.1f} GiB "
            f"({sum(needed) / 2**30:.1f} GiB with all groups), this machine has {available / 2**30:.1f} GiB; "
            "give shorter lifetimes, lower rates or a Group.capacity"
        )


def room(scene: Scene, *, precision: str, share: Share = WHOLE) -> tuple[int, int]:
    """Return how many particles of a share can be alive at once, and the bytes that they take; allocates nothing."""
    plans = [Plan.of(group, scene, share) for group in scene.particles]
    needed = [plan.capacity * bytes_allocated(plan.names, precision, plan.more) for plan in plans]
    return sum(plan.capacity for plan in plans), sum(needed)
