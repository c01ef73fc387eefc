"""The join: allocates a scene, advances it from frame time to frame time, draws it.

births -> advance t_k..t_k+1 (sub-steps) -> deaths, compaction -> film -> picture. Time is `frame * den / num`, a fraction, so no
frame is off by accumulated rounding.
"""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from . import backend
from .binding import Parameters
from .errors import InputError, RunError
from .render.appearance import film_background
from .render.film import Dots, Film
from .render.project import Projector, camera_row, draw
from .scene import Group, Scene
from .stepping.control import StabilityLimit, frame_step
from .stepping.fused import FusedStepper, StepReport
from .systems.attributes import Columns, bytes_per_particle
from .systems.mortality import Mortality
from .systems.population import Population, schedules
from .systems.view import View

_DOTS = 1 << 20  # dots handed to the film at a time


@dataclass
class FrameReport:
    """What one frame took. `ms`: milliseconds in births, step, draw; dt in seconds."""

    frame: int
    time: float
    born: int = 0
    died: int = 0
    alive: int = 0
    steps: int = 0
    dt_min: float = 0.0
    dt_max: float = 0.0
    ms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("births", "step", "draw"), 0.0))

    def row(self) -> dict[str, Any]:
        """Return the report as a row of run.json."""
        return dataclasses.asdict(self)

    def add_steps(self, report: StepReport) -> None:
        """Count in what a stepper did."""
        if report.steps:
            self.dt_min = min(self.dt_min, report.dt_min) if self.steps else report.dt_min
            self.dt_max = max(self.dt_max, report.dt_max)
            self.steps += report.steps


@dataclass
class Frame:
    """A finished frame. `state` and `linear` read the simulation and are valid until the next frame is asked for."""

    number: int
    image: np.ndarray
    report: FrameReport
    _simulation: Simulation

    def linear(self) -> np.ndarray:
        """Return the film before tone curve and background, film values, float64, shape (h, w, 3)."""
        return self._simulation.film.linear()

    def state(self) -> dict[str, dict[str, np.ndarray]]:
        """Return the living, by group: id, x [m], v [m/s] if the scene has it, T [K], age [s], birth [s]."""
        return {group.spec.name: group.state(self.report.time) for group in self._simulation.groups}


class _Group:
    """One allocated group."""

    def __init__(self, spec: Group, scene: Scene, *, frame: float, end: float):
        self.spec = spec
        births = schedules(spec.name, spec.emitters, seed=scene.seed, end=end)
        capacity = spec.derived_capacity(births, look=scene.look, frame=frame)
        names = spec.attributes(streaks=scene.shutter > 0)
        precision = backend.current().precision
        _check_memory(spec.name, capacity, bytes_per_particle(names, precision))
        self.columns = Columns(names, capacity)
        constants = spec.constants()
        self.view = View(self.columns, Parameters(), cooling=spec.cooling, constants=constants)
        bound = spec.jacobian_bound() if isinstance(scene.steps, StabilityLimit) else None
        self.dt = frame_step(scene.steps, scheme=scene.scheme, bound=bound, frame=frame)
        self.stepper = FusedStepper(
            spec.system,
            cooling=spec.cooling,
            scheme=scene.scheme,
            clamp=scene.clamp,
            columns=self.columns,
            size=constants.size,
        )
        self.projector = Projector(self.view, spec.appearance, scene.look)
        self.mortality = Mortality(
            self.columns,
            self.view,
            region=spec.region,
            brightness=self.projector if spec.freezes else None,
            ages=any(e.lifetime is not None for e in spec.emitters),
        )
        self.population = Population(spec.name, spec.emitters, columns=self.columns, schedules=births)

    def state(self, t: float) -> dict[str, np.ndarray]:
        """Return the arrays of the living at time `t` [s]."""
        people = self.population
        birth = people.read("birth")
        state = {"id": people.read("id"), "x": people.read("x"), "birth": birth, "age": t - birth}
        if "v" in self.columns:
            state["v"] = people.read("v")
        if self.spec.appearance.uses_temperature:
            state["T"] = self.view.temperatures(people.alive, t)
        return state


