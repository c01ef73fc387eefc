"""Lander's spring box in its room, under one scheme: thrown again and again with other springs, without another compilation."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportOptionalMemberAccess=false

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import taichi as ti

from ..errors import RunError
from ..physics.colliders import Room
from ..physics.forces import Drag, Gravity
from ..physics.mesh import Mesh
from ..physics.mesh_builders import spring_box
from ..schemes import OpKind, Scheme
from ..stepping.contact import Contact
from ..stepping.staged import StagedStepper
from ..systems.spring_mesh import SpringMesh
from .box_paper import DAMPING, DRAG, DT, GRAVITY, RESTITUTION, SIZE

VERTICES = 8
ROOM = Room(low=(-7.5, -7.5, 0.0), high=(7.5, 7.5, 15.0), restitution=RESTITUTION)

HORIZON = 60  # [s] that a thrown box is watched
WINDOW = 5  # [s] over which energy is averaged
GROWTH = 0.05  # of the first energy: what a window may have more than the one before
BLOW_UP = 100.0  # first energies
_FALL, _SAMPLE = 10.0, 0.1  # [s] of the fall under the ceiling, and between looks at it
_REPEATS, _TIMED = 15, 10.0  # launches of so many seconds; the quickest counts: others had to share the machine

Array = np.ndarray


@dataclass(frozen=True)
class Drop:
    """How a box begins: vertices about its centre, x (8, 3) [m], v (8, 3) [m/s]; how far it is squeezed depends on the springs.

    `height` of its centre [m]; `squeeze` is the spring energy that it is given [J].
    """

    x: Array
    v: Array
    height: float
    squeeze: float

    @classmethod
    def of(cls, seed: int) -> "Drop":
        """Return a random throw: any orientation, 5 to 12 m up, up to 1 m/s and 1 rad/s, squeezed by 0.5 to 2 J."""
        random = np.random.default_rng([2002, seed])
        axis, degrees = random.standard_normal(3), random.uniform(0.0, 360.0)
        box = _centred().turned(tuple(axis), degrees)
        velocity, spin = (_within_ball(random) for _ in range(2))
        shift = np.array([*random.uniform(-4.0, 4.0, 2), 0.0])
        x = box.x + shift
        return cls(
            x=x,
            v=velocity + np.cross(spin, box.x),
            height=random.uniform(5.0, 12.0),
            squeeze=random.uniform(0.5, 2.0),
        )

    def state(self, stiffness: float) -> tuple[Array, Array]:
        """Return x and v of a box with springs of `stiffness` [N/m]."""
        middle = self.x.mean(axis=0)
        # all 28 springs shortened alike: 1/2 k sum l^2 s^2 with sum l^2 = 8 sum r^2
        lengths = VERTICES * ((self.x - middle) ** 2).sum()
        shortened = np.sqrt(2.0 * self.squeeze / (stiffness * lengths))
        return middle + (1.0 - shortened) * (self.x - middle) + [0.0, 0.0, self.height], self.v


def _within_ball(random: np.random.Generator) -> Array:
    direction = random.standard_normal(3)
    return direction / np.linalg.norm(direction) * random.uniform() ** (1 / 3)


def _centred() -> Mesh:
    box = spring_box(size=SIZE, stiffness=1.0, damping=DAMPING)
    return box.moved(tuple(-box.center))


AIR = Drop(x=_centred().x, v=np.zeros((VERTICES, 3)), height=13.4, squeeze=1.0)
"""A squeezed box that is let go under the ceiling: its stiffest mode and nothing else, for 10 s of free fall."""


@dataclass(frozen=True)
class Verdict:
    """What became of a box: whether its energy grew, whether it blew up; `energy` [J], each second."""

    grew: bool
    blew: bool
    energy: tuple[float, ...]


@ti.data_oriented
class BoxRun:
    """`count` boxes, which do not see each other, as one mesh under one scheme.

    Arguments:
        scheme: for second-order systems.
        stiffness: of the springs of each box [N/m]; a single explicit one takes another with each throw.
    """

    def __init__(self, scheme: Scheme, *, stiffness: Sequence[float] = (1.0,)):
        self.scheme, self.count = scheme, len(stiffness)
        self.stiffness = np.array(stiffness, float)
        mesh = _centred()
        for _ in range(self.count - 1):
            mesh = mesh.joined(_centred())
        per_box = len(mesh.springs) // self.count
        self.mesh = Mesh(
            x=mesh.x,
            mass=mesh.mass,
            springs=mesh.springs,
            stiffness=np.repeat(self.stiffness, per_box),
            damping=mesh.damping,
            rest=mesh.rest,
        )
        self._ends, self._rest = mesh.springs[:per_box].T, mesh.rest[:per_box]
        forces = (Gravity(g=(0.0, 0.0, -GRAVITY)), Drag(time=1.0 / DRAG))
        self.system = SpringMesh(self.mesh, forces=forces, fixed=self.mesh.pinned, registers=scheme.registers)
        # wall by wall: in a corner a vertex touches three of them
        self.contact = Contact(self.system, ROOM.walls, radius=0.0)
        self.stepper = StagedStepper(
            self.system,
            scheme=scheme,
            clamp="equal",
            contact=self.contact,
            driven=np.zeros(0, int),
            drive=lambda t: np.zeros((0, 3)),
            velocity_free=False,
        )

    @property
    def evaluations(self) -> int:
        """How often a step asks for the forces."""
        table = self.stepper.table
        kinds = table.ops[: table.edges[1], 0]
        asked = np.isin(kinds, (int(OpKind.EVALUATE), int(OpKind.SOLVE))).sum()
        return int(asked) - self.stepper.reuses

    def start(self, drops: Sequence[Drop], stiffness: float | None = None) -> None:
        """Throw the boxes; `stiffness` replaces that of the only one."""
        if stiffness is not None:
            self.stiffness[:] = stiffness
            self.system.stiffen(stiffness)
        states = [drop.state(k) for drop, k in zip(drops, self.stiffness, strict=True)]
        self.system.write(*(np.concatenate(parts) for parts in zip(*states, strict=True)))
        self.stepper.forget()
        self.contact.touching.fill(0)

    def state(self) -> tuple[Array, Array]:
        """Return x and v, shape (count, 8, 3) each."""
        out = np.empty((self.system.count, 6))
        self._copy(out)
        both = out.reshape(self.count, VERTICES, 6)
        return both[..., :3], both[..., 3:]

    @ti.kernel
    def _copy(self, out: ti.types.ndarray(dtype=ti.f64, ndim=2)):
        ti.loop_config(serialize=True)
        for i in range(self.system.count):
            for d in ti.static(range(6)):
                out[i, d] = self.system.z[d][i]

    def springs(self, x: Array) -> Array:
        """Return the spring energy [J], shape (count,)."""
        a, b = self._ends
        stretch = np.linalg.norm(x[:, b] - x[:, a], axis=-1) - self._rest
        return 0.5 * self.stiffness * (stretch**2).sum(axis=-1)

    def energy(self) -> Array:
        """Return kinetic + spring + gravity energy above the floor [J], shape (count,)."""
        x, v = self.state()
        return 0.5 * (v**2).sum(axis=(1, 2)) + self.springs(x) + GRAVITY * x[..., 2].sum(axis=1)

    def watch(self, drops: Sequence[Drop], stiffness: float | None = None, *, horizon: int = HORIZON) -> list[Verdict]:
        """Throw the boxes and watch them; ends early where all have blown up, or where an implicit stage has no solution."""
        self.start(drops, stiffness)
        samples = [self.energy()]
        with np.errstate(all="ignore"):
            for second in range(horizon):
                try:
                    self.stepper.advance(second, second + 1, DT)
                except RunError:
                    samples.append(np.full(self.count, np.inf))
                else:
                    samples.append(self.energy())
                if not (samples[-1] < BLOW_UP * samples[0]).any():  # a NaN is not below either
                    break
            return [judged(column) for column in np.stack(samples, axis=1)]

    def growth(self, stiffness: float, *, steps: tuple[float, float] = (DT, DT)) -> float:
        """Return by what factor the vibration of the squeezed box grows from the third to the last quarter of its fall.

        `steps` [s] alternate.
        """
        self.start([AIR], stiffness)
        pair = sum(steps)
        per_sample = round(_SAMPLE / pair)
        samples = []
        with np.errstate(all="ignore"):
            for n in range(round(_FALL / (per_sample * pair))):
                t = n * per_sample * pair
                if steps[0] == steps[1]:
                    self.stepper.advance(t, t + per_sample * pair, steps[0])
                else:
                    for dt in steps * per_sample:
                        self.stepper.advance(t, t + dt, dt)
                        t += dt
                x, v = self.state()
                samples.append(0.5 * ((v - v.mean(axis=1, keepdims=True)) ** 2).sum() + self.springs(x)[0])
                if not samples[-1] < BLOW_UP:
                    return float("inf")
        quarter = len(samples) // 4
        third, last = np.mean(samples[-2 * quarter : -quarter]), np.mean(samples[-quarter:])
        return float(last / third)

    def microseconds(self, stiffness: float | None = None, *, repeats: int = _REPEATS) -> float:
        """Return how long a step of one box takes [us]: the quickest of some launches of many steps, in free fall."""
        quickest = np.inf
        for _ in range(repeats):
            self.start([Drop.of(0)] * self.count, stiffness)
            span = _TIMED if self.stepper.serial else 20 * DT
            start = time.perf_counter()
            self.stepper.advance(0.0, span, DT)
            quickest = min(quickest, (time.perf_counter() - start) / round(span / DT))
        return quickest * 1e6 / self.count


def judged(energy: Array) -> Verdict:
    """Judge a box by its energy [J] each second: see `GROWTH`, `WINDOW` and `BLOW_UP`."""
    first = energy[0]
    blew = bool(not np.all(energy < BLOW_UP * first))
    whole = len(energy) // WINDOW * WINDOW
    means = energy[:whole].reshape(-1, WINDOW).mean(axis=1)
    grew = blew or bool(np.any(np.diff(means) > GROWTH * first))
    return Verdict(grew, blew, tuple(energy.tolist()))
