"""A program on a linear problem: the amplification matrix of one step, as an exact characteristic polynomial.

On x' = lambda x, and on x'' = -omega^2 x - 2 zeta omega x', a step multiplies the state and the carried registers by a matrix
M = N / D whose entries are polynomials in dt lambda, or in p = (omega dt)^2 and q = 2 zeta omega dt. D collects the
determinants of implicit stages. Everything that stability asks for is in det(zeta D I - N).
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TypeAlias

from tparticles.schemes.exact import Number, rational
from tparticles.schemes.polynomial import greatest_common_divisor, quotient, trimmed
from tparticles.schemes.program import Op, OpKind
from tparticles.schemes.series import Program

# A polynomial in one or two variables: exponents -> coefficient, without zeros.
Poly: TypeAlias = "dict[tuple[int, ...], Fraction]"
# The components of a register (one or two), each a row of polynomials over the state at the start of the step.
Register: TypeAlias = "list[list[Poly]]"

_ONE = Fraction(1)


def _plus(left: Poly, right: Poly, scale: Fraction = _ONE) -> Poly:
    total = dict(left)
    for powers, coefficient in right.items():
        total[powers] = total.get(powers, Fraction(0)) + scale * coefficient
    return {powers: coefficient for powers, coefficient in total.items() if coefficient}


def _times(left: Poly, right: Poly) -> Poly:
    product: Poly = {}
    for i, a in left.items():
        for j, b in right.items():
            powers = tuple(m + n for m, n in zip(i, j, strict=True))
            product[powers] = product.get(powers, Fraction(0)) + a * b
    return {powers: coefficient for powers, coefficient in product.items() if coefficient}


def first_order_characteristic(program: Program) -> tuple[tuple[Number, ...], ...]:
    """Return P of x' = lambda x: P[j][i] is the coefficient of zeta^j z^i, z = dt lambda; highest and lowest j not zero."""
    z: Poly = {(1,): _ONE}
    P = _characteristic(program, [[z]])
    rows = [[coefficient.get((i,), Fraction(0)) for i in range(_degree(P, 0) + 1)] for coefficient in P]
    return _without_common_factor(rows, exact=_is_exact(program))


def oscillator_characteristic(program: Program) -> tuple[tuple[tuple[Number, ...], ...], ...]:
    """Return P of x'' = -omega^2 x - 2 zeta omega x': P[j][i][l] is the coefficient of zeta^j p^i q^l."""
    # In the variables (x, dt v): A = ((0, 1), (-p, -q)).
    A: list[list[Poly]] = [[{}, {(0, 0): _ONE}], [{(1, 0): -_ONE}, {(0, 1): -_ONE}]]
    P = _characteristic(program, A)
    size, width = _degree(P, 0) + 1, _degree(P, 1) + 1
    return tuple(
        tuple(tuple(_short(poly.get((i, k), Fraction(0))) for k in range(width)) for i in range(size)) for poly in P
    )


def _characteristic(program: Program, A: list[list[Poly]]) -> list[Poly]:
    """Return the coefficients of det(zeta D I - N) by powers of zeta, without the roots at 0."""
    N, D = _matrix(program, A)
    n = len(N)
    # Faddeev-LeVerrier: c_n = 1; M_k = N M_(k-1) + c_(n-k+1) I; c_(n-k) = -tr(N M_k) / k
    one: Poly = {(0,) * len(next(iter(D))): _ONE}
    coefficients: list[Poly] = [one]
    M = [[one if i == j else {} for j in range(n)] for i in range(n)]
    for k in range(1, n + 1):
        NM = _product(N, M)
        trace: Poly = {}
        for i in range(n):
            trace = _plus(trace, NM[i][i])
        c = {powers: coefficient / -k for powers, coefficient in trace.items()}
        coefficients.append(c)
        M = [[_plus(NM[i][j], c) if i == j else NM[i][j] for j in range(n)] for i in range(n)]
    # det(mu I - N) at mu = zeta D
    scaled, power = [], one
    for c in reversed(coefficients):
        scaled.append(_times(c, power))
        power = _times(power, D)
    if not _is_exact(program):
        scaled = [_without_rounding(c) for c in scaled]
    while not scaled[0]:
        scaled.pop(0)
    return scaled


def _product(left: list[list[Poly]], right: list[list[Poly]]) -> list[list[Poly]]:
    out: list[list[Poly]] = []
    for row in left:
        out.append([])
        for j in range(len(right[0])):
            total: Poly = {}
            for entry, column in zip(row, right, strict=True):
                if entry and column[j]:
                    total = _plus(total, _times(entry, column[j]))
            out[-1].append(total)
    return out


