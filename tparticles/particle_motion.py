"""One group of particles at work: planned, allocated, advanced, drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import backend
from .binding import Parameters
from .errors import InputError
from .physics.emitters import Schedule
from .render.film import Dots, Film
from .render.project import Projector, draw
from .scene import Group, Scene
from .schemes import Scheme
from .stepping.control import ErrorControl, PixelTolerance, StabilityLimit, Tolerance, equal_steps, frame_step
from .stepping.fused import FusedStepper
from .stepping.pace import memory
from .stepping.report import StepReport
from .systems.attributes import Attribute, Columns, padded
from .systems.kernels import Compaction
from .systems.mortality import Mortality, marks
from .systems.population import Population, Share, schedules
from .systems.terms import likeness
from .systems.view import View

_LEAST, _SMALL = 1 << 12, 1 << 16  # slots of a group, see `Plan.room`


@dataclass(frozen=True)
class Plan:
    """What a group will need, worked out before anything is allocated. `dt` [s] is the step to hand to the kernel."""

    spec: Group
    births: list[Schedule]
    capacity: int
    names: tuple[str, ...]
    more: tuple[Attribute, ...]
    scheme: Scheme
    dt: float
    tolerance: Tolerance | None

    @classmethod
    def of(cls, spec: Group, scene: Scene, share: Share) -> Plan:
        """Plan the `share` of a group of `scene`. Births are made up to the film's duration, whatever the frame rate."""
        births = schedules(spec.name, spec.emitters, seed=scene.seed, end=scene.duration)
        bound = spec.jacobian_bound() if isinstance(scene.steps, StabilityLimit) else None
        scheme = scene.running_scheme
        capacity = spec.derived_capacity(births, look=scene.look, frame=scene.longest_advance)
        consecutive = capacity if spec.capacity is None else sum(schedule.total for schedule in births)
        return cls(
            spec,
            births,
            min(capacity, share.room(consecutive, len(births))),
            spec.attributes(streaks=scene.shutter > 0),
            memory(scheme, spec.components, adaptive=scene.adaptive) if spec.stepped else (),
            scheme,
            frame_step(
                scene.steps, scheme=scheme, bound=bound, frame=float(1 / scene.fps), damping=spec.system.damping
            ),
            _tolerance(spec, scene),
        )

    @property
    def room(self) -> int:
        """How many slots the group gets: small derived capacities are rounded up, as kernels know the sizes of their fields."""
        if self.spec.capacity or self.capacity > _SMALL:
            return self.capacity
        return max(_LEAST, 1 << (self.capacity - 1).bit_length())

    @property
    def kind(self) -> list[Any]:
        """What groups are alike in that one kernel can step."""
        system, stored = self.spec.system, [name in self.names for name in ("v", "size")]
        serial = backend.current().in_one_thread(padded(self.room))
        return [*likeness(system, self.spec.cooling), type(system), system.velocity_free, stored, serial]


def _tolerance(spec: Group, scene: Scene) -> Tolerance | None:
    """Return what the errors of a group's particles are held against, if they are."""
    if isinstance(scene.steps, PixelTolerance):
        try:
            rate = spec.jacobian_bound().imaginary
        except InputError:
            rate = None  # a law of the user's need not have a bound
        return scene.steps.fitted(rate, min(spec.longest_life(scene.look), scene.duration))
    return scene.steps if isinstance(scene.steps, ErrorControl) else None


