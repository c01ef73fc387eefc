"""Newton's method for an implicit stage, per particle, in the lanes of a block (slides 35-39).

SOLVE asks for z = zbar + g f(t, z), g = w dt. The unknown is the slope q of the state's last vector, three numbers: for a first-
order system x = xbar + g q and q = u(t, x); for a second-order one v = vbar + g q, x = xbar + g v and q = a(t, x, v). So x is
eliminated, and a column of the Jacobian costs one evaluation whatever the order: x and v move together. Columns are differences,
so that a user's law needs no derivatives; they only have to be good enough to converge. An integrated temperature depends on
itself alone and has a scalar equation of its own.

A round is one evaluation of f for the whole block. Rounds go by a fixed timetable: a residual, three columns, residuals with those
columns (chords), then new columns. Before it come a few chords with the columns of the stage or step before, of the same g, for
lanes that have them: while f changes little, two evaluations solve a stage. A lane that is done keeps its q and its columns, and
one that has to wait keeps all, so the result does not depend on the neighbours.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false

import numpy as np
import taichi as ti

from .. import backend

_CYCLE = 9  # rounds from one Jacobian to the next: a residual, three columns, five residuals
_CYCLES = 8
_CHORDS = 3  # rounds with the columns of an earlier stage
_DROP = 0.1  # of the residual that makes those credible: of too stiff a matrix steps are small, whatever is left


@ti.data_oriented
class Newton:
    """The solver for a state of `components` numbers whose unknown vector begins at component `first` (0 or 3)."""

    def __init__(self, *, first: int, components: int, heated: bool):
        self.first, self.components, self.heated = first, components, heated
        f64 = backend.current().precision == "f64"
        self.epsilon = float(np.finfo(np.float64 if f64 else np.float32).eps)
        self.tolerance = 1e-11 if f64 else 1e-5
        # A column's difference: relative to what the step does, and to the unknown's own size.
        self.nudge, self.least = (1e-6, 1e-8) if f64 else (1e-2, 3e-4)
        self.rounds = _CYCLE * _CYCLES
        self.rounds_linear = 5 if first else 4

    def vectors(self) -> dict[str, int]:
        """Return the local vectors that a block needs: name, and how many."""
        return {
            "zbar": self.components,
            "q": 3,
            "best": 3,  # the q of the smallest residual so far
            "residual": 3,
            "matrix": 9,  # I - g df by rows, then its inverse, or 0 where it has none
            "heat": 3,  # slope of T, its residual, 1 - g dq/dT
            "w": 1,  # weight of the stage
            "g": 1,
            "norm": 1,
            "damping": 1,
            "change": 1,  # of the unknown, in a column
            "moved": 1,  # by how much the last whole step with this matrix changed q, 0 for none
            "waiting": 1,  # 1 until the lane is done
            "held": 1,  # the g that the matrix belongs to, 0 for none
            "chord": 1,  # 1 where it belongs to this g
            "began": 1,  # the square of the first residual
        }

    @ti.func
    def begin(self, b: ti.template(), linear):
        """Set out from zbar = z with q = 0; return the number of the first round, below 0 where a lane has columns."""
        first = 0
        for lane in range(b.lanes):
            for d in ti.static(range(self.components)):
                b.zbar[d][lane] = b.z[d][lane]
            for d in ti.static(range(3)):
                b.q[d][lane] = 0.0
                b.best[d][lane] = 0.0
            for d in ti.static(range(2)):
                b.heat[d][lane] = 0.0
            g = b.w[lane] * b.h[lane]
            b.g[lane] = g
            b.norm[lane] = ti.math.inf
            b.began[lane] = ti.math.inf
            b.damping[lane] = 1.0
            b.moved[lane] = 0.0
            b.waiting[lane] = ti.select(b.h[lane] > 0.0, 1.0, 0.0)
            fits = (b.h[lane] > 0.0) & (linear == 0) & (ti.abs(g - b.held[lane]) <= 1e-6 * g)
            b.chord[lane] = ti.select(fits, 1.0, 0.0)
            first = ti.min(first, ti.select(fits, -_CHORDS, 0))
            self._place(b, lane, b.q, linear)
        return first

    @ti.func
    def digest(self, b: ti.template(), slot, r, linear):
        """Take in evaluation `r`, in register `slot`, and put z where the next one looks; return 1 when all lanes are done."""
        # No branch within a loop over the lanes, and no two things that can be two loops: LLVM would not vectorise them.
        turn = ti.select(r < 0, _CYCLE, r % _CYCLE)
        if (turn == 0) | ((turn > 3) & (linear == 0)):
            for lane in range(b.lanes):
                self._take_residual(b, lane, slot, r)
        elif turn <= 3:
            for lane in range(b.lanes):
                self._take_column(b, lane, slot, turn - 1)
        else:
            for lane in range(b.lanes):
                self._take_motion(b, lane, slot)
        if turn == 0:
            for lane in range(b.lanes):
                self._choose_change(b, lane)
        if turn == 3:
            for lane in range(b.lanes):
                self._invert(b, lane)
        if (turn > 3) | ((turn == 3) & (linear == 0)) | (r + 1 == self.rounds_linear) & (linear > 0):
            for lane in range(b.lanes):
                self._step(b, lane, r, linear)
        if turn < 3:
            for lane in range(b.lanes):
                self._place(b, lane, b.best, linear)
                self._nudge(b, lane, turn)
        elif (turn == 3) & (linear > 0):
            for lane in range(b.lanes):
                self._place(b, lane, b.best, linear)
                self._nudge_along(b, lane)
        else:
            for lane in range(b.lanes):
                self._place(b, lane, b.q, 0)
        waiting = 0
        for lane in range(b.lanes):
            waiting |= ti.select(b.waiting[lane] > 0.0, 1, 0)
        return 1 - waiting

    @ti.func
    def finish(self, b: ti.template(), slot):
        """Leave the solution in z and its slope in register `slot`; `waiting` stays 1 where there is none."""
        for lane in range(b.lanes):
            self._place(b, lane, b.q, 0)
            for d in ti.static(range(3)):
                if ti.static(self.first == 3):
                    b.k[d][slot + lane] = b.z[3 + d][lane]
                b.k[self.first + d][slot + lane] = b.q[d][lane]
            if ti.static(self.heated):
                b.k[self.components - 1][slot + lane] = b.heat[0][lane]

    @ti.func
    def _place(self, b: ti.template(), lane, q: ti.template(), linear):
        """z = zbar + g (v, q); a linearised stage looks at x = xbar."""
        g = b.g[lane]
        for d in ti.static(range(3)):
            moved = b.zbar[self.first + d][lane] + g * q[d][lane]
            b.z[self.first + d][lane] = moved
            if ti.static(self.first == 3):
                b.z[d][lane] = b.zbar[d][lane] + ti.select(linear > 0, 0.0, g * moved)
        if ti.static(self.heated):
            b.z[self.components - 1][lane] = b.zbar[self.components - 1][lane] + g * b.heat[0][lane]

    @ti.func
    def _nudge(self, b: ti.template(), lane, column):
        """Move the unknown's `column` by `change`, and x with it."""
        change = b.change[lane]
        for d in ti.static(range(3)):
            by = ti.select(column == d, change, 0.0)
            b.z[self.first + d][lane] += by
            if ti.static(self.first == 3):
                b.z[d][lane] += b.g[lane] * by
        if ti.static(self.heated):
            b.z[self.components - 1][lane] += ti.select(column == 0, self._warmer(b, lane), 0.0)

    @ti.func
    def _nudge_along(self, b: ti.template(), lane):
        """Move x alone along g v."""
        if ti.static(self.first == 3):
            for d in ti.static(range(3)):
                b.z[d][lane] += b.g[lane] * b.z[3 + d][lane]

    @ti.func
    def _warmer(self, b: ti.template(), lane):
        """Return by how much a column changes T [K]."""
        return ti.static(self.least) * ti.max(b.zbar[self.components - 1][lane], 1.0)

    @ti.func
    def _take_residual(self, b: ti.template(), lane, slot, r):
        """Keep q if its residual q - f is the smallest so far, else go back half of the step (line search, slide 39)."""
        found = ti.Vector([b.q[d][lane] - b.k[self.first + d][slot + lane] for d in ti.static(range(3))])
        norm = found.norm_sqr()
        takes = (r >= 0) | (b.chord[lane] > 0.0)
        better = takes & (norm < b.norm[lane])
        b.began[lane] = ti.select(better & (b.norm[lane] == ti.math.inf), norm, b.began[lane])
        b.norm[lane] = ti.select(better, norm, b.norm[lane])
        # the first new columns begin with a whole step
        whole = better | (r == 0) | ~takes
        b.damping[lane] = ti.select(whole, 1.0, 0.5 * b.damping[lane])
        for d in ti.static(range(3)):
            b.best[d][lane] = ti.select(better, b.q[d][lane], b.best[d][lane])
            b.residual[d][lane] = ti.select(better, found[d], b.residual[d][lane])
        if ti.static(self.heated):
            b.heat[1][lane] = b.heat[0][lane] - b.k[self.components - 1][slot + lane]

    @ti.func
    def _choose_change(self, b: ti.template(), lane):
        """Say how far the columns look."""
        size = ti.cast(0.0, float)
        for d in ti.static(range(3)):
            size = ti.max(size, ti.abs(b.zbar[self.first + d][lane]))
        did = b.g[lane] * ti.sqrt(b.norm[lane])
        b.change[lane] = ti.max(ti.static(self.nudge) * did, ti.static(self.least) * size) + 1e-12

    @ti.func
    def _take_column(self, b: ti.template(), lane, slot, column):
        """Fill a column of I - g df; f at the point itself is best - residual."""
        waiting = b.waiting[lane] > 0.0
        b.held[lane] = ti.select(waiting, b.g[lane], b.held[lane])
        for d in ti.static(range(3)):
            here = b.best[d][lane] - b.residual[d][lane]
            slope = (b.k[self.first + d][slot + lane] - here) / b.change[lane]
            for e in ti.static(range(3)):
                entry = ti.static(1.0 if d == e else 0.0) - b.g[lane] * slope
                b.matrix[3 * d + e][lane] = ti.select(waiting & (column == e), entry, b.matrix[3 * d + e][lane])
        if ti.static(self.heated):
            here = b.heat[0][lane] - b.heat[1][lane]
            slope = (b.k[self.components - 1][slot + lane] - here) / self._warmer(b, lane)
            b.heat[2][lane] = ti.select(waiting & (column == 0), 1.0 - b.g[lane] * slope, b.heat[2][lane])

    @ti.func
    def _take_motion(self, b: ti.template(), lane, slot):
        """Add what the motion along g v changes to a linearised stage: its f is a + g da/dx v."""
        for d in ti.static(range(3)):
            here = b.best[d][lane] - b.residual[d][lane]
            b.residual[d][lane] -= b.k[self.first + d][slot + lane] - here

    @ti.func
    def _invert(self, b: ti.template(), lane):
        """Put the inverse in the matrix's place, by Cramer's rule."""
        # Scaled to entries of at most 1, so that no product of three overflows.
        largest = ti.cast(0.0, float)
        for i in ti.static(range(9)):
            largest = ti.max(largest, ti.abs(b.matrix[i][lane]))
        scale = ti.select(largest > 0.0, 1.0 / largest, 0.0)
        columns = [
            ti.Vector([b.matrix[3 * i + j][lane] * scale for i in ti.static(range(3))]) for j in ti.static(range(3))
        ]
        rows = [columns[(i + 1) % 3].cross(columns[(i + 2) % 3]) for i in ti.static(range(3))]
        det = columns[0].dot(rows[0])
        factor = ti.select(det != 0.0, scale / det, 0.0)
        waiting = b.waiting[lane] > 0.0
        b.moved[lane] = ti.select(waiting, 0.0, b.moved[lane])
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                b.matrix[3 * i + j][lane] = ti.select(waiting, factor * rows[i][j], b.matrix[3 * i + j][lane])

    @ti.func
    def _step(self, b: ti.template(), lane, r, linear):
        """q = best - damping (I - g df)^-1 residual; done if what is left is no more than rounding and tolerance.

        Two whole steps with one matrix tell how much is left after the second: the ratio of their lengths is the rate at which
        the error shrinks (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.8, equation 8.10).
        """
        step = [
            b.matrix[3 * i][lane] * b.residual[0][lane]
            + b.matrix[3 * i + 1][lane] * b.residual[1][lane]
            + b.matrix[3 * i + 2][lane] * b.residual[2][lane]
            for i in ti.static(range(3))
        ]
        waiting = (b.waiting[lane] > 0.0) & ((r >= 0) | (b.chord[lane] > 0.0))
        full = b.damping[lane] == 1.0
        moved = size = slope = ti.cast(0.0, float)
        for d in ti.static(range(3)):
            b.q[d][lane] = ti.select(waiting, b.best[d][lane] - b.damping[lane] * step[d], b.q[d][lane])
            moved = ti.max(moved, ti.abs(step[d]))
            slope = ti.max(slope, ti.abs(b.q[d][lane]))
            size = ti.max(size, ti.abs(b.zbar[self.first + d][lane]))
        before = b.moved[lane]
        # moved rate / (1 - rate), where that is less than `moved` itself
        left = ti.select((before > 0.0) & full & (2.0 * moved < before), moved * moved / (before - moved), moved)
        b.moved[lane] = ti.select(waiting & full, moved, ti.select(waiting, 0.0, before))
        g = b.g[lane]
        # where there is no inverse nothing moves, whatever is left
        arrived = waiting & full & ((moved > 0.0) | (b.norm[lane] == 0.0))
        arrived &= (r >= 0) | (b.norm[lane] <= ti.static(_DROP**2) * b.began[lane])
        arrived &= g * left <= ti.static(self.tolerance) * g * slope + ti.static(4 * self.epsilon) * size
        if ti.static(self.heated):
            warming = b.heat[1][lane] / b.heat[2][lane]
            b.heat[0][lane] = ti.select(waiting, b.heat[0][lane] - warming, b.heat[0][lane])
            T = b.zbar[self.components - 1][lane]
            allowed = ti.static(self.tolerance) * g * ti.abs(b.heat[0][lane]) + ti.static(4 * self.epsilon) * T
            arrived &= g * ti.abs(warming) <= allowed
        b.waiting[lane] = ti.select(arrived | (linear > 0), 0.0, b.waiting[lane])
