"""How steps are cut into passes: what runs, in which order, and how many passes a step takes."""

import pytest

from tparticles import schemes
from tparticles.schemes import OpKind
from tparticles.stepping.passes import PARTS, Passes
from tparticles.stepping.table import Table

SCHEMES = [s for s in schemes.CATALOGUE.values() if 2 in s.system_orders and not s.implicit]
STEPS = 7


def passes_of(scheme):
    table = Table.of(scheme)
    return table, Passes(table, reuses=int(table.reuses(velocity_free=True)))


def written_out(passes):
    """Return the ops of some passes in order; "begin" where a step begins."""
    found = []
    for row in passes.tolist():
        found += [row[0]] * (row[0] >= 0)
        for n in range(PARTS):
            found += ["begin"] * (row[8] >> n & 1) + list(range(row[2 + 2 * n], row[3 + 2 * n]))
    return found


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_steps_on_end_run_the_ops_of_the_single_steps(scheme):
    table, passes = passes_of(scheme)
    together = [op for times, rows in passes.run(STEPS, 0, 0) for _ in range(times) for op in written_out(rows)]
    alone, held, fresh = [], 0, 0
    for _ in range(STEPS):
        alone += written_out(passes.step(int(held < scheme.steps_back), fresh, ends=True))
        held, fresh = min(held + 1, scheme.steps_back), passes.reuses
    # an evaluation leaves the state alone: a step that begins with one may begin before or behind it
    assert ordered(together, table) == ordered(alone, table)
    assert sum(times for times, _ in passes.run(STEPS, 0, 0)) == STEPS


def ordered(ops, table):
    """Return `ops` with a "begin" behind an evaluation before it."""
    ops = list(ops)
    for n in range(len(ops) - 1):
        if ops[n + 1] == "begin" and ops[n] != "begin" and table.ops[ops[n], 0] == OpKind.EVALUATE:
            ops[n], ops[n + 1] = ops[n + 1], ops[n]
    return ops


@pytest.mark.parametrize(("name", "count"), [("symplectic-euler", 1), ("velocity-verlet", 1), ("rk4", 4), ("abm4", 2)])
def test_a_step_takes_a_pass_for_each_evaluation(name, count):
    _, passes = passes_of(schemes.get(name))
    groups = list(passes.run(100, 0, 0))
    times, rows = max(groups, key=lambda group: group[0])
    assert times > 90
    assert len(rows) == count
