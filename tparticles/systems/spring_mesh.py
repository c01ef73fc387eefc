"""A spring mesh at work: its fields, and the acceleration of a block of vertices.

Forces are gathered: each vertex sums over its own springs in a fixed order, so no atomics, the same bits for any number of threads,
and, as a spring pulls its two ends with the same rounded force, momentum is conserved to rounding. The adjacency is sliced: 16
consecutive vertices have a spring each side by side, where the compiler vectorises over them. Rows of springs that are alike and
lead to consecutive vertices, nearly all in a grid, are kept as one: a cloth takes a tenth of the memory traffic.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportOptionalSubscript=false

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..binding import Parameters
from ..hints import NO_WRAP, rolled
from ..physics.mesh import Mesh
from ..physics.repulsion import Repulsion
from .hashed_grid import HashedGrid
from .terms import FLOW_REGISTER, first_writers, force
from .topology import LANES, Adjacency
from .transfer import Contents


@ti.data_oriented
class SpringMesh:
    """The state of a mesh and its right-hand side, x' = v, v' = (springs + forces) / m.

    Arguments:
        mesh: vertices and springs.
        forces: accelerations [m/s^2] beside the springs, each a `ForceLike`.
        fixed: vertices, bool (n,), that no force moves.
        registers: how many slopes to hold.
        tallies: whether a slope holds the energy of the springs, too: half of each spring's with either end.
        repulsion: how vertices that come near each other repel.

    `z`: 6 fields (x, v) of two pages, of the padded length each: the state, and room for the next one while some vertices still
    look at this one; a pass that moves vertices reads one page and writes the other. `z0`: 6 fields of one page. `k`: 6 fields of
    slopes (7 with the energy [J]), register j from j * padded on.
    """

    def __init__(
        self,
        mesh: Mesh,
        *,
        forces: Sequence[Any],
        fixed: np.ndarray,
        registers: int,
        tallies: bool = False,
        repulsion: Repulsion | None = None,
    ):
        self.mesh, self.count = mesh, len(mesh.x)
        self.real = backend.current().real
        self.lanes = backend.current().lanes
        self.parameters = Parameters()
        terms = [term for law in forces for term in force(law, self.parameters)]
        self.terms = first_writers(terms)
        near = Adjacency.of(mesh)
        self.padded = (len(near.starts) - 1) * LANES
        self.blocks = self.padded // self.lanes
        self.damped = bool(np.any(mesh.damping > 0))
        self.tears = bool(np.any(np.isfinite(mesh.tear)))
        self._contents = Contents()
        self.z, self.z0 = self._fields(6, 2), self._fields(6)
        self.tallies = tallies
        self.k = self._fields(6 + tallies, registers)
        (self.inverse_mass,) = self._fields(1)
        # per entry of the adjacency; what a mesh does not need is not there
        self.starts = self._filled(near.starts, ti.i32)
        self.column = self._filled(near.column, ti.i32)
        self.spring = np.asarray(near.spring)
        self.overflows = near.overflows
        self.overflow = self._filled(near.overflow, ti.i32) if near.overflows else None
        self.stiffness = self._filled(self._per_entry(mesh.stiffness), self.real)
        self.rest = self._filled(self._per_entry(mesh.rest), self.real)
        self.damping = self._filled(self._per_entry(mesh.damping), self.real) if self.damped else None
        self.limit = self._filled(self._per_entry(mesh.rest * (1 + mesh.tear)), self.real) if self.tears else None
        weights = np.zeros(self.padded)
        weights[: self.count] = np.where(fixed, 0.0, 1.0 / mesh.mass)
        self.repels = repulsion is not None
        self.grid: Any = HashedGrid(repulsion, self.z, self.count) if repulsion else None
        self.straight = self.lanes == LANES and not self.tears
        if self.straight:
            first, lanes, values = self._straight_rows(near, mesh.stiffness)
            self.row_first, self.row_lanes = self._filled(first, ti.i32), self._filled(lanes, ti.i32)
            self.row_values = [self._filled(v, self.real) for v in values]
        self._contents.add(self.inverse_mass, weights)
        self._contents.fill()
        if self.grid:
            self.grid.fill()
        self.write(mesh.x, mesh.v)

    def _fields(self, components: int, times: int = 1) -> tuple[Any, ...]:
        return tuple(ti.field(self.real, self.padded * times) for _ in range(components))

    def _filled(self, values: np.ndarray, kind: Any) -> Any:
        return self._contents.add(ti.field(kind, max(1, len(values))), values if len(values) else np.zeros(1))

    def _fill(self, field: Any, values: np.ndarray) -> None:
        kind = {ti.i32: np.int32, ti.f32: np.float32, ti.f64: np.float64}[field.dtype]
        field.from_numpy(np.ascontiguousarray(values, kind))

    def _per_entry(self, values: np.ndarray) -> np.ndarray:
        """Return a spring's value for each entry, 0 for padding."""
        return np.append(np.asarray(values, float), 0.0)[self.spring]  # padding is -1

    def _straight_rows(self, near: Adjacency, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what `Adjacency.straight` does for the springs' stiffness, rest length and, where there is any, damping."""
        kind = np.float64 if self.real == ti.f64 else np.float32
        kept = [stiffness, self.mesh.rest, *([self.mesh.damping] if self.damped else [])]
        return near.straight(np.stack([self._per_entry(v) for v in kept]).astype(kind))

    def stiffen(self, stiffness: float) -> None:
        """Give all springs another stiffness [N/m], the torn ones too."""
        springs = np.full(len(self.mesh.springs), float(stiffness))
        if not len(springs):
            return
        self._fill(self.stiffness, self._per_entry(springs))
        if self.straight:
            first, lanes, values = self._straight_rows(Adjacency.of(self.mesh), springs)
            for field, row in zip(
                (self.row_first, self.row_lanes, *self.row_values), (first, lanes, *values), strict=True
            ):
                self._fill(field, row)

    def write(self, x: np.ndarray, v: np.ndarray) -> None:
        """Set positions and velocities, (n, 3) each."""
        kind = np.float64 if self.real == ti.f64 else np.float32
        self._write(*(np.ascontiguousarray(array, kind) for array in (x, v)))

    @ti.kernel
    def _write(self, x: ti.types.ndarray(ndim=2), v: ti.types.ndarray(ndim=2)):
        for i in range(self.count):
            rolled(self.starts)
            for d in ti.static(range(3)):
                self.z0[d][i], self.z0[3 + d][i] = x[i, d], v[i, d]
                for page in ti.static(range(2)):
                    at = page * self.padded + i
                    self.z[d][at], self.z[3 + d][at] = x[i, d], v[i, d]

    def read(self) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and velocities, (n, 3) each, in the precision of the run."""
        x, v = (np.empty((self.count, 3), np.float64 if self.real == ti.f64 else np.float32) for _ in range(2))
        self._read(x, v)
        return x, v

    @ti.kernel
    def _read(self, x: ti.types.ndarray(ndim=2), v: ti.types.ndarray(ndim=2)):
        for i in range(self.count):
            rolled(self.starts)
            for d in ti.static(range(3)):
                x[i, d], v[i, d] = self.z[d][i], self.z[3 + d][i]

    def whole(self) -> np.ndarray:
        """Return which springs are not torn, bool (m,)."""
        whole = np.ones(len(self.mesh.springs), bool)
        if self.tears:
            gone = (self.stiffness.to_numpy()[: len(self.spring)] == 0) & (self.spring >= 0)
            whole[self.spring[gone]] = self.mesh.stiffness[self.spring[gone]] == 0
        return whole

    def lose(self, springs: np.ndarray) -> None:
        """Tear the springs where `springs`, bool (m,), says so."""
        gone = np.append(springs, False)[self.spring]
        for field in (self.stiffness, self.damping):
            if field is not None:
                values = field.to_numpy()
                values[: len(gone)][gone] = 0
                field.from_numpy(values)

    @ti.func
    def meet(self, page):
        """Find which vertices are near each other, before a block is gathered. One thread."""
        if ti.static(self.repels):
            self.grid.sort(page * self.padded)

    @ti.func
    def gather(self, b: ti.template(), block, page, t):
        """Put state and acceleration of a block of vertices into b.z and b.a; t [s]."""
        for lane in range(b.lanes):
            i = page * self.padded + block * b.lanes + lane
            for d in ti.static(range(6)):
                b.z[d][lane] = self.z[d][i]
            for d in ti.static(range(3)):
                b.a[d][lane] = b.f[d][lane] = 0.0
        # Vectors of their own: where one loop over the lanes follows another on the same ones, the first is not vectorised.
        self._pull(b, block, page * self.padded)
        if ti.static(self.repels):
            self._repel(b, block, page * self.padded)
        self.push(b, t)
        for lane in range(b.lanes):
            w = self.inverse_mass[block * b.lanes + lane]
            for d in ti.static(range(3)):
                b.a[d][lane] = ti.select(w > 0.0, b.a[d][lane] + w * b.f[d][lane], 0.0)
            if ti.static(self.tallies):
                b.e[lane] *= 0.25  # of k (l - l0)^2

    @ti.func
    def _pull(self, b: ti.template(), block, away):
        """f_i = sum_j (k (l - l0) + c d.(v_j - v_i) / l) d / l with d = x_j - x_i, l = |d|."""
        first = block * b.lanes
        for e in range(self.starts[first // LANES], self.starts[first // LANES + 1]):
            there = -1
            if ti.static(self.straight):
                there = self.row_first[e]
                if there >= 0:
                    self._pull_row(b, e, away + there)
            if there < 0:
                for lane in range(b.lanes):
                    self._pull_entry(b, lane, e * LANES + first % LANES + lane, away)
        if ti.static(self.overflows):
            for lane in range(b.lanes):
                for entry in range(self.overflow[first + lane], self.overflow[first + lane + 1]):
                    self._pull_entry(b, lane, entry, away)

    @ti.func
    def _pull_row(self, b: ti.template(), e, there):
        """Add the forces of a row of springs that are alike, to the vertices from `there` on."""
        lanes, first = self.row_lanes[e], there & NO_WRAP
        values = ti.Vector([self.row_values[n][e] for n in ti.static(range(len(self.row_values)))])
        for lane in range(b.lanes):
            stiffness = ti.select((lanes >> lane) & 1, values[0], 0.0)
            damping = ti.cast(0.0, float)
            if ti.static(self.damped):
                damping = ti.select((lanes >> lane) & 1, values[2], 0.0)
            self._pull_by(b, lane, first + lane, stiffness, values[1], damping)

    @ti.func
    def _pull_entry(self, b: ti.template(), lane, entry, away):
        """Add the force of the spring of an entry to a vertex."""
        damping = ti.cast(0.0, float)
        if ti.static(self.damped):
            damping = self.damping[entry]
        self._pull_by(b, lane, away + self.column[entry], self.stiffness[entry], self.rest[entry], damping)

    @ti.func
    def _pull_by(self, b: ti.template(), lane, j, stiffness, rest, damping):
        """Add the force of one spring, to vertex `j`, to a vertex."""
        tiny = ti.cast(1e-30, float)
        dx, dy, dz = self.z[0][j] - b.z[0][lane], self.z[1][j] - b.z[1][lane], self.z[2][j] - b.z[2][lane]
        square = dx * dx + dy * dy + dz * dz + tiny
        inverse = 1.0 / ti.sqrt(square)
        stretch = 1.0 - rest * inverse
        pull = stiffness * stretch
        if ti.static(self.tallies):
            b.e[lane] += pull * stretch * square
        if ti.static(self.damped):
            along = (
                dx * (self.z[3][j] - b.z[3][lane])
                + dy * (self.z[4][j] - b.z[4][lane])
                + dz * (self.z[5][j] - b.z[5][lane])
            )
            pull += damping * along * inverse * inverse
        b.f[0][lane] += pull * dx
        b.f[1][lane] += pull * dy
        b.f[2][lane] += pull * dz

    @ti.func
    def _repel(self, b: ti.template(), block, away):
        """Add the forces of vertices that are near."""
        for lane in range(b.lanes):
            i = block * b.lanes + lane
            if i < self.count:
                force = self.grid.force(i, away)
                for d in ti.static(range(3)):
                    b.f[d][lane] += force[d]

    @ti.func
    def push(self, b: ti.template(), t):
        """Add the accelerations beside the springs."""
        for term, sets in ti.static(self.terms):
            for p in range(term.passes()):
                for lane in range(b.lanes):
                    value = term.evaluate(
                        term.law,
                        p,
                        t,
                        ti.Vector([b.z[d][lane] for d in ti.static(range(6))]),
                        ti.Vector([b.u[d][lane] for d in ti.static(range(3))]),
                        ti.Vector([t, 0.0]),
                    )
                    for d in ti.static(range(3)):
                        if ti.static(term.first == FLOW_REGISTER):
                            before = b.u[d][lane]
                            if ti.static(sets):
                                before = ti.select(p > 0, before, 0.0)
                            b.u[d][lane] = before + value[d]
                        else:
                            b.a[d][lane] += value[d]

    @ti.func
    def tear(self, block):
        """Tear the springs of a block of vertices that are too long; both ends see the same length."""
        first = block * self.lanes
        for e in range(self.starts[first // LANES], self.starts[first // LANES + 1]):
            for lane in range(self.lanes):
                self._tear_one(first + lane, e * LANES + first % LANES + lane)
        if ti.static(self.overflows):
            for lane in range(self.lanes):
                for entry in range(self.overflow[first + lane], self.overflow[first + lane + 1]):
                    self._tear_one(first + lane, entry)

    @ti.func
    def _tear_one(self, i, entry):
        j = self.column[entry]
        dx, dy, dz = self.z[0][j] - self.z[0][i], self.z[1][j] - self.z[1][i], self.z[2][j] - self.z[2][i]
        if dx * dx + dy * dy + dz * dz > self.limit[entry] * self.limit[entry]:
            self.stiffness[entry] = 0.0
            if ti.static(self.damped):
                self.damping[entry] = 0.0


def energies(mesh: Mesh, x: np.ndarray, v: np.ndarray, whole: np.ndarray, g: np.ndarray) -> dict[str, float]:
    """Return the energies [J] of a state in float64: kinetic, spring, and gravity in the field `g` [m/s^2] (from the origin)."""
    x, v = np.asarray(x, float), np.asarray(v, float)
    i, j = mesh.springs[whole].T if len(mesh.springs) else (np.zeros(0, int),) * 2
    stretch = np.linalg.norm(x[j] - x[i], axis=1) - mesh.rest[whole]
    return {
        "kinetic": float(0.5 * np.sum(mesh.mass * np.sum(v * v, axis=1))),
        "spring": float(0.5 * np.sum(mesh.stiffness[whole] * stretch**2)),
        "gravity": float(-np.sum(mesh.mass * (x @ g))),
    }
