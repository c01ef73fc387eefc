"""A spring mesh as part of a scene: what it is, what pulls on it, what it bounces off, how it is stepped and what it looks like."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, SkipValidation

from . import schemes
from .errors import InputError
from .physics.colliders import Surface
from .physics.forces import Gravity
from .physics.law import check_force
from .physics.mesh import Mesh
from .physics.mesh_rates import Rates, estimated_rates, largest_rates
from .physics.repulsion import Repulsion
from .render.wires import Wires
from .schemes import Scheme
from .spec import NonNegative, Positive, spec
from .stepping.control import Clamp, Fixed, StabilityLimit
from .track import Track

_MANY = 500_000  # springs: beyond it the proven bound is taken; it is quicker, and its step up to 1.4 times smaller
_TOUCHING = 12  # spheres that touch one of their size at most (Schuette and van der Waerden 1953)
_MODES = np.geomspace(1.0, 1e-3, 13)  # of the largest frequency, where the stability limit is looked up
Guard = Literal["error", "halve", "kill"]


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, tuple | list) else (value,)


def _check_mesh(value: Any) -> Any:
    if not isinstance(value, Mesh):
        raise ValueError("should be a Mesh, such as cloth(...) or rope(...)")
    return value


@spec
class MeshGroup:
    """A spring mesh: `mesh` under its springs and `forces` (accelerations [m/s^2]).

    It bounces off `colliders` where it comes nearer than `radius` [m]; by `repulsion` its vertices keep off each other.
    `scheme`, `steps` (`Fixed` or `StabilityLimit`) and `clamp` are the scene's where they are None: sparks and a stiff cloth
    seldom want the same. `temperature` [K], or a `Track` of it, is that of the whole mesh, for wires that glow.
    `guard`: what to do where the mesh blows up (no number, energy from nowhere, a spring `longest` times its rest length): "error"
    stops the film, "halve" takes the frame again with half the step, "kill" lets the mesh vanish and goes on.

    Raises:
        InputError: parts that do not fit.
    """

    name: str
    mesh: Annotated[SkipValidation[Mesh], BeforeValidator(_check_mesh)]
    forces: Annotated[SkipValidation[tuple[Any, ...]], BeforeValidator(_tuple)] = (Gravity(),)
    colliders: Annotated[SkipValidation[tuple[Any, ...]], BeforeValidator(_tuple)] = ()
    radius: NonNegative = 0.0
    repulsion: Repulsion | None = None
    appearance: Wires = Wires()
    temperature: Positive | Track | None = None
    scheme: Annotated[
        SkipValidation[Scheme | None], BeforeValidator(lambda v: None if v is None else schemes.get(v))
    ] = None
    steps: Fixed | StabilityLimit | None = None
    clamp: Clamp | None = None
    guard: Guard = "error"
    longest: Annotated[float, Field(gt=1)] = 20.0

    def __post_init__(self) -> None:
        here = f"group '{self.name}'"
        for force in self.forces:
            check_force(here, force)
        for collider in self.colliders:
            Surface.of(collider)
        self._check_repulsion(here)
        if self.appearance.by == "temperature" and self.temperature is None:
            raise InputError(f"{here}: wires coloured by temperature need one; give MeshGroup.temperature")
        if isinstance(self.temperature, Track) and self.temperature.is_vector:
            raise InputError(f"{here}: MeshGroup.temperature: a Track of numbers is needed, not of vectors")
        if self.scheme is not None:
            self.check_scheme(self.scheme)

    def _check_repulsion(self, here: str) -> None:
        if self.repulsion is None or not self.mesh.spring_count:
            return
        shortest = float(self.mesh.rest.min())
        if self.repulsion.distance > shortest * (1 + 1e-6):  # as far as it goes for rounding
            raise InputError(
                f"{here}: repulsion.distance = {self.repulsion.distance:g} m is more than the shortest spring, {shortest:g} m: "
                "the mesh would push itself apart at rest"
            )

    def check_steps(self, steps: Any) -> None:
        """Refuse a controller by which particles choose their own steps.

        Raises:
            InputError: it is neither `Fixed` nor `StabilityLimit`.
        """
        if not isinstance(steps, Fixed | StabilityLimit):
            raise InputError(
                f"group '{self.name}': a mesh steps as a whole, by Fixed or StabilityLimit, not {type(steps).__name__}; "
                "give MeshGroup.steps"
            )

    def check_scheme(self, scheme: Scheme) -> None:
        """Refuse a scheme that cannot run this mesh, before any kernel.

        Raises:
            InputError: it is for first-order systems, or its order holds without damping only.
        """
        here = f"scheme '{scheme.name}' cannot run group '{self.name}'"
        if 2 not in scheme.system_orders:
            raise InputError(f"{here}: it is for first-order systems")
        if self.repulsion and scheme.implicit:
            raise InputError(f"{here}: repulsion needs an explicit scheme, such as velocity-verlet")
        if "velocity-free forces" in scheme.needs and not self.velocity_free:
            raise InputError(
                f"{here}: its order {scheme.order} holds for forces that do not depend on the velocity, and springs with damping "
                "or a force here may (a force that does not says `velocity_free = True`); take velocity-verlet or rk4"
            )

    def stable_step(self, scheme: Scheme) -> float:
        """Return a step [s] that is stable on the springs however they turn and stretch, infinite where nothing limits it.

        Damping along the springs goes with their stiffness: a mode of frequency w has the damping ratio zeta w / w_max, if the
        stiffest one has zeta.
        """
        rates = largest_rates(self.mesh) if self.mesh.spring_count > _MANY else estimated_rates(self.mesh)
        if self.repulsion:
            rates = _with_repulsion(rates, self.repulsion, self.mesh)
        if rates.frequency == 0:
            return math.inf
        zeta = rates.damping / (2 * rates.frequency)
        return min(scheme.stability.oscillator_limit(float(zeta * f)) / (rates.frequency * f) for f in _MODES)

    @property
    def velocity_free(self) -> bool:
        """Whether no force depends on the velocity, as far as the forces say."""
        free = all(getattr(force, "velocity_free", False) for force in self.forces)
        damped = bool(np.any(self.mesh.damping > 0)) or bool(self.repulsion and self.repulsion.damping > 0)
        return free and not damped

    @property
    def conserves(self) -> bool:
        """Whether nothing here can add energy: gravity alone, no paths, nothing that moves, nothing that holds any uncounted."""
        still = all(not any(Surface.of(collider).velocity) for collider in self.colliders)
        return (
            all(isinstance(force, Gravity) for force in self.forces)
            and still
            and not self.mesh.paths
            and not self.repulsion
        )

    @property
    def gravity(self) -> np.ndarray:
        """The field of all `Gravity` forces [m/s^2], shape (3,)."""
        return np.sum([force.g for force in self.forces if isinstance(force, Gravity)] or [(0.0, 0.0, 0.0)], axis=0)

    def temperature_at(self, t: float) -> float | None:
        """Return the temperature [K] at time `t` [s]."""
        return float(self.temperature.at(t)) if isinstance(self.temperature, Track) else self.temperature


def _with_repulsion(rates: Rates, repulsion: Repulsion, mesh: Mesh) -> Rates:
    """Return the rates with each vertex pushed by as many others as can touch it."""
    most = 2 * _TOUCHING / float(mesh.mass.min())
    return Rates(
        stiffness=rates.stiffness + most * repulsion.stiffness, damping=rates.damping + most * repulsion.damping
    )
