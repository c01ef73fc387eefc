"""The pace of a block: which step each lane takes next, whether it is accepted, and what it remembers of its past.

Three cases. Counted: steps of one size, known before the first. With a past: a scheme that looks back at earlier steps, with
its starter. By choice: the particles choose, by the error of a step or by whether Newton's method found its solution.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false
# pyright: reportOptionalMemberAccess=false, reportOperatorIssue=false

from typing import Any

import taichi as ti

from .. import backend
from ..schemes import Scheme
from ..systems.attributes import Attribute, Columns
from .block import Block
from .control import CALM, CLAMPS, Tolerance, step_factor
from .table import Table

NOBODY = 0x7FFFFFFF
LONGEST = 0x7F7FFFFF  # bits of the largest f32: non-negative floats order like their bits
_NO_NUMBER = 1e12  # the error where the estimate is none
_SHORT = 1 / 16  # of a first step, where it is of order one
_NO_TIME = 1e-30  # [s]; a step that long moves neither the clock nor anybody by a bit: it only looks at the first slope
_GROWTH = 2.4  # BDF2 is zero-stable for step ratios below 1 + sqrt 2 (Hairer, Norsett, Wanner I, III.5)


def memory(scheme: Scheme, components: int, *, adaptive: bool) -> tuple[Attribute, ...]:
    """Return the attributes that particles of a state of `components` numbers carry from frame to frame for their steps.

    `history`: the carried registers, then the last dt [s], or as many as their times are apart, and how many steps it holds.
    `dt`: the next step to try.
    """
    found = []
    if scheme.steps_back:
        width = len(scheme.carried) * components + _dts(scheme) + 1
        found.append(Attribute("history", width, "real", "", f"the past that {scheme.name} looks back at"))
    if adaptive:
        found.append(Attribute("dt", 1, "real", "s", "next step, where particles choose their own"))
    return tuple(found)


def _dts(scheme: Scheme) -> int:
    """Return how many of the last dt a scheme looks at."""
    return scheme.steps_back - 1 if scheme.starts_itself else 1


@ti.data_oriented
class Pace:
    """The pace of particles whose state has `components` numbers.

    Arguments:
        table: the scheme's programs.
        components: numbers in a state.
        clamp: how steps are fitted to the frame, a key of `CLAMPS`.
        tolerance: what errors are held against, or None.
        columns: holds the attributes of `memory`.
    """

    def __init__(self, table: Table, components: int, *, clamp: str, tolerance: Tolerance | None, columns: Columns):
        scheme = table.scheme
        self.table, self.components, self.tolerance = table, components, tolerance
        self.clamp = CLAMPS[clamp]
        self.adaptive = tolerance is not None
        self.steps_back, self.starts_itself = scheme.steps_back, scheme.starts_itself
        self.chooses = self.adaptive or table.implicit
        # Equal steps of one size for each particle are counted beforehand; all else decides anew after every step.
        self.counted = clamp == "equal" and not (self.chooses or self.steps_back)
        if tolerance is not None:
            self.exponent = 1 / (min(scheme.order, scheme.error_order) + 1)
            self.tried = columns["dt"][0]
        f64 = backend.current().precision == "f64"
        self.smallest = 2.0 ** (-40 if f64 else -20)  # step, in frames
        self.unequal = 1e-9 if f64 else 1e-4  # what rounding may do to equal steps
        if self.steps_back:
            fields = iter(columns["history"])
            self.past = [(register, d, next(fields)) for register in scheme.carried for d in range(components)]
            self.last_dts = [next(fields) for _ in range(_dts(scheme))]
            self.steps_held = next(fields)

    def vectors(self) -> dict[str, int]:
        """Return the local vectors that a block needs: name, and how many."""
        names: dict[str, int] = dict.fromkeys(
            ("left", "h", "taken", "shortest", "longest", "todo" if self.counted else "ok"), 1
        )
        if self.chooses:
            names |= {"wish": 1, "calm": 1, "missed": 1, "failed": 1}
        if self.adaptive:
            names |= {"estimate": self.components, "error": 1}
        if self.steps_back:
            names |= {"last": len(self.last_dts), "filled": 1, "ratio": 1, "started": 1}
        return names

    def lasts(self, b: Block) -> list[Any]:
        """Return the vectors of a block that hold the sizes of the last steps [s], the latest first."""
        return b.last if isinstance(b.last, list) else [b.last]

    @ti.func
    def reset(self, b: ti.template()):
        """Begin to count."""
        for lane in range(b.lanes):
            b.shortest[lane] = ti.math.inf

    @ti.func
    def load(self, b: ti.template(), lane, i, newborn, dt, span):
        """Set out with particle `i` in `lane`, whose time left is known."""
        if ti.static(self.counted):
            self.count(b, lane, dt, span)
        if ti.static(self.chooses):
            b.wish[lane] = dt
            b.calm[lane] = 1.0
        if ti.static(self.adaptive):
            first = ti.static(self.tolerance.first * (_SHORT if self.starts_itself else 1.0)) * dt
            b.wish[lane] = ti.select(newborn, first, ti.min(self.tried[i], dt))
        if ti.static(self.steps_back > 0):
            for register, d, past in ti.static(self.past):
                b.k[d][register * b.lanes + lane] = ti.select(newborn, 0.0, past[i])
            for last, dts in ti.static(zip(self.lasts(b), self.last_dts, strict=True)):
                last[lane] = dts[i]
            b.filled[lane] = ti.select(newborn, 0.0, self.steps_held[i])

    @ti.func
    def store(self, b: ti.template(), lane, i):
        """Keep what particle `i` remembers until the next frame."""
        if ti.static(self.adaptive):
            self.tried[i] = b.wish[lane]
        if ti.static(self.steps_back > 0):
            for register, d, past in ti.static(self.past):
                past[i] = b.k[d][register * b.lanes + lane]
            for last, dts in ti.static(zip(self.lasts(b), self.last_dts, strict=True)):
                dts[i] = last[lane]
            self.steps_held[i] = b.filled[lane]

    @ti.func
    def count(self, b: ti.template(), lane, dt, span):
        """All steps of a lane are equal: find their size and number before the first."""
        left = b.left[lane]
        h = ti.select(left > 0.0, ti.min(left, self.clamp(left, dt, span)), 0.0)
        b.h[lane] = h
        b.todo[lane] = ti.select(left > 0.0, ti.round(left / h), 0.0)
        b.taken[lane] = b.todo[lane]
        b.shortest[lane] = ti.select(left > 0.0, h, ti.math.inf)
        b.longest[lane] = h

    @ti.func
    def choose(self, b: ti.template(), dt, span):
        """Set every lane's next step, 0 where it has arrived or has to wait; return 1 if this is a starting step.

        Lanes that need the starter and lanes that do not take turns.
        """
        for lane in range(b.lanes):
            wish = dt
            if ti.static(self.chooses):
                wish = b.wish[lane]
            left = b.left[lane]
            b.h[lane] = ti.select(left > 0.0, ti.min(left, self.clamp(left, wish, span)), 0.0)
            if ti.static(self.starts_itself):
                b.h[lane] = ti.select((left > 0.0) & (b.filled[lane] == 0.0), ti.static(_NO_TIME), b.h[lane])
        starting = 0
        if ti.static(self.steps_back > 0 and not self.starts_itself):
            for lane in range(b.lanes):
                h, last = b.h[lane], b.last[lane]
                fits = ti.abs(h - last) <= ti.static(self.unequal) * h
                if ti.static(self.table.variable):
                    fits = h <= _GROWTH * last
                b.filled[lane] = ti.select((h > 0.0) & ~fits, 0.0, b.filled[lane])
                b.ratio[lane] = ti.select(b.filled[lane] > 0.0, h / last, 1.0)
                starting = ti.max(starting, ti.select((h > 0.0) & (b.filled[lane] < self.steps_back), 1, 0))
            if starting > 0:
                for lane in range(b.lanes):
                    b.h[lane] = ti.select(b.filled[lane] < self.steps_back, b.h[lane], 0.0)
        return starting

    @ti.func
    def judge(
        self, b: ti.template(), slots: ti.template(), coefficients: ti.template(), target: ti.template(), dt, span
    ):
        """Accept or reject each lane's step and say what it tries next; return the least slot of a lane that finds no step."""
        stuck = NOBODY
        if ti.static(self.adaptive):
            self._measure(b, coefficients, target, span)
        for lane in range(b.lanes):
            h = b.h[lane]
            fine, looked = ti.select(h > 0.0, 1.0, 0.0), ti.cast(0.0, float)
            if ti.static(self.starts_itself):
                looked = ti.select(b.filled[lane] == 0.0, 1.0, 0.0)
            if ti.static(self.chooses):
                factor, lost = ti.cast(2.0, float), ti.cast(0.0, float)
                if ti.static(self.adaptive):
                    e = b.error[lane]
                    factor = step_factor(e, b.calm[lane], ti.static(self.exponent), ti.static(self.tolerance.most))
                    fine *= ti.select(e <= 1.0, 1.0, 0.0)
                    lost = ti.select(e > ti.static(_NO_NUMBER / 2), 1.0, 0.0)
                    b.calm[lane] = ti.select((fine > 0.0) & (looked == 0.0), e, b.calm[lane])
                if ti.static(self.table.implicit):
                    fine *= 1.0 - b.failed[lane]
                    factor = ti.select(b.failed[lane] > 0.0, 0.5, factor)
                    lost = ti.max(lost, ti.select(b.norm[lane] == ti.math.inf, b.failed[lane], 0.0))
                    b.failed[lane] = 0.0
                grown = factor * h
                if ti.static(not self.adaptive):
                    grown = ti.select(fine > 0.0, 2.0 * b.wish[lane], grown)
                else:
                    # A step that the frame's end cut short says little about longer ones.
                    enough = factor >= ti.static(self.tolerance.most)
                    grown = ti.select(enough, ti.max(b.wish[lane], grown), grown)
                    trusted = ti.static(self.tolerance.trusted) * dt
                    grown = ti.min(grown, ti.select(b.error[lane] <= ti.static(CALM), dt, trusted))
                # No step at all: leave the loop. What is no number is left in the state, for the guard that names it.
                hopeless = (h > 0.0) & (fine == 0.0) & (grown < ti.static(self.smallest) * span)
                b.wish[lane] = ti.select((h > 0.0) & (looked == 0.0), ti.min(grown, dt), b.wish[lane])
                if hopeless:
                    b.left[lane] = h
                    fine = 1.0
                    if lost > 0.0:
                        b.z[0][lane] = ti.math.nan
                    else:
                        stuck = ti.min(stuck, slots[lane])
                b.missed[lane] += ti.select((h > 0.0) & (fine == 0.0), 1.0, 0.0)
            b.ok[lane] = fine
            step = fine * (1.0 - looked)
            b.taken[lane] += step
            if ti.static(self.starts_itself):
                b.started[lane] += fine * looked
            elif ti.static(self.steps_back > 0):
                b.started[lane] += ti.select(b.filled[lane] < self.steps_back, fine, 0.0)
            b.shortest[lane] = ti.min(b.shortest[lane], ti.select(step > 0.0, h, ti.math.inf))
            b.longest[lane] = ti.max(b.longest[lane], fine * h)
        return stuck

    @ti.func
    def _measure(self, b: ti.template(), coefficients: ti.template(), target: ti.template(), span):
        """error = the estimate dt sum_j e_j k_j, or what a corrector has added, in units of what is allowed."""
        m, row = ti.static(self.components, len(self.table.ops))
        if ti.static(not self.starts_itself):
            for lane in range(b.lanes):
                for d in ti.static(range(m)):
                    b.estimate[d][lane] = 0.0
            for j in range(self.table.scheme.registers):
                e = coefficients[row, 1 + j]
                if e != 0.0:
                    for lane in range(b.lanes):
                        for d in ti.static(range(m)):
                            b.estimate[d][lane] += (e * b.h[lane]) * b.k[d][j * b.lanes + lane]
        for lane in range(b.lanes):
            error = self.tolerance.error(
                target,
                ti.Vector([b.estimate[d][lane] for d in ti.static(range(m))]),
                ti.Vector([b.z0[d][lane] for d in ti.static(range(m))]),
                ti.Vector([b.z[d][lane] for d in ti.static(range(m))]),
                b.h[lane],
                span,
            )
            # Looked for in the parts: a maximum drops what is no number.
            size = error
            for d in ti.static(range(m)):
                size += ti.abs(b.estimate[d][lane]) + ti.abs(b.z[d][lane])
            bad = ti.math.isnan(size) | ti.math.isinf(size)
            b.error[lane] = ti.select(bad, _NO_NUMBER, ti.math.clamp(error, 1e-12, _NO_NUMBER))

    @ti.func
    def accepted(self, b: ti.template(), lane):
        """Return whether a lane has made a step that counts."""
        accepted = b.h[lane] > 0.0
        if ti.static(not self.counted):
            accepted = b.ok[lane] > 0.0
        return accepted

    @ti.func
    def commit(self, b: ti.template()):
        """z0 = z where the step is accepted, z = z0 where not; return 1 if a lane has time left, else 0.

        A lane without a step keeps its state to the bit, even where 0 * k is NaN. Who has time left is asked with integers, as
        in `totals`: no loop that looks for the largest float is vectorised.
        """
        busy = 0
        for lane in range(b.lanes):
            accepted = self.accepted(b, lane)
            for d in ti.static(range(self.components)):
                b.z0[d][lane] = ti.select(accepted, b.z[d][lane], b.z0[d][lane])
                b.z[d][lane] = b.z0[d][lane]
            if ti.static(self.counted):
                b.todo[lane] = ti.max(b.todo[lane] - 1.0, 0.0)
                b.left[lane] = b.todo[lane] * b.h[lane]
                b.h[lane] = ti.select(b.todo[lane] > 0.0, b.h[lane], 0.0)
            else:
                b.left[lane] -= ti.select(accepted, b.h[lane], 0.0)
            if ti.static(self.steps_back > 0):
                latest = b.h[lane]
                for last in ti.static(self.lasts(b)):
                    before = last[lane]
                    last[lane] = ti.select(accepted, latest, before)
                    latest = before
                filled = ti.min(b.filled[lane] + 1.0, ti.static(float(self.steps_back)))
                b.filled[lane] = ti.select(accepted, filled, b.filled[lane])
            busy |= ti.select(b.left[lane] > 0.0, 1, 0)
        return busy

    @ti.func
    def busy(self, b: ti.template()):
        """Return 1 if a lane has time left, else 0."""
        busy = 0
        for lane in range(b.lanes):
            busy |= ti.select(b.left[lane] > 0.0, 1, 0)
        return busy

    @ti.func
    def totals(self, b: ti.template(), stuck):
        """Return steps, of them the starter's, rejected tries, the bits of the block's least and largest step as f32, `stuck`."""
        missed, started = 0, 0
        if ti.static(self.chooses):
            missed = ti.cast(b.missed.sum(), ti.i32)
        if ti.static(self.steps_back > 0):
            started = ti.cast(b.started.sum(), ti.i32)
        low, high, taken = LONGEST, 0, 0
        for lane in range(b.lanes):
            taken += ti.cast(b.taken[lane], ti.i32)
            low = ti.min(low, ti.bit_cast(ti.cast(b.shortest[lane], ti.f32), ti.i32))
            high = ti.max(high, ti.bit_cast(ti.cast(b.longest[lane], ti.f32), ti.i32))
        return taken, started, missed, low, high, stuck
