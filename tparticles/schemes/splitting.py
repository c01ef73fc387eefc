"""Methods for x'' = a(t, x, v) that move velocity and position by turns: Verlet and its relatives."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from tparticles.errors import InputError
from tparticles.schemes.construct import Draft, scheme
from tparticles.schemes.exact import Number, shown
from tparticles.schemes.lazy import Lazy, named
from tparticles.schemes.multistep import ADAMS_BASHFORTH_2
from tparticles.schemes.one_step import EXPLICIT
from tparticles.schemes.program import Op, OpKind, Scheme
from tparticles.schemes.tables import as_float, check_sum_is_one, checked_name, numbers


def splitting(
    kicks: Sequence[Number],
    drifts: Sequence[Number],
    *,
    name: str,
    order: int | None = None,
    first: str = "",
    reference: str = "",
) -> Scheme:
    """Return the method that takes turns with v += kick dt a(t, x, v) and x += drift dt v.

    `kicks`, `drifts`: weights in the order of their use, each sum is 1; int, float or Fraction. `first`: "kick" or "drift", what it
    begins with; needed where there are as many kicks as drifts, otherwise the one of which there is one more.
    `order`: what the caller believes; the order is worked out from the order conditions of Nystrom trees, and a wrong claim is
    refused. Where it holds only for accelerations without v the scheme needs "velocity-free forces".
    Raises InputError, naming the scheme and the value: entries that are not finite numbers, sums that are not 1, numbers of
    kicks and drifts that cannot take turns, a wrong claim.
    Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, sections II.5 and III.3.
    """
    where = checked_name(name)
    turns = {"kick": numbers(kicks, "kicks", where), "drift": numbers(drifts, "drifts", where)}
    for what, weights in turns.items():
        check_sum_is_one(weights, f"{what}s", where)
    begins = _first(turns, first, where)
    queues = {what: iter(weights) for what, weights in turns.items()}
    ops: list[Op] = []
    time, now = Fraction(0), begins
    for _ in range(sum(map(len, turns.values()))):
        weight = next(queues[now])
        if now == "kick":
            ops.append(Op(OpKind.EVALUATE, time=as_float(time, "the time of a kick", where)))
            ops.append(Op(OpKind.KICK, weights=(as_float(weight, "kicks", where),)))
        else:
            ops.append(Op(OpKind.DRIFT, weights=(as_float(weight, "drifts", where),)))
            time += Fraction(weight)
        now = "kick" if now == "drift" else "drift"
    # Kicks at both ends are at the same positions, of this step and the next.
    ends = begins == "kick" and len(turns["kick"]) > len(turns["drift"]) > 0
    if ends:
        ops[-2] = Op(OpKind.EVALUATE, time=1.0)
    return scheme(Draft(ops=tuple(ops), slopes=1), name=name, order=order, reference=reference, reuses=ends)


def _first(turns: dict[str, list[Number]], first: object, where: str) -> str:
    kicks, drifts = len(turns["kick"]), len(turns["drift"])
    if abs(kicks - drifts) > 1:
        raise InputError(
            f"{where}: {kicks} kicks and {drifts} drifts cannot take turns, their numbers differ by 1 at most"
        )
    needed = "kick" if kicks > drifts else "drift" if drifts > kicks else first
    if first not in ("", needed) or needed not in ("kick", "drift"):
        allowed = f"'{needed}'" if kicks != drifts else "'kick' or 'drift'"
        raise InputError(f"{where}: first must be {allowed} with {kicks} kicks and {drifts} drifts, not {shown(first)}")
    return str(needed)


def _velocity_verlet(*, name: str) -> Scheme:
    """x' = x + dt v + dt^2/2 a_n; v' = v + dt/2 (a_n + a_(n+1)), with a_(n+1) = a(x', v + dt a_n).

    The velocity that a_(n+1) sees is predicted: with forces that depend on v it stays of order 2, where the half-kicked
    velocity gives order 1. Without such forces it is the kick, drift, kick of the literature.
    """
    ops = (
        Op(OpKind.EVALUATE),
        Op(OpKind.KICK, weights=(0.5,)),
        Op(OpKind.DRIFT, weights=(1.0,)),
        Op(OpKind.KICK, weights=(0.5,)),
        Op(OpKind.EVALUATE, slope=1, time=1.0),
        Op(OpKind.KICK, weights=(-0.5, 0.5)),
        Op(OpKind.ROTATE, slope=0, source=1),
    )
    return scheme(
        Draft(ops=ops, slopes=2),
        name=name,
        order=2,
        reuses=True,
        reference="W. C. Swope, H. C. Andersen, P. H. Berens, K. R. Wilson, J. Chem. Phys. 76 (1982)",
    )


def _beeman(*, name: str) -> Scheme:
    """x' = x + dt v + dt^2/6 (4 a_n - a_(n-1)); v' = v + dt/6 (2 a_(n+1) + 5 a_n - a_(n-1)).

    a_(n+1) sees the predicted velocity v + dt/2 (3 a_n - a_(n-1)), as in velocity-verlet. Registers: 0 a_n, 1 a_(n-1), 2 a_n
    kept for the history (it may be evaluated again), 3 a_(n+1).
    """
    ops = (
        Op(OpKind.EVALUATE),
        Op(OpKind.ROTATE, slope=2, source=0),
        Op(OpKind.KICK, weights=(2 / 3, -1 / 6)),
        Op(OpKind.DRIFT, weights=(1.0,)),
        Op(OpKind.KICK, weights=(5 / 6, -1 / 3)),
        Op(OpKind.EVALUATE, slope=3, time=1.0),
        Op(OpKind.KICK, weights=(-2 / 3, 1 / 3, 0.0, 1 / 3)),
        Op(OpKind.ROTATE, slope=0, source=3),
    )
    history = (Op(OpKind.ROTATE, slope=1, source=2), Op(OpKind.ROTATE, slope=2, source=0))
    return scheme(
        # Two steps back: after one step of the starter k_0 is the second acceleration, and the first is gone.
        Draft(ops=ops, slopes=4, history=history, carried=(1, 2), steps_back=2),
        name=name,
        order=2,
        reuses=True,
        starter=SPLITTINGS["velocity-verlet"],
        reference="D. Beeman, Some multistep methods for use in molecular dynamics calculations, J. Comput. Phys. 20 (1976)",
    )


def _crenshaw(*, name: str) -> Scheme:
    """v' = v + dt/2 (3 a_n - a_(n-1)); x' = x + dt/2 (v + v').

    The form that Lander's code of 1999 means. (The code itself moves by dt/4 (v + v') and, by its buffering, uses a force two
    steps old.) The velocity is Adams-Bashforth's of order 2, with its weights for unequal steps.
    """
    ops = (
        Op(OpKind.EVALUATE),
        Op(OpKind.DRIFT, weights=(0.5,)),
        Op(OpKind.KICK, weights=(1.5, -0.5), variable=ADAMS_BASHFORTH_2),
        Op(OpKind.DRIFT, weights=(0.5,)),
    )
    return scheme(
        Draft(ops=ops, slopes=2, history=(Op(OpKind.ROTATE, slope=1, source=0),), carried=(1,), steps_back=1),
        name=name,
        order=2,
        starter=EXPLICIT["midpoint"],
        reference="J. Crenshaw, by way of J. Lander, Lone Game Developer Battles Physics Simulator, Game Developer (April 1999)",
    )


_w1 = 1 / (2 - 2 ** (1 / 3))
_w0 = 1 - 2 * _w1

SPLITTINGS = Lazy(
    named(
        "symplectic-euler",
        splitting,
        [1],
        [1],
        first="kick",
        order=1,
        reference="R. de Vogelaere, Methods of integration which preserve the contact transformation property (1956); "
        "A. Cromer, Am. J. Phys. 49 (1981)",
    ),
    named("velocity-verlet", _velocity_verlet),
    named(
        "position-verlet",
        splitting,
        [1],
        [Fraction(1, 2), Fraction(1, 2)],
        order=2,
        reference="M. Tuckerman, B. J. Berne, G. J. Martyna, Reversible multiple time scale molecular dynamics, "
        "J. Chem. Phys. 97 (1992)",
    ),
    named("beeman", _beeman),
    named(
        "yoshida4",
        splitting,
        [_w1, _w0, _w1],
        [_w1 / 2, (_w0 + _w1) / 2, (_w0 + _w1) / 2, _w1 / 2],
        order=4,
        reference="H. Yoshida, Construction of higher order symplectic integrators, Phys. Lett. A 150 (1990); "
        "E. Forest, R. D. Ruth, Physica D 43 (1990)",
    ),
)

# A multistep method that moves v and x by turns.
CRENSHAW = named("crenshaw", _crenshaw)