def _matrix(program: Program, A: list[list[Poly]]) -> tuple[list[list[Poly]], Poly]:
    """Return N and D. Where k_0 is reused it is f(t, z) all the same, and no part of the state."""
    parts = len(A)
    kept = program.carried
    size = parts * (1 + len(kept))
    variables = max(len(powers) for row in A for entry in row for powers in entry)
    constant: Poly = {(0,) * variables: _ONE}

    def unit(position: int) -> Register:
        return [[constant if j == parts * position + i else {} for j in range(size)] for i in range(parts)]

    empty: Register = [[{} for _ in range(size)] for _ in range(parts)]
    run = _Run(A, unit(0), [empty] * program.slopes, constant)
    for position, register in enumerate(kept, start=1):
        run.k[register] = unit(position)
    for op in (*program.ops, *program.history):
        run.do(op)
    rows = [row for register in [run.z, *(run.k[j] for j in kept)] for row in register]
    return rows, run.D


class _Run:
    """Registers over polynomials, all of them times the common denominator D; slopes are times dt."""

    def __init__(self, A: list[list[Poly]], z: Register, k: list[Register], D: Poly):
        self.A, self.z, self.z0, self.k, self.D = A, z, z, k, D
        self.one = D

    def do(self, op: Op) -> None:
        weights = [Fraction(rational(weight)) for weight in op.weights]
        if op.kind is OpKind.COMBINE:
            self.z = self._sum(self.z0, weights)
        elif op.kind is OpKind.KICK:
            # The last part is the velocity; where it is alone, the problem is v' = -q v.
            self.z = [*self.z[:-1], self._sum(self.z, weights)[-1]]
        elif op.kind is OpKind.DRIFT and len(self.A) > 1:
            self.z = [_row_plus(self.z[0], self.z[1], weights[0]), self.z[1]]
        elif op.kind is OpKind.EVALUATE:
            self.k[op.slope] = self._slope(self.z)
        elif op.kind is OpKind.SOLVE:
            self._solve(op.slope, weights[0])
        elif op.kind is OpKind.ROTATE:
            self.k[op.slope] = self.k[op.source]
        elif op.kind is OpKind.DIFFERENCE:
            self.k[op.slope] = [_row_plus(end, start, -_ONE) for end, start in zip(self.z, self.z0, strict=True)]

    def _sum(self, z: Register, weights: Sequence[Fraction]) -> Register:
        for weight, slope in zip(weights, self.k, strict=False):
            if weight:
                z = [_row_plus(row, change, weight) for row, change in zip(z, slope, strict=True)]
        return z

    def _slope(self, z: Register) -> Register:
        return _product(self.A, z)

    def _solve(self, slope: int, w: Fraction) -> None:
        """z = (I - w A)^-1 zbar: the adjoint enters z, the determinant every other register."""
        I_wA = [
            [_plus(self.one if i == j else {}, entry, -w) for j, entry in enumerate(row)]
            for i, row in enumerate(self.A)
        ]
        if len(I_wA) == 1:
            adjoint, determinant = [[self.one]], I_wA[0][0]
        else:
            (a, b), (c, d) = I_wA
            adjoint = [[d, _plus({}, b, -_ONE)], [_plus({}, c, -_ONE), a]]
            determinant = _plus(_times(a, d), _times(b, c), -_ONE)
        self.z = _product(adjoint, self.z)
        self.z0 = _register_times(self.z0, determinant)
        self.k = [_register_times(register, determinant) for register in self.k]
        self.D = _times(self.D, determinant)
        # The slope of the solution: on a linear problem that of the linearised solve as well.
        self.k[slope] = self._slope(self.z)


def _row_plus(row: list[Poly], change: list[Poly], weight: Fraction) -> list[Poly]:
    return [_plus(entry, other, weight) if other else entry for entry, other in zip(row, change, strict=True)]


def _register_times(register: Register, factor: Poly) -> Register:
    return [[_times(entry, factor) for entry in row] for row in register]


def _is_exact(program: Program) -> bool:
    numbers = [weight for op in program.ops for weight in op.weights]
    return all(isinstance(rational(number), Fraction) for number in numbers)


def _without_rounding(poly: Poly) -> Poly:
    # What cancels in exact arithmetic leaves rounding errors in floats.
    largest = max((abs(coefficient) for coefficient in poly.values()), default=Fraction(0))
    return {powers: coefficient for powers, coefficient in poly.items() if abs(coefficient) > largest / 10**13}


def _degree(P: Sequence[Poly], variable: int) -> int:
    return max(powers[variable] for coefficient in P for powers in coefficient)


def _short(value: Fraction) -> Number:
    """Return a Fraction of bounded size as it is, the long ones of rounded coefficients as floats."""
    return value if value.denominator < 2**64 else float(value)


def _without_common_factor(rows: Sequence[Sequence[Fraction]], *, exact: bool) -> tuple[tuple[Number, ...], ...]:
    polys = [trimmed(row) for row in rows]
    if exact:
        common = polys[0]
        for poly in polys[1:]:
            common = greatest_common_divisor(common, poly)
        polys = [quotient(poly, common) if poly else () for poly in polys]
    return tuple(tuple(_short(coefficient) for coefficient in poly) for poly in polys)
