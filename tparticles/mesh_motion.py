"""A mesh group at work: advances its mesh from frame to frame, watches over it, and draws it."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalCall=false

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import taichi as ti

from . import backend
from .errors import InputError, RunError
from .mesh_group import MeshGroup
from .render.dots import Dots
from .render.film import Film
from .render.look import Look
from .render.wires import WireProjector
from .schemes import Scheme
from .stepping.contact import Contact
from .stepping.control import Fixed, StabilityLimit, frame_step
from .stepping.recorder import Recorder
from .stepping.report import StepReport
from .stepping.rows import Request
from .stepping.staged import StagedStepper
from .stepping.stages import EXACT
from .systems.spring_mesh import SpringMesh, energies
from .systems.transfer import Contents

_HALVINGS = 10
_CUT = 0.7  # of its stable step is what a splitting bears whose steps are cut at contacts (Wright's effect)
_NOWHERE = 0.5  # the part of the most energy that ever moved that may come from nowhere before it counts as a blow-up


@ti.data_oriented
class _View:
    """How the renderer reads a mesh."""

    def __init__(self, system: SpringMesh):
        self.system = system
        self.vertex_count, self.spring_count = system.count, len(system.mesh.springs)
        self.pairs = tuple(ti.field(ti.i32, max(1, self.spring_count)) for _ in range(2))
        self.rest = ti.field(ti.f32, max(1, self.spring_count))
        self.torn = ti.field(ti.i32, max(1, self.spring_count)) if system.tears else None
        if self.spring_count:
            contents = Contents()
            for field, column in zip((*self.pairs, self.rest), (*system.mesh.springs.T, system.mesh.rest), strict=True):
                contents.add(field, column)
            contents.fill()

    def refresh(self) -> None:
        """Look up which springs are torn."""
        if self.torn is not None and self.spring_count:
            self.torn.from_numpy((~self.system.whole()).astype(np.int32))

    @ti.func
    def position(self, i):
        return ti.Vector([self.system.z[d][i] for d in ti.static(range(3))])

    @ti.func
    def velocity(self, i):
        return ti.Vector([self.system.z[3 + d][i] for d in ti.static(range(3))])

    @ti.func
    def ends(self, j):
        return self.pairs[0][j], self.pairs[1][j]

    @ti.func
    def strain(self, j):
        a, b = self.ends(j)
        return ti.cast((self.position(b) - self.position(a)).norm(), ti.f32) / self.rest[j] - 1.0

    @ti.func
    def whole(self, j):
        result = True
        if ti.static(self.system.tears):
            result = self.torn[j] == 0
        return result


class MeshMotion:
    """One allocated mesh group.

    Arguments:
        spec: the group.
        scheme, steps, clamp: of the scene, for where the group has none of its own.
        look: how film becomes a picture.
        frame: seconds of a frame.
        record: what to record of its steps.
    """

    def __init__(
        self,
        spec: MeshGroup,
        *,
        scheme: Scheme,
        steps: Any,
        clamp: str,
        look: Look,
        frame: float,
        record: Request | None = None,
    ):
        self.spec, self.mesh = spec, spec.mesh
        self.scheme = spec.scheme or scheme
        spec.check_scheme(self.scheme)
        steps = spec.steps or steps
        spec.check_steps(steps)
        self.stable = spec.stable_step(self.scheme)
        self.dt = self._step(steps, frame)
        recorded = record is not None
        backend.lay_out()
        self.system = SpringMesh(
            self.mesh,
            forces=spec.forces,
            fixed=self.mesh.pinned,
            registers=self.scheme.registers + recorded,  # one more for slopes that nothing but the record needs
            tallies=recorded,
            repulsion=spec.repulsion,
        )
        self.recorder = Recorder(self.system, record, gravity=spec.gravity) if record else None
        contact = Contact(self.system, spec.colliders, radius=spec.radius)
        self.driven = np.flatnonzero(self.mesh.driver >= 0).astype(np.int32)
        self.stepper = StagedStepper(
            self.system,
            scheme=self.scheme,
            clamp=spec.clamp or clamp,
            contact=contact,
            driven=self.driven,
            drive=self._path,
            velocity_free=spec.velocity_free,
            recorder=self.recorder,
        )
        if len(self.driven):
            x = self.mesh.x.copy()
            x[self.driven] = self._path(0.0)
            self.system.write(x, self.mesh.v)
        self._check_start(contact)
        self.view = _View(self.system)
        self.projector = WireProjector(self.view, spec.appearance, look)
        self.born, self.gone = False, False
        self._least: float | None = None  # energy so far [J]: all of it, and the most that moved
        self._most = 0.0

    def _step(self, steps: Fixed | StabilityLimit, frame: float) -> float:
        if isinstance(steps, Fixed):
            return frame_step(steps, scheme=self.scheme, bound=None, frame=frame)
        if self.stable == 0:
            raise InputError(
                f"group '{self.spec.name}': scheme '{self.scheme.name}' has no stable step on undamped springs: take another "
                "scheme (velocity-verlet, rk4), give the springs some damping, or step with Fixed(dt)"
            )
        safety = steps.safety
        if self.spec.colliders and self.mesh.vertex_count <= EXACT and self.scheme.system_orders == {2}:
            safety *= _CUT
        # springs set no pace for an implicit scheme, and none set none at all
        return frame_step(Fixed(dt=min(safety * self.stable, frame)), scheme=self.scheme, bound=None, frame=frame)

    def _check_start(self, contact: Contact) -> None:
        """Refuse what begins inside a collider, from where no step leads out."""
        if not contact.any:
            return
        x, _ = self.system.read()
        depth = np.where(self.mesh.pinned, 0.0, -contact.nearest(x, 0.0)[0])
        deepest = int(depth.argmax())
        if depth[deepest] > 10 * contact.slack:
            raise InputError(
                f"group '{self.spec.name}': vertex {deepest} begins {depth[deepest]:.3g} m inside a collider"
                f"{f' (of the radius {self.spec.radius:g} m around it)' if self.spec.radius else ''}; "
                "move the mesh or the collider, or pin the vertex"
            )

    def _path(self, t: float) -> np.ndarray:
        """Return where the driven vertices are at time `t` [s], shape (d, 3)."""
        offsets = np.stack([path.at(t) for path in self.mesh.paths])
        return self.mesh.x[self.driven] + offsets[self.mesh.driver[self.driven]]

    @property
    def bytes(self) -> int:
        """How much memory the fields take."""
        real = 4 if backend.current().precision == "f32" else 8
        per_entry = 4 + real * (2 + self.system.damped + self.system.tears)
        return self.system.padded * real * (19 + 6 * self.system.k[0].shape[0] // self.system.padded) + (
            len(self.system.spring) * per_entry
        )

    def energies(self) -> dict[str, float]:
        """Return kinetic, spring and gravity energy [J]."""
        return energies(self.mesh, *self.system.read(), self.system.whole(), self.spec.gravity)

    @property
    def alive(self) -> int:
        """How many vertices there are."""
        return self.system.count if self.born and not self.gone else 0

    def emit(self, t0: float, t1: float) -> int:
        """Let the mesh begin, at t = 0; return how many vertices began."""
        if self.born or t1 <= 0:
            return 0
        self.born = True
        return self.system.count

    def advance(self, t0: float, t1: float, camera: np.ndarray) -> tuple[StepReport, int]:
        """Advance from `t0` to `t1` [s]; return the steps taken, and how many vertices vanished.

        Raises:
            RunError: it blew up.
        """
        if not self.alive:
            return StepReport(), 0
        report = self._advance(max(t0, 0.0), t1)
        return report, self.system.count if self.gone else 0

    def _advance(self, t0: float, t1: float) -> StepReport:
        dt, before = self.dt, self.snapshot() if self.spec.guard == "halve" else None
        mark = self.recorder.mark() if self.recorder else None
        for _ in range(_HALVINGS + 1):
            try:
                report = self.stepper.advance(t0, t1, dt)
                self._watch(dt)
            except RunError as error:
                if self.spec.guard == "kill":
                    self.gone = True
                    return StepReport()
                if before is None or dt <= self.dt / 2**_HALVINGS:
                    raise error from None
                dt /= 2
                self.restore(before)
                if self.recorder and mark:
                    self.recorder.rewind(mark, t0)
            else:
                return report
        raise AssertionError("the loop returns or raises")

    def _watch(self, dt: float) -> None:
        """Find what has blown up."""
        advice = "" if math.isinf(self.stable) else f"; its stable step on these springs is {self.stable:.3g} s"
        if self.spec.colliders and self.scheme.system_orders == {2} and dt > _CUT * self.stable:
            advice += ", but contacts set swinging what such steps hardly bear: take StabilityLimit(safety=0.6) or some damping"
        advice = f"with steps of {dt:.3g} s of '{self.scheme.name}'{advice}"
        x, v = self.system.read()
        bad = np.flatnonzero(~(np.isfinite(x).all(axis=1) & np.isfinite(v).all(axis=1)))
        if len(bad):
            raise RunError(f"vertex {bad[0]} is no number any more {advice}")
        if len(self.mesh.springs):
            whole = self.system.whole()
            i, j = self.mesh.springs.T
            stretch = np.where(whole, np.linalg.norm((x[j] - x[i]).astype(float), axis=1) / self.mesh.rest, 0.0)
            if stretch.max() > self.spec.longest:
                worst = int(stretch.argmax())
                raise RunError(
                    f"spring {worst} (vertices {i[worst]} and {j[worst]}) is {stretch[worst]:.3g} times as long as at rest "
                    f"(at most {self.spec.longest:g}) {advice}"
                )
        # (springs solved for to a part of their length, as pictures are, hold no energy that means anything)
        if self.spec.conserves and (not self.scheme.implicit or backend.current().precision == "f64"):
            energy = energies(self.mesh, x, v, self.system.whole(), self.spec.gravity)
            total, moving = sum(energy.values()), energy["kinetic"] + energy["spring"]
            if self._least is None:
                first = energies(
                    self.mesh, self.mesh.x, self.mesh.v, np.ones(len(self.mesh.springs), bool), self.spec.gravity
                )
                self._least = sum(first.values())
            rounding = self._rounding(float(np.abs(x).max()))
            self._most = max(self._most, moving)
            if total - self._least > _NOWHERE * self._most + rounding:
                fastest = int(np.linalg.norm(v, axis=1).argmax())
                raise RunError(
                    f"the energy grew by {total - self._least:.3g} J from nowhere, to {moving:.3g} J; "
                    f"vertex {fastest} is the fastest, {advice}"
                )
            self._least = min(self._least, total)

    def _rounding(self, reach: float) -> float:
        """Return the energy [J] that rounding, and the slack of a contact, may make of positions up to `reach` [m]."""
        slack = self.stepper.contact.slack + reach * (1e-6 if backend.current().precision == "f32" else 1e-14)
        weight = self.mesh.mass.sum() * np.linalg.norm(self.spec.gravity)
        return float(weight * slack + self.mesh.stiffness.sum() * slack**2)

    def snapshot(self) -> dict[str, Any]:
        """Return all that the next frame depends on."""
        s = self.system
        arrays = {f"z{d}": field.to_numpy()[: s.padded] for d, field in enumerate(s.z)}
        arrays |= {f"k{d}": field.to_numpy() for d, field in enumerate(s.k)}
        if self.stepper.contact.any:
            arrays["touching"] = self.stepper.contact.touching.to_numpy()
        if s.tears:
            arrays["whole"] = s.whole()
        least = math.nan if self._least is None else self._least
        return (
            arrays
            | self.stepper.past()
            | {"born": int(self.born), "gone": int(self.gone), "least": least, "most": self._most}
        )

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `snapshot` returned."""
        for name, fields in (("z", self.system.z), ("k", self.system.k)):
            for d, field in enumerate(fields):
                field.from_numpy(np.resize(state[f"{name}{d}"], field.shape))  # both pages of z
        if self.stepper.contact.any:
            self.stepper.contact.touching.from_numpy(np.ascontiguousarray(state["touching"]))
        if self.system.tears:
            self.system.lose(~np.asarray(state["whole"], bool))
        self.stepper.set_past(state)
        self.born, self.gone = bool(state["born"]), bool(state["gone"])
        least, self._most = float(state["least"]), float(state["most"])
        self._least = None if math.isnan(least) else least

    def state(self, t: float) -> dict[str, np.ndarray]:
        """Return the arrays of the vertices at time `t` [s]."""
        x, v = self.system.read()
        count = self.alive
        state = {
            "id": np.arange(count, dtype=np.int32),
            "x": x[:count],
            "birth": np.zeros(count),
            "age": np.full(count, t),
        }
        return state | {"v": v[:count]}

    def draw(self, film: Film, dots: Dots, *, t: float, shutter: float, camera: np.ndarray) -> None:
        """Add the mesh to the film."""
        if self.alive:
            self.view.refresh()
            self.projector.draw(film, dots, temperature=self.spec.temperature_at(t), shutter=shutter, camera=camera)