class _Shared:
    """What some groups share: their columns, compaction, and the kernel that steps those that are alike.

    To get a kernel ready takes longer than what it does for a small group.
    """

    def __init__(self, plans: Sequence[Plan], scene: Scene):
        self._scene = scene
        self._steppers: list[tuple[list[Any], FusedStepper]] = []
        more: dict[str, Attribute] = {}
        for attribute in sorted((a for plan in plans for a in plan.more), key=lambda a: a.components):
            more[attribute.name] = attribute  # the widest
        rooms = [padded(plan.room) for plan in plans]
        whole = Columns({name for plan in plans for name in plan.names}, sum(rooms), more=more.values())
        self.columns = {
            plan.spec.name: whole.part(plan.names, first, plan.room, more=plan.more)
            for plan, first in zip(plans, np.cumsum([0, *rooms]).tolist(), strict=False)
        }
        mortal = any(plan.spec.mortal for plan in plans)
        self.dead = marks(whole) if mortal else None
        self.compaction = Compaction(whole, self.dead, divided=len(plans) > 1) if mortal else None

    def stepper(self, plan: Plan, size: float) -> FusedStepper | None:
        """Return what steps a group whose particles have this diameter [m] where it is no attribute."""
        spec, scene, columns = plan.spec, self._scene, self.columns[plan.spec.name]
        if not spec.stepped:
            return None
        own = plan.kind
        for kind, stepper in self._steppers:
            if kind == own:
                return stepper.twin(
                    spec.system, cooling=spec.cooling, columns=columns, size=size, tolerance=plan.tolerance
                )
        stepper = FusedStepper(
            spec.system,
            cooling=spec.cooling,
            scheme=plan.scheme,
            clamp=scene.clamp,
            columns=columns,
            size=size,
            tolerance=plan.tolerance,
        )
        self._steppers.append((own, stepper))
        return stepper


class ParticleMotion:
    """One group of particles, allocated. Arguments: see `allocated`."""

    def __init__(self, plan: Plan, scene: Scene, share: Share, shared: _Shared):
        spec = self.spec = plan.spec
        self.dt, self.scheme = plan.dt, scene.scheme
        # Frames that are advanced together are cut into the steps of one: a longer one might not be stable.
        self.unseen_dt = plan.dt if scene.stride == 1 else equal_steps(plan.dt, float(1 / scene.fps))
        self.columns, self.compaction = shared.columns[spec.name], shared.compaction
        constants = spec.constants()
        self.view = View(self.columns, Parameters(), cooling=spec.cooling, constants=constants)
        self.stepper = shared.stepper(plan, constants.size)
        self.projector = Projector(self.view, spec.appearance, scene.look)
        self.mortality = Mortality(
            self.columns,
            self.view,
            region=spec.region,
            frost=self.projector if spec.freezes else None,
            ages=spec.ages,
            dead=shared.dead,
        )
        self.population = Population(
            spec.name,
            spec.emitters,
            columns=self.columns,
            schedules=plan.births,
            share=share,
            enough=lambda: spec.most_alive(plan.births, look=scene.look, frame=scene.longest_advance),
        )

    def snapshot(self) -> dict[str, np.ndarray | int | float]:
        """Return all that the group's future depends on: what is computed anew for each frame is not part of it."""
        return self.population.snapshot()

    def restore(self, state: Mapping[str, np.ndarray | int | float]) -> None:
        """Go on from a `snapshot`. Raises RunError if it is of another group."""
        self.population.restore(state)

    @property
    def alive(self) -> int:
        """How many particles there are."""
        return self.population.alive

    def emit(self, t0: float, t1: float) -> int:
        """Let be born who is due between two times [s]; return how many."""
        return self.population.emit(t0, t1)

    def advance(self, t0: float, t1: float, camera: np.ndarray) -> tuple[StepReport, int]:
        """Advance from `t0` to `t1` [s] and bury the dead; return the steps taken, and how many died.

        Raises:
            RunError: a particle went astray.
        """
        dt, steps = self.unseen_dt if t0 < 0.0 else self.dt, StepReport()
        if self.stepper:
            steps = self.stepper.advance(self.alive, t0, t1, dt, camera=camera)
        died = self.mortality.mark(self.alive, t1, camera)
        return steps, self.population.bury(self.compaction, died)

    def draw(self, film: Film, dots: Dots, *, t: float, shutter: float, camera: np.ndarray) -> None:
        """Add the living to the film."""
        draw(self.projector, film, dots, count=self.alive, t=t, shutter=shutter, camera=camera)

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


def allocated(plans: Sequence[Plan], scene: Scene, share: Share) -> Iterator[ParticleMotion]:
    """Allocate the groups of a scene by their plans for a `share` of the particles; small ones share what they can."""
    small = [plan for plan in plans if plan.room <= _SMALL]
    backend.lay_out()
    shared = _Shared(small, scene)
    for plan in plans:
        backend.lay_out()
        yield ParticleMotion(plan, scene, share, shared if plan.room <= _SMALL else _Shared([plan], scene))
