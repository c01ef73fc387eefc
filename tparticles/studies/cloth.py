"""Taut cloths of any stiffness: a problem of the work-precision study, and the ensemble of one mesh that solves it.

A sheet of 16 x 16 vertices is held all round under 1 % of tension, plucked in the middle, and let go in gravity and air. Its
motion is not chaotic, so that errors mean something; the higher the stiffness, the further apart are the frequencies that a picture
shows and those that limit an explicit step.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..physics.forces import Drag, Gravity
from ..physics.mesh import Mesh
from ..physics.mesh_builders import cloth
from ..schemes import Scheme
from ..stepping.contact import Contact
from ..stepping.control import Tolerance
from ..stepping.report import StepReport
from ..stepping.staged import StagedStepper
from ..systems.spring_mesh import SpringMesh
from .ensemble import Run
from .problems import reference

Array = np.ndarray
COUNT, TENSION, PLUCK, AIR = 16, 0.01, 0.05, 10.0  # vertices along an edge; strain; [m]; response time [s]
_GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass(frozen=True)
class Cloth:
    """A taut cloth of 1 m and 0.256 kg; `ratio` is k L / (m g), the stiffness of a spring over the weight of a vertex.

    Shear springs have 0.3 and bend springs 0.01 of the stiffness k of structural ones, all of them the damping 0.1 sqrt(k m).
    States are (6, 256): x and v of the vertices, in the order of the mesh.
    """

    ratio: float

    name: ClassVar[str] = "cloth"
    order: ClassVar[int] = 2
    velocity_free: ClassVar[bool] = False

    @functools.cached_property
    def mesh(self) -> Mesh:
        """The mesh, plucked."""
        mass, spacing = 0.001, 1.0 / (COUNT - 1)
        k = self.ratio * mass * -float(_GRAVITY[2]) / spacing
        sheet = cloth(counts=COUNT, size=1.0, mass=mass * COUNT**2, stiffness=k, shear=0.3 * k, bend=0.01 * k)
        across = sheet.x[:, :2] - sheet.x[:, :2].min(axis=0)  # [m] from a corner
        x = sheet.x + PLUCK * np.prod(np.sin(math.pi * across), axis=1)[:, None] * [0.0, 0.0, 1.0]
        edge = np.flatnonzero((np.abs(sheet.x[:, :2]) > 0.5 - 0.5 * spacing).any(axis=1))
        return Mesh(
            x=x,
            mass=sheet.mass,
            springs=sheet.springs,
            stiffness=sheet.stiffness,
            damping=0.1 * math.sqrt(k * mass),  # type: ignore[arg-type]
            rest=(1.0 - TENSION) * sheet.rest,
        ).pin(edge)

    @property
    def forces(self) -> tuple[Any, ...]:
        """What pulls on the cloth beside its springs."""
        return Gravity(), Drag(time=AIR)

    def start(self, count: int) -> Array:
        """Return the plucked cloth at rest; `count` is that of its vertices, whatever it says."""
        return np.concatenate([self.mesh.x.T, self.mesh.v.T])

    def rate(self, t: float, z: Array) -> Array:
        """Return dz/dt."""
        mesh = self.mesh
        i, j = mesh.springs.T
        d, w = z[:3, i] - z[:3, j], z[3:, i] - z[3:, j]
        length = np.sqrt((d * d).sum(axis=0))
        pull = (mesh.stiffness * (length - mesh.rest) + mesh.damping * (d * w).sum(axis=0) / length) / length
        n = mesh.vertex_count
        force = np.stack([np.bincount(j, pull * c, n) - np.bincount(i, pull * c, n) for c in d])
        a = force / mesh.mass + _GRAVITY[:, None] - z[3:] / AIR
        return np.concatenate([z[3:], np.where(mesh.pinned, 0.0, a)])

    def jacobian(self, t: float, z: Array) -> Any:
        """Return d(dz/dt)/dz of the flattened state, sparse."""
        from scipy.sparse import bmat, csr_matrix, diags, identity, kron

        mesh, n, m = self.mesh, self.mesh.vertex_count, self.mesh.spring_count
        i, j = mesh.springs.T
        d, w = z[:3, i] - z[:3, j], z[3:, i] - z[3:, j]
        length = np.sqrt((d * d).sum(axis=0))
        u, rate = d / length, (d * w).sum(axis=0) / length
        across = (mesh.stiffness * (length - mesh.rest) + mesh.damping * rate) / length
        eye = np.eye(3)[:, :, None]
        along = np.einsum("as,bs->abs", u, u)
        # T = k (l - l0) + c u.w and its direction u: dT/dx also has c (w - u (u.w)) / l
        turned = mesh.damping / length * np.einsum("as,bs->abs", u, w - u * rate)
        by_x = mesh.stiffness * along + turned + across * (eye - along)
        by_v = mesh.damping * along
        row = np.arange(m)
        ends = csr_matrix((np.repeat([1.0, -1.0], m), (np.tile(row, 2), np.r_[i, j])), (m, n))
        wide = kron(identity(3), ends, "csr")
        weights = np.tile(np.where(mesh.pinned, 0.0, 1.0 / mesh.mass), 3)

        def assembled(blocks: Array) -> Any:
            middle = bmat([[diags(blocks[a, b]) for b in range(3)] for a in range(3)], "csr")
            return -diags(weights) @ wide.T @ middle @ wide

        free = np.tile(np.where(mesh.pinned, 0.0, 1.0), 3)
        return bmat([[None, identity(3 * n)], [assembled(by_x), assembled(by_v) - diags(free / AIR)]], "csc")

    def solution(self, t: float, z0: Array) -> Array:
        """Return a reference solution."""
        return reference(self, t, z0, accuracy=1e-9)


class MeshEnsemble:
    """The mesh of one problem, ready to be advanced by one scheme after another; what `Ensemble` is to particles."""

    def __init__(self, problem: Cloth):
        self.problem, self.count = problem, problem.mesh.vertex_count
        self._ready: tuple[Scheme, SpringMesh, StagedStepper] | None = None

    def run(
        self, scheme: Scheme, times: Sequence[float] | Array, dt: float, *, tolerance: Tolerance | None = None
    ) -> Run:
        """Advance from the start at 0 to each of `times`, in steps of at most `dt`, and return all states there.

        Steps are counted per vertex. Compilation is not part of `seconds`.
        Raises RunError where an implicit stage has no solution.
        """
        assert tolerance is None  # a mesh has no steps of its own choice
        mesh = self.problem.mesh
        system, stepper = self._stepper(scheme)
        system.write(mesh.x, mesh.v)
        stepper.forget()
        if stepper.solver:
            stepper.solver.tension = None
        states, before, steps, seconds = [], 0.0, 0, 0.0
        for t in times:
            begin = time.perf_counter()
            report = stepper.advance(before, float(t), dt)
            seconds += time.perf_counter() - begin
            x, v = system.read()
            states.append(np.concatenate([x.T, v.T]))
            before, steps = float(t), steps + report.steps
        return Run(np.array(times, float), np.array(states), StepReport(steps=steps * self.count), seconds)

    def _stepper(self, scheme: Scheme) -> tuple[SpringMesh, StagedStepper]:
        if self._ready is None or self._ready[0] is not scheme:
            mesh = self.problem.mesh
            system = SpringMesh(mesh, forces=self.problem.forces, fixed=mesh.pinned, registers=scheme.registers)
            stepper = StagedStepper(
                system,
                scheme=scheme,
                clamp="equal",
                contact=Contact(system, (), radius=0.0),
                driven=np.zeros(0, np.int32),
                drive=lambda t: np.zeros((0, 3)),
                velocity_free=False,
            )
            stepper.advance(0.0, 1e-9, 1e-10)  # this compiles
            self._ready = scheme, system, stepper
        return self._ready[1], self._ready[2]