class Simulation:
    """A scene at work. One simulation at a time owns the backend of a process.

    Arguments:
        scene: what to simulate.
        quality: which size to draw if the scene names none.
        size, fps, seed, scheme: in place of the scene's own.
        arch, threads, precision: see `backend.start`.

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
    ):
        options = {"size": size, "fps": fps, "seed": seed, "scheme": scheme}
        self.scene = dataclasses.replace(scene, **{k: v for k, v in options.items() if v is not None})
        self.backend = backend.start(arch=arch, threads=threads, precision=precision)
        scene = self.scene
        self.width, self.height = scene.resolution(quality)  # type: ignore[arg-type]
        self.frame_seconds = 1 / scene.fps
        end = float(Fraction(scene.frame_count) / scene.fps)
        self._camera_at = 0.0, camera_row(scene.camera.pose(0.0), self.width, self.height)
        self.groups = [_Group(g, scene, frame=float(self.frame_seconds), end=end) for g in scene.groups]
        self.film = Film(self.width, self.height)
        self.film.set_background(film_background(scene.background, scene.look, self.width, self.height))
        self.dots = Dots(min(_DOTS, max(g.columns.capacity for g in self.groups)))
        self.table, self.film_max = scene.look.display_table()
        self.threshold = scene.look.threshold()
        first = min(e.first_time for g in scene.groups for e in g.emitters)
        self._frame = min(0, math.floor(Fraction(first).limit_denominator(10**6) * scene.fps))

    def time(self, frame: int) -> float:
        """Return the time [s] that a frame shows: frame * den / num, rounded once."""
        return float(Fraction(frame) / self.scene.fps)

    def frames(self, numbers: Sequence[int] | None = None) -> Iterator[Frame]:
        """Simulate and yield the frames `numbers` (rising, from 1), all of them by default; the others are not drawn.

        Raises:
            RunError: a particle went astray, a group overflowed; names frame, group and particle or emitter.
        """
        for number in numbers or range(1, self.scene.frame_count + 1):
            if number <= self._frame:
                raise InputError(f"frame {number} is past: the simulation has reached frame {self._frame}")
            report = self.advance_to(number)
            yield Frame(number, self.draw(report), report, self)

    def advance_to(self, number: int) -> FrameReport:
        """Advance to a frame without drawing; return the counts since the last frame that was asked for."""
        report = FrameReport(number, self.time(number))
        while self._frame < number:
            t0, t1 = self.time(self._frame), self.time(self._frame + 1)
            for group in self.groups:
                self._advance(group, report, t0, t1)
            self._frame += 1
        report.alive = sum(group.population.alive for group in self.groups)
        return report

    def _advance(self, group: _Group, report: FrameReport, t0: float, t1: float) -> None:
        people = group.population
        start = time.perf_counter()
        report.born += people.emit(t0, t1)
        middle = time.perf_counter()
        report.add_steps(group.stepper.advance(people.alive, t0, t1, group.dt))
        try:
            died = group.mortality.mark(people.alive, t1, self.threshold, self._camera(t1))
        except RunError as error:
            raise RunError(
                f"frame {self._frame + 1}, group '{group.spec.name}': {error} "
                f"(t = {t1:.6g} s, scheme {self.scene.scheme.name}, dt <= {group.dt:.3g} s)"
            ) from None
        if died:
            report.died += people.bury(group.mortality.dead)
        report.ms["births"] += (middle - start) * 1e3
        report.ms["step"] += (time.perf_counter() - middle) * 1e3

    def _camera(self, t: float) -> np.ndarray:
        if self._camera_at[0] != t:
            self._camera_at = t, camera_row(self.scene.camera.pose(t), self.width, self.height)
        return self._camera_at[1]

    def draw(self, report: FrameReport) -> np.ndarray:
        """Draw the present state; return the picture, (h, w, 3) uint8."""
        start = time.perf_counter()
        self.film.clear()
        shutter = self.scene.shutter * float(self.frame_seconds)
        for group in self.groups:
            draw(
                group.projector,
                self.film,
                self.dots,
                count=group.population.alive,
                t=report.time,
                shutter=shutter,
                camera=self._camera(report.time),
            )
        image = self.film.develop(self.table, self.film_max, dither=self.scene.look.dither)
        report.ms["draw"] += (time.perf_counter() - start) * 1e3
        return image


def _check_memory(name: str, capacity: int, each: int) -> None:
    """Refuse what cannot fit before it is allocated; compaction needs half as much again."""
    needed = capacity * (each + 16)
    try:
        available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return
    if needed > available:
        raise InputError(
            f"group '{name}': room for {capacity} particles takes {needed / 2**30:.1f} GiB, this machine has "
            f"{available / 2**30:.1f} GiB; give shorter lifetimes, lower rates or a Group.capacity"
        )
