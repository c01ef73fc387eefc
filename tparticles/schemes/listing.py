"""Schemes for people: all of them in a table, or one in full with its program as formulas."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from fractions import Fraction

from tparticles.schemes.exact import rational, shown
from tparticles.schemes.program import Op, OpKind, Scheme

WIDTH = 120
FAMILIES = ("one-step, explicit", "second-order systems", "multistep", "implicit")


def family(scheme: Scheme) -> str:
    """Return under which heading `scheme` is listed, one of FAMILIES."""
    if scheme.implicit:
        return "implicit"
    if scheme.system_orders == {2}:
        return "second-order systems"
    return "one-step, explicit" if scheme.one_step else "multistep"


def table(schemes: Iterable[Scheme]) -> str:
    """Return a line for each scheme under the heading of its family, and where each comes from; WIDTH columns at most."""
    schemes = list(schemes)
    width = max([len(scheme.name) for scheme in schemes], default=0) + 2
    lines = [f"{'scheme':{width}} order stages evals     real     imag stable    SSP  needs"]
    for heading in FAMILIES:
        members = [scheme for scheme in schemes if family(scheme) == heading]
        lines += [heading, *(_row(scheme, width) for scheme in members)] if members else []
    sources: dict[str, list[str]] = {}
    for scheme in schemes:
        if scheme.reference:
            sources.setdefault(scheme.reference, []).append(scheme.name)
    lines += ["", "sources"] if sources else []
    lines += [_wrapped(f"{'  ' + ', '.join(names):{width}} ", reference) for reference, names in sources.items()]
    return "\n".join(lines)


def _row(scheme: Scheme, width: int) -> str:
    stable = "L" if scheme.l_stable else "A" if scheme.a_stable else "-"
    ssp = "-" if scheme.ssp is None else f"{scheme.ssp:.4f}"
    cost = f"{scheme.order:5} {scheme.stages:6} {scheme.evaluations:5}"
    limits = f"{scheme.real_limit:8.4f} {scheme.imaginary_limit:8.4f} {stable:>6} {ssp:>6}"
    return f"{'  ' + scheme.name:{width}} {cost} {limits}  {', '.join(scheme.needs) or '-'}"


def _wrapped(start: str, text: str) -> str:
    return textwrap.fill(start + text, WIDTH, subsequent_indent=" " * len(start), break_on_hyphens=False)


def sheet(scheme: Scheme) -> str:
    """Return everything that is known about one scheme, with its program, its history and its starter as formulas."""
    estimate = f"dt ({_sum(scheme.error_weights, (), 'k')}), of order {scheme.error_order}"
    stable = "A- and L-stable" if scheme.l_stable else "A-stable" if scheme.a_stable else "not A-stable"
    systems = {1: "x' = f(t, x)", 2: "x'' = a(t, x, v)"}
    facts = {
        "order": str(scheme.order),
        "stages": str(scheme.stages),
        "evaluations": f"{scheme.evaluations} a step",
        "real limit": f"{scheme.real_limit:.10g} (step times rate)",
        "imaginary limit": f"{scheme.imaginary_limit:.10g}",
        "stability": stable,
        "SSP coefficient": "none" if scheme.ssp is None else f"{scheme.ssp:.10g}",
        "error estimate": estimate if scheme.error_weights else "none",
        "systems": " and ".join(systems[order] for order in sorted(scheme.system_orders)),
        "needs": ", ".join(scheme.needs) or "nothing more",
        "source": scheme.reference or "none",
    }
    lines = [f"{scheme.name}: {family(scheme)}", *(_wrapped(f"  {what:15}  ", fact) for what, fact in facts.items())]
    lines += ["  program, from z = z0 at t", *_program(scheme.ops)]
    if scheme.reuses:
        lines.append("    k0 is kept: where it is still f(t, z), the next step begins without evaluating it")
    if scheme.history:
        lines += ["  history, after every step", *_program(scheme.history)]
    if scheme.starter:
        steps = "step" if scheme.steps_back == 1 else f"{scheme.steps_back} steps"
        lines += [f"  starter for the first {steps}: {scheme.starter.name}", *_program(scheme.starting_ops)]
    return "\n".join(lines)


def _program(ops: Sequence[Op]) -> list[str]:
    lines = [_wrapped("    ", formula(op)) for op in ops]
    return [*lines, "    with r = dt / (the previous dt)"] if any(op.variable for op in ops) else lines


def formula(op: Op) -> str:
    """Return what `op` does as an assignment, in the letters of `OpKind`."""
    k, at = f"k{op.slope}", _time(op.time)
    if op.kind is OpKind.COMBINE:
        total = _sum(op.weights, op.variable, "k")
        return f"z = z0 + dt ({total})" if total else "z = z0"
    if op.kind is OpKind.EVALUATE:
        return f"{k} = f({at}, z)"
    if op.kind is OpKind.KICK:
        return f"v = v + dt ({_sum(op.weights, op.variable, 'a')})"
    if op.kind is OpKind.ROTATE:
        return f"{k} = k{op.source}"
    if op.kind is OpKind.DIFFERENCE:
        return f"{k} = (z - z0) / dt"
    # DRIFT and SOLVE: one weight, of dt
    step = _sum(op.weights, op.variable, "dt", numbered=False)
    sign, opposite, step = ("-", "+", step[1:]) if step.startswith("-") else ("+", "-", step)
    if op.kind is OpKind.DRIFT:
        return f"x = x {sign} {step} v"
    if op.linear:
        return f"{k} = (I {opposite} {step} df/dz)^-1 f({at}, z); z = z {sign} {step} {k}"
    return f"solve z = zbar {sign} {step} {k} with {k} = f({at}, z), where zbar is z so far"


def _time(time: float) -> str:
    if time == 0:
        return "t"
    return f"t {'-' if time < 0 else '+'} {_product(abs(time), 'dt')}"


def _sum(
    weights: Sequence[float], variable: Sequence[tuple[float, float, float]], letter: str, *, numbered: bool = True
) -> str:
    """Return the sum of the terms that are not 0, such as `1/6 k0 + 2/3 k1 - k2`."""
    text = ""
    for j, weight in enumerate(weights):
        symbol = f"{letter}{j}" if numbered else letter
        if variable:
            term, negative = f"{_ratio(*variable[j])} {symbol}", False
        else:
            term, negative = _product(abs(weight), symbol), weight < 0
        if weight:
            sign = " - " if negative else " + "
            text += (sign if text else "-" * negative) + term
    return text


def _product(factor: float, symbol: str) -> str:
    text = _number(factor)
    return symbol if text == "1" else f"{text} {symbol}"


def _number(value: float) -> str:
    exact = rational(value)
    return shown(exact) if isinstance(exact, Fraction) else f"{value:.10g}"


def _ratio(n0: float, n1: float, d: float) -> str:
    """Return (n0 + n1 r) / (1 + d r)."""
    rate = f"{'-' * (n1 < 0)}{_product(abs(n1), 'r')}"
    terms = [_number(n0)] * (n0 != 0) + [rate] * (n1 != 0)
    above = " + ".join(terms)
    above = f"({above})" if len(terms) != 1 or above.startswith("-") else above
    return f"{above} / (1 + {_product(d, 'r')})" if d else above
