"""A program at work on one block of lanes: the ops of a scheme, one after another, each a loop over the lanes."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportOptionalSubscript=false

from collections.abc import Sequence

import taichi as ti

from ..systems.terms import FLOW_REGISTER, Term, first_writers
from .adams import correct, predict
from .newton import Newton
from .pace import Pace
from .table import Table

_COMBINE, _EVALUATE, _KICK, _DRIFT, _SOLVE, _ROTATE, _DIFFERENCE = range(7)


@ti.data_oriented
class Walk:
    """Walks the programs of a scheme.

    Arguments:
        table: the programs.
        terms: the law, as terms of the right-hand side.
        pace: how the steps are chosen.
        newton: solves the implicit stages.
        components: numbers in a state.
    """

    def __init__(self, table: Table, terms: Sequence[Term], *, pace: Pace, newton: Newton, components: int):
        self.table, self.pace, self.newton, self.components = table, pace, newton, components
        self.firsts = first_writers(terms)

    @ti.func
    def _rate(self, term: ti.template(), p, t, z, u, q):
        return term.evaluate(term.law, p, t, z, u, q)

    @ti.func
    def walk(self, b: ti.template(), first, last, ops: ti.template(), coefficients: ti.template(), span, start):
        """Run ops first..last-1 of the program."""
        for op in range(first, last):
            kind = ops[op, 0]
            if kind == _COMBINE:
                if ti.static(self.pace.starts_itself):
                    # the first slope of a predictor is k_1, that of a corrector k_0
                    if ops[op, 4] > 0:
                        predict(b, ti.static(self.pace.lasts(b)))
                    else:
                        correct(b, ti.static(self.pace.lasts(b)))
                else:
                    self._combine(b, op, ops, coefficients)
            if ti.static(_KICK in self.table.kinds):
                if kind == _KICK:
                    self._kick(b, op, ops, coefficients)
            if ti.static(_DRIFT in self.table.kinds):
                if kind == _DRIFT:
                    for lane in range(b.lanes):
                        for d in ti.static(range(3)):
                            b.z[d][lane] += coefficients[op, 1] * b.h[lane] * b.z[3 + d][lane]
            if ti.static(self.table.rotates or self.table.differs):
                if (kind == _ROTATE) | (kind == _DIFFERENCE):
                    going = ti.Vector([0] * ti.static(b.lanes))
                    for lane in range(b.lanes):
                        going[lane] = ti.select(b.h[lane] > 0.0, 1, 0)
                    if ti.static(self.table.rotates):
                        if kind == _ROTATE:
                            b.rotate(ops[op, 1], ops[op, 2], going)
                    if ti.static(self.table.differs):
                        if kind == _DIFFERENCE:
                            b.difference(ops[op, 1], going)
            if ti.static(not self.table.implicit):
                if kind == _EVALUATE:
                    self._evaluate(b, ops[op, 1] * b.lanes, coefficients[op, 0], span, start)
            else:
                if (kind == _EVALUATE) | (kind == _SOLVE):
                    self._evaluate_or_solve(b, op, ops, coefficients, span, start)

    @ti.func
    def _evaluate_or_solve(self, b: ti.template(), op, ops: ti.template(), coefficients: ti.template(), span, start):
        """An implicit stage is a number of evaluations: one copy of the law serves both kinds of op."""
        solving, linear, slot = ops[op, 0] == _SOLVE, ops[op, 3], ops[op, 1] * b.lanes
        rounds, r = 1, 0
        if solving:
            rounds = ti.select(linear > 0, self.newton.rounds_linear, self.newton.rounds)
            for lane in range(b.lanes):
                b.w[lane] = self._weight(b, op, 0, lane, coefficients)
            r = self.newton.begin(b, linear)
        while r < rounds:
            self._evaluate(b, slot, coefficients[op, 0], span, start)
            if solving:
                if self.newton.digest(b, slot, r, linear) > 0:
                    r = rounds
            r += 1
        if solving:
            self.newton.finish(b, slot)
            for lane in range(b.lanes):
                b.failed[lane] = ti.max(b.failed[lane], b.waiting[lane])

    @ti.func
    def _weight(self, b: ti.template(), op, j, lane, coefficients: ti.template()):
        """Return weight `j` of an op; with steps of varying size (n0 + n1 r) / (1 + d r), r the ratio to the last one."""
        w = coefficients[op, 1 + j]
        if ti.static(self.table.variable):
            at, r = ti.static(1 + self.table.scheme.registers) + 3 * j, b.ratio[lane]
            w = (coefficients[op, at] + coefficients[op, at + 1] * r) / (1.0 + coefficients[op, at + 2] * r)
        return w

    @ti.func
    def _combine(self, b: ti.template(), op, ops: ti.template(), coefficients: ti.template()):
        """z = z0 + dt sum_j w_j k_j; the first j comes last but z0, the largest of all: one rounding counts."""
        m = ti.static(self.components)
        first, begun = ops[op, 4], 0
        while ops[op, 5 + begun] >= 0:
            j = ops[op, 5 + begun]
            for lane in range(b.lanes):
                w = self._weight(b, op, j, lane, coefficients) * b.h[lane]
                for d in ti.static(range(m)):
                    b.z[d][lane] = ti.select(begun > 0, b.z[d][lane], 0.0) + w * b.k[d][j * b.lanes + lane]
            begun += 1
        for lane in range(b.lanes):
            w = self._weight(b, op, first, lane, coefficients) * b.h[lane]
            for d in ti.static(range(m)):
                others = ti.select(begun > 0, b.z[d][lane], 0.0)
                b.z[d][lane] = b.z0[d][lane] + (others + w * b.k[d][first * b.lanes + lane])

    @ti.func
    def _kick(self, b: ti.template(), op, ops: ti.template(), coefficients: ti.template()):
        """v += dt sum_j w_j a_j."""
        i = 4
        while ops[op, i] >= 0:
            j = ops[op, i]
            for lane in range(b.lanes):
                w = self._weight(b, op, j, lane, coefficients) * b.h[lane]
                for d in ti.static(range(3)):
                    b.z[3 + d][lane] += w * b.k[3 + d][j * b.lanes + lane]
            i += 1

    @ti.func
    def _evaluate(self, b: ti.template(), slot, c, span, start):
        """k_s = f(t + c dt, z), one loop over the lanes for each pass of each term; the first to write a component sets it."""
        m = ti.static(self.components)
        for term, sets in ti.static(self.firsts):
            for p in range(term.passes()):
                for lane in range(b.lanes):
                    # time since the frame began: what is done, plus the stage
                    tau = span - b.left[lane] + c * b.h[lane]
                    value = self._rate(
                        term,
                        p,
                        start + tau,
                        ti.Vector([b.z[d][lane] for d in ti.static(range(m))]),
                        ti.Vector([b.u[d][lane] for d in ti.static(range(3))]),
                        ti.Vector([b.age[lane] + tau, b.size[lane]]),
                    )
                    for d in ti.static(range(term.width)):
                        if ti.static(term.first == FLOW_REGISTER):
                            b.u[d][lane] = self._sum(term, sets, p, b.u[d][lane], value[d])
                        else:
                            i = slot + lane
                            b.k[term.first + d][i] = self._sum(term, sets, p, b.k[term.first + d][i], value[d])

    @ti.func
    def _sum(self, term: ti.template(), sets: ti.template(), p, before, value):
        total = before + value
        if ti.static(sets and term.in_passes):
            total = ti.select(p > 0, before, 0.0) + value
        elif ti.static(sets):
            total = value
        return total

    @ti.func
    def shift(self, b: ti.template(), first, last, ops: ti.template()):
        """Run ops first..last-1, ROTATE and DIFFERENCE, for the lanes whose step is accepted."""
        accepted = ti.Vector([0] * ti.static(b.lanes))
        for lane in range(b.lanes):
            accepted[lane] = ti.select(self.pace.accepted(b, lane), 1, 0)
        for op in range(first, last):
            if ops[op, 0] == _ROTATE:
                b.rotate(ops[op, 1], ops[op, 2], accepted)
            if ti.static(_DIFFERENCE in self.table.kinds):
                if ops[op, 0] == _DIFFERENCE:
                    b.difference(ops[op, 1], accepted)
