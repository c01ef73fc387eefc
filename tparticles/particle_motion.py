"""One group of particles at work: planned, allocated, advanced, drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import backend
from .binding import Parameters
from .physics.emitters import Schedule
from .render.film import Dots, Film
from .render.project import Projector, draw
from .scene import Group, Scene
from .schemes import Scheme
from .stepping.control import Fixed, StabilityLimit, equal_steps, frame_step
from .stepping.fused import FusedStepper
from .stepping.pace import memory
from .stepping.report import StepReport
from .systems.attributes import Attribute, Columns, padded
from .systems.mortality import Mortality
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
        alone = not self.spec.stepped or self.room > _SMALL
        own = self.spec.name if alone else likeness(system, self.spec.cooling)
        return [own, type(system), system.velocity_free, stored, backend.current().in_one_thread(padded(self.room))]


class _Family:
    """Groups that one kernel steps: to get it ready takes longer than to step small groups. They share their columns."""

    def __init__(self, plans: Sequence[Plan], scene: Scene):
        rooms = [padded(plan.room) for plan in plans]
        names = {name for plan in plans for name in plan.names}
        columns = Columns(names, sum(rooms), more=plans[0].more)
        self._scene, self._stepper = scene, None
        self._columns = {
            plan.spec.name: columns.part((*plan.names, *(a.name for a in plan.more)), first, plan.room)
            for plan, first in zip(plans, np.cumsum([0, *rooms]).tolist(), strict=False)
        }

    def columns(self, spec: Group) -> Columns:
        """Return a member's part of the columns."""
        return self._columns[spec.name]

    def stepper(self, plan: Plan, size: float) -> FusedStepper | None:
        """Return what steps a member whose particles have this diameter [m] where it is no attribute."""
        spec, scene, columns = plan.spec, self._scene, self._columns[plan.spec.name]
        if not spec.stepped:
            return None
        if self._stepper:
            return self._stepper.twin(spec.system, cooling=spec.cooling, columns=columns, size=size)
        self._stepper = FusedStepper(
            spec.system,
            cooling=spec.cooling,
            scheme=plan.scheme,
            clamp=scene.clamp,
            columns=columns,
            size=size,
            tolerance=None if isinstance(scene.steps, Fixed | StabilityLimit) else scene.steps,
        )
        return self._stepper


class ParticleMotion:
    """One group of particles, allocated. Arguments: see `allocated`."""

    def __init__(self, plan: Plan, scene: Scene, share: Share, family: _Family):
        spec = self.spec = plan.spec
        self.dt, self.scheme = plan.dt, scene.scheme
        # Frames that are advanced together are cut into the steps of one: a longer one might not be stable.
        self.unseen_dt = plan.dt if scene.stride == 1 else equal_steps(plan.dt, float(1 / scene.fps))
        self.columns = family.columns(spec)
        constants = spec.constants()
        self.view = View(self.columns, Parameters(), cooling=spec.cooling, constants=constants)
        self.stepper = family.stepper(plan, constants.size)
        self.projector = Projector(self.view, spec.appearance, scene.look)
        self.mortality = Mortality(
            self.columns,
            self.view,
            region=spec.region,
            frost=self.projector if spec.freezes else None,
            ages=any(e.lifetime is not None for e in spec.emitters),
        )
        self.population = Population(spec.name, spec.emitters, columns=self.columns, schedules=plan.births, share=share)

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
        return steps, self.population.bury(self.mortality.dead, died)

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
    """Allocate the groups of a scene, one after the other, by their plans for a `share` of the particles."""
    kinds, families = [plan.kind for plan in plans], {}
    for plan, kind in zip(plans, kinds, strict=True):
        backend.lay_out()
        first = kinds.index(kind)
        if first not in families:
            families[first] = _Family([other for other, its in zip(plans, kinds, strict=True) if its == kind], scene)
        yield ParticleMotion(plan, scene, share, families[first])
