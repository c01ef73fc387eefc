"""What each study found, in a few lines of text."""

from __future__ import annotations

import math

from .energy import Energy
from .order import PROBLEMS, Order
from .report import table
from .stability import StabilityStudy
from .variable_steps import VariableSteps


def order(result: Order) -> str:
    """Return the slopes by scheme and problem."""
    slopes = {(c.scheme, c.problem): c.slope for c in result.curves}
    declared = {c.scheme: c.declared for c in result.curves}
    rows: list[list[object]] = [["scheme", "order", *(p.name for p in PROBLEMS)]]
    for name, order in declared.items():
        rows.append([name, order, *(_number(slopes.get((name, p.name), math.nan), ".3f") for p in PROBLEMS)])
    return table(rows)


def stability(result: StabilityStudy) -> str:
    """Return the limits by scheme; of oscillators at some damping ratios."""
    zetas = [zeta for zeta in (0.1, 0.5, 1.0) if zeta in result.zetas]
    rows: list[list[object]] = [["scheme", "real", "imaginary", *(f"zeta {zeta}" for zeta in zetas), "stable"]]
    for r in result.regions:
        limits = [r.oscillator[result.zetas.index(zeta)] for zeta in zetas]
        kind = "L" if r.l_stable else "A" if r.a_stable else "-"
        rows.append([r.scheme, *(f"{limit:.4f}" for limit in (r.real_limit, r.imaginary_limit, *limits)), kind])
    return table(rows)


def energy(result: Energy) -> str:
    """Return what became of energy and phase by scheme and problem."""
    rows: list[list[object]] = [
        ["scheme", "problem", "energy", "largest error", "at the end", "per step", "lead [turns]"]
    ]
    for d in result.drifts:
        end = f"{d.energy[-1]:.3g} after {d.periods[-1]:.0f}"
        rows.append(
            [
                d.scheme,
                d.problem,
                d.verdict,
                f"{d.largest:.2g}",
                end,
                _number(d.factor - 1, "+.2e"),
                _number(d.phase[-1], ".4g"),
            ]
        )
    return table(rows)


def variable_steps(result: VariableSteps) -> str:
    """Return the largest growth of pairs of stable steps by scheme, and the engine's checks."""
    rows: list[list[object]] = [["scheme", "limit", "growth per pair", "at omega dt", "note"]]
    for m in result.maps:
        note = f"each change restarts with {m.starter}" if m.restarts else ""
        at = f"{m.at[0]:.3f} / {m.at[1]:.3f}" if m.affected else "-"
        rows.append([m.scheme, f"{m.limit:.4f}", f"{m.worst:.4f}" if m.affected else "none", at, note])
    lines = [table(rows)]
    if result.without:
        lines.append(f"no stable step on this oscillator: {', '.join(result.without)}")
    lines += [
        f"engine: {c.scheme}, {c.first:.3g} / {c.second:.3g} ({c.how}): {c.measured:.5f} per pair, computed {c.computed:.5f}"
        for c in result.checks
    ]
    return "\n".join(lines)


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
