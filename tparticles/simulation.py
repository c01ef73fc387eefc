"""The join: allocates a scene, advances it from frame time to frame time, draws it.

births -> advance t_k..t_k+1 (sub-steps) -> deaths, compaction -> film -> picture. Time is `frame * den / num`, a fraction, so no
frame is off by accumulated rounding.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from . import backend
from .binding import Parameters
from .errors import InputError, RunError
from .physics.emitters import Schedule
from .render.appearance import film_background
from .render.film import Dots, Film
from .render.project import Projector, camera_row, draw
from .scene import Group, Scene
from .schemes import Scheme
from .stepping.control import Fixed, StabilityLimit, check_precision, frame_step
from .stepping.fused import FusedStepper, StepReport
from .stepping.pace import memory
from .systems.attributes import Attribute, Columns, bytes_allocated
from .systems.mortality import Mortality
from .systems.population import Population, schedules
from .systems.view import View

_FEW_DOTS, _MOST_DOTS = 1 << 14, 1 << 20  # dots handed to the film at a time: room for at least, at most
_LEAST, _SMALL = 1 << 12, 1 << 16  # slots of a group, see `_roomy`


@dataclass
class FrameReport:
    """What one frame took. `ms`: milliseconds in births, step, draw; dt in seconds."""

    frame: int
    time: float
    born: int = 0
    died: int = 0
    alive: int = 0
    steps: int = 0
    rejected: int = 0
    dt_min: float = 0.0
    dt_max: float = 0.0
    ms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(("births", "step", "draw"), 0.0))

    def row(self) -> dict[str, Any]:
        """Return the report as a row of run.json."""
        return dataclasses.asdict(self)

    def add_steps(self, report: StepReport) -> None:
        """Count in what a stepper did."""
        self.rejected += report.rejected
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


@dataclass(frozen=True)
class _Plan:
    """What a group will need, worked out before anything is allocated. `dt` [s] is the step to hand to the kernel."""

    spec: Group
    births: list[Schedule]
    capacity: int
    names: tuple[str, ...]
    more: tuple[Attribute, ...]
    scheme: Scheme
    dt: float

    @classmethod
    def of(cls, spec: Group, scene: Scene) -> _Plan:
        """Plan a group of `scene`. Births are made up to the film's duration, whatever the frame rate."""
        frame = float(1 / scene.fps)
        births = schedules(spec.name, spec.emitters, seed=scene.seed, end=scene.duration)
        bound = spec.jacobian_bound() if isinstance(scene.steps, StabilityLimit) else None
        scheme = scene.running_scheme
        return cls(
            spec,
            births,
            spec.derived_capacity(births, look=scene.look, frame=frame),
            spec.attributes(streaks=scene.shutter > 0),
            memory(scheme, spec.components, adaptive=scene.adaptive),
            scheme,
            frame_step(scene.steps, scheme=scheme, bound=bound, frame=frame, damping=spec.system.damping),
        )


def _roomy(capacity: int) -> int:
    """Round a small derived capacity up to a power of two: kernels know their fields' sizes, and another rate shares them."""
    return capacity if capacity > _SMALL else max(_LEAST, 1 << (capacity - 1).bit_length())


class _Group:
    """One allocated group."""

    def __init__(self, plan: _Plan, scene: Scene):
        spec = self.spec = plan.spec
        self.dt = plan.dt
        self.columns = Columns(plan.names, plan.capacity if spec.capacity else _roomy(plan.capacity), more=plan.more)
        constants = spec.constants()
        self.view = View(self.columns, Parameters(), cooling=spec.cooling, constants=constants)
        self.stepper = FusedStepper(
            spec.system,
            cooling=spec.cooling,
            scheme=plan.scheme,
            clamp=scene.clamp,
            columns=self.columns,
            size=constants.size,
            tolerance=None if isinstance(scene.steps, Fixed | StabilityLimit) else scene.steps,
        )
        self.projector = Projector(self.view, spec.appearance, scene.look)
        self.mortality = Mortality(
            self.columns,
            self.view,
            region=spec.region,
            frost=self.projector if spec.freezes else None,
            ages=any(e.lifetime is not None for e in spec.emitters),
        )
        self.population = Population(spec.name, spec.emitters, columns=self.columns, schedules=plan.births)

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
    """A scene at work. One simulation at a time owns the backend of a process, on the thread that made it.

    Fields of an old simulation stay allocated until `backend.stop()`.

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
        self.width, self.height = scene.resolution(quality)
        self.frame_seconds = 1 / scene.fps
        check_precision(scene.steps, self.backend.precision)
        plans = [_Plan.of(group, scene) for group in scene.groups]
        _check_memory(plans, self.backend.precision)
        self._camera_at = 0.0, camera_row(scene.camera.pose(0.0), self.width, self.height)
        # A cached kernel fits if its fields were created in the same order and laid out with the same others. So the film
        # comes first, in a size that most scenes share, and then each group by itself.
        room = 1 << (max(plan.capacity for plan in plans) - 1).bit_length()
        room = min(_MOST_DOTS, max(_FEW_DOTS, room))
        self.film, self.dots = Film(self.width, self.height, capacity=room), Dots(room)
        self.film.set_background(film_background(scene.background, scene.look, self.width, self.height))
        self.groups: list[_Group] = []
        for plan in plans:
            backend.lay_out()
            self.groups.append(_Group(plan, scene))
        self.table, self.film_max = scene.look.display_table()
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
        last = self.scene.frame_count
        for number in range(1, last + 1) if numbers is None else numbers:
            if not 1 <= number <= last:
                raise InputError(f"frame {number} leaves the film, which has frames 1-{last}")
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
        try:
            report.add_steps(group.stepper.advance(people.alive, t0, t1, group.dt, camera=self._camera(t1)))
            died = group.mortality.mark(people.alive, t1, self._camera(t1))
        except RunError as error:
            raise RunError(
                f"frame {self._frame + 1}, group '{group.spec.name}': {error} "
                f"(t = {t1:.6g} s, scheme {self.scene.scheme.name}, dt <= {group.dt:.3g} s)"
            ) from None
        report.died += people.bury(group.mortality.dead, died)
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


def _check_memory(plans: Sequence[_Plan], precision: str) -> None:
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
