"""What a pass does to one block of vertices: a slope from the mesh around it, and the ops that look at nothing but a vertex."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportCallIssue=false, reportOptionalMemberAccess=false

import taichi as ti

from ..hints import rolled
from ..schemes import OpKind
from ..systems.spring_mesh import SpringMesh
from ..systems.transfer import Contents
from .block import Block
from .contact import Contact
from .passes import PARTS
from .table import Table

# Ops by number: inside a kernel an enum member is no number.
_COMBINE, _KICK, _DRIFT, _ROTATE = (int(k) for k in (OpKind.COMBINE, OpKind.KICK, OpKind.DRIFT, OpKind.ROTATE))
_DIFFERENCE, _SOLVE = int(OpKind.DIFFERENCE), int(OpKind.SOLVE)

_STAGE, TURNS, _RANGES, _BEGINS = 0, 1, 2, 8  # the numbers of a pass, see `Pass`
LAYOUT = {"z": 6, "f": 3, "a": 3, "u": 3}


@ti.data_oriented
class BlockPasses:
    """The passes of a scheme on one block of a mesh.

    Arguments:
        system: the mesh.
        table: the scheme's programs.
        contact: the mesh's colliders.
    """

    def __init__(self, system: SpringMesh, table: Table, contact: Contact):
        self.system, self.table, self.contact = system, table, contact
        self.registers = table.scheme.registers
        self.edges = [int(edge) for edge in table.edges]
        self.layout = LAYOUT | ({"e": 1} if system.tallies else {})
        contents = Contents()
        self.ops = contents.add(ti.field(ti.i32, table.ops.shape), table.ops)
        self.coefficients = contents.add(ti.field(system.real, table.coefficients.shape), table.coefficients)
        contents.fill()
        # What nobody reads is not written: the state a step began with, the part v of a slope.
        self.moves = bool({_COMBINE, _SOLVE} & table.kinds)
        self.remembers = self.moves or _DIFFERENCE in table.kinds or contact.any

    @ti.func
    def take(self, block, page, passes: ti.template(), n, t, h):
        """Do pass `n`: put k_s = f(t, z) into its register, and run the ops that come with it."""
        vectors = [ti.Vector([0.0] * self.system.lanes) for _ in range(ti.static(sum(self.layout.values())))]
        b = ti.static([Block(self.layout, vectors, [], self.system.lanes)])[0]
        stage = passes[n, _STAGE]
        if stage >= 0:
            self._slope(b, block, page, self.ops[stage, 1], t + self.coefficients[stage, 0] * h, h)
        else:
            self._load(b, page * self.system.padded + block * self.system.lanes)
        for part in range(PARTS):
            if ti.static(self.remembers):
                if (passes[n, _BEGINS] >> part) & 1:
                    self._begin(b, block)
            first, last = passes[n, _RANGES + 2 * part], passes[n, _RANGES + 2 * part + 1]
            self._run(b, block, first, last, h)
        if (stage < 0) | (passes[n, TURNS] > 0):
            self._store(b, (page ^ passes[n, TURNS]) * self.system.padded + block * self.system.lanes)

    @ti.func
    def end(self, block, starting, h):
        """Run what ends a step."""
        vectors = [ti.Vector([0.0] * self.system.lanes) for _ in range(6)]
        b = ti.static([Block({"z": 6}, vectors, [], self.system.lanes)])[0]
        self._load(b, block * self.system.lanes)
        first, last = ti.static(self.edges[2]), ti.static(self.edges[3])
        if starting > 0:
            first, last = ti.static(self.edges[3]), ti.static(self.edges[4])
        self._run(b, block, first, last, h)

    @ti.func
    def evaluate(self, block, slot, t, h):
        """Put f(t, z) into a register, and change nothing else."""
        vectors = [ti.Vector([0.0] * self.system.lanes) for _ in range(ti.static(sum(self.layout.values())))]
        b = ti.static([Block(self.layout, vectors, [], self.system.lanes)])[0]
        self._slope(b, block, 0, slot, t, h)

    @ti.func
    def _slope(self, b: ti.template(), block, page, slot, t, h):
        """k_s = f(t, z) = (v, a)."""
        self.system.gather(b, block, page, t)
        if ti.static(self.contact.any):
            self.contact.press(b, block, t, h)
        for lane in range(b.lanes):
            i = slot * self.system.padded + block * b.lanes + lane
            for d in ti.static(range(3)):
                if ti.static(self.moves):
                    self.system.k[d][i] = b.z[3 + d][lane]
                self.system.k[3 + d][i] = b.a[d][lane]
            if ti.static(self.system.tallies):
                self.system.k[6][i] = b.e[lane]

    @ti.func
    def _load(self, b: ti.template(), i):
        for lane in range(b.lanes):
            for d in ti.static(range(6)):
                b.z[d][lane] = self.system.z[d][i + lane]

    @ti.func
    def _store(self, b: ti.template(), i):
        for lane in range(b.lanes):
            rolled(self.system.starts)
            for d in ti.static(range(6)):
                self.system.z[d][i + lane] = b.z[d][lane]

    @ti.func
    def _begin(self, b: ti.template(), block):
        for lane in range(b.lanes):
            rolled(self.system.starts)
            for d in ti.static(range(6)):
                self.system.z0[d][block * b.lanes + lane] = b.z[d][lane]

    @ti.func
    def turn(self, block):
        """Copy the state from the second page to the first."""
        for lane in range(self.system.lanes):
            rolled(self.system.starts)
            i = block * self.system.lanes + lane
            for d in ti.static(range(6)):
                self.system.z[d][i] = self.system.z[d][self.system.padded + i]

    @ti.func
    def _run(self, b: ti.template(), block, first, last, h):
        """Run ops first..last-1, which look at nothing but a vertex itself."""
        away, i = ti.static(self.system.padded), block * b.lanes
        for op in range(first, last):
            kind = self.ops[op, 0]
            if ti.static(_COMBINE in self.table.kinds):
                if kind == _COMBINE:
                    for lane in range(b.lanes):
                        for d in ti.static(range(6)):
                            b.z[d][lane] = self.system.z0[d][i + lane]
                    self._add(b, i, op, h, ti.static(range(6)))
            if ti.static(_KICK in self.table.kinds):
                if kind == _KICK:
                    self._add(b, i, op, h, ti.static(range(3, 6)))
            if ti.static(_DRIFT in self.table.kinds):
                if kind == _DRIFT:
                    w = self.coefficients[op, 1] * h
                    for lane in range(b.lanes):
                        for d in ti.static(range(3)):
                            b.z[d][lane] += w * b.z[3 + d][lane]
            if ti.static(_ROTATE in self.table.kinds):
                if kind == _ROTATE:
                    to, source = self.ops[op, 1] * away + i, self.ops[op, 2] * away + i
                    for d in ti.static(range(0 if self.moves else 3, len(self.system.k))):
                        # through a local vector: for all that the compiler knows, the registers overlap
                        moved = ti.Vector([0.0] * self.system.lanes)
                        for lane in range(b.lanes):
                            moved[lane] = self.system.k[d][source + lane]
                        for lane in range(b.lanes):
                            self.system.k[d][to + lane] = moved[lane]
            if ti.static(_DIFFERENCE in self.table.kinds):
                if kind == _DIFFERENCE:
                    to = self.ops[op, 1] * away + i
                    for lane in range(b.lanes):
                        rolled(self.system.starts)
                        for d in ti.static(range(6)):
                            self.system.k[d][to + lane] = (b.z[d][lane] - self.system.z0[d][i + lane]) / h

    @ti.func
    def _add(self, b: ti.template(), i, op, h, components: ti.template()):
        """z += h sum_j w_j k_j, in some components."""
        for j in range(ti.static(self.registers)):
            w = self.coefficients[op, 1 + j] * h
            if w != 0.0:
                for lane in range(b.lanes):
                    for d in ti.static(components):
                        b.z[d][lane] += w * self.system.k[d][j * self.system.padded + i + lane]
