"""The order of any program, from its series: the program is run over trees instead of numbers.

A state near the exact solution is a B-series y + sum h^|tree| a(tree) F(tree)(y) / symmetry(tree), and so is h times a slope
(Hairer, Norsett, Wanner, Solving ODEs I, sections II.2 and II.14). Every op of a program has an exact rule on the coefficients
a(tree); the program has order p when its result has the coefficients of the exact flow, 1/density, on every tree of
up to p vertices. Registers carried from earlier steps hold what the exact solution would have left there, so that
the order is that of consistency; a multistep method needs zero-stability besides.

Second-order systems x' = v, v' = a(x, v) take trees of two colours (Nystrom trees): a vertex x has at most one child, a v.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import cache, lru_cache
from typing import NamedTuple, Protocol, TypeAlias

from tparticles.errors import InputError
from tparticles.schemes.exact import rational, rounding, shown
from tparticles.schemes.program import Op, OpKind
from tparticles.schemes.program_checks import k0_time

Series: TypeAlias = list[Fraction]
System: TypeAlias = str

FIRST_ORDER, SECOND_ORDER, VELOCITY_FREE = "x' = f(t, x)", "x'' = a(t, x, v)", "x'' = a(t, x)"

# Far above every method in use; the number of trees trebles with each order.
_HIGHEST_ORDER = 10


class Program(Protocol):
    """The parts of a scheme that decide what it computes; see `Scheme`."""

    # Read-only: frozen dataclasses have to fit.
    @property
    def ops(self) -> tuple[Op, ...]: ...  # noqa: D102
    @property
    def slopes(self) -> int: ...  # noqa: D102
    @property
    def history(self) -> tuple[Op, ...]: ...  # noqa: D102
    @property
    def carried(self) -> tuple[int, ...]: ...  # noqa: D102
    @property
    def steps_back(self) -> int: ...  # noqa: D102


class Vertex(NamedTuple):
    """A tree by its root: its colour, the numbers of its subtrees in the forest, its size and its density."""

    root: str
    children: tuple[int, ...]
    order: int
    density: int


@cache
def forest(order: int, system: System) -> tuple[Vertex, ...]:
    """Return every tree of up to `order` vertices that matters for `system`, smaller ones first.

    The roots are "x" alone for first-order systems, "x" and "v" for second-order ones.
    """
    trees: list[Vertex] = []
    for size in range(1, order + 1):
        for root in "x" if system == FIRST_ORDER else "xv":
            for children in _children(trees, size - 1, root, system):
                density = size * math.prod(trees[child].density for child in children)
                trees.append(Vertex(root, children, size, density))
    return tuple(trees)


def _children(trees: Sequence[Vertex], size: int, root: str, system: System) -> Iterable[tuple[int, ...]]:
    """Yield each multiset of trees with `size` vertices together that may hang from `root`."""
    if system != FIRST_ORDER and root == "x":
        return [()] if size == 0 else [(i,) for i, tree in enumerate(trees) if tree.root == "v" and tree.order == size]
    allowed = [i for i, tree in enumerate(trees) if system != VELOCITY_FREE or tree.root == "x"]
    return list(_multisets(trees, allowed, size))


def _multisets(trees: Sequence[Vertex], allowed: Sequence[int], size: int) -> Iterable[tuple[int, ...]]:
    if size == 0:
        yield ()
        return
    for position, i in enumerate(allowed):
        if trees[i].order <= size:
            for rest in _multisets(trees, allowed[position:], size - trees[i].order):
                yield (i, *rest)


class FailedTree(NamedTuple):
    """The first tree on which a program's series differs from the exact flow's."""

    order: int
    value: Fraction
    needed: Fraction


# The starter of a multistep method is chosen by its order, before the claim is checked.
@lru_cache(maxsize=64)
def check_order(program: Program, system: System, where: str) -> tuple[int, FailedTree]:
    """Return the order of consistency of `program` on `system`, and the first tree of the next order that fails.

    Raises InputError, beginning with `where`, if an EVALUATE or SOLVE looks at f at a time that its state does not have.
    """
    exact = all(isinstance(rational(number), Fraction) for op in program.ops for number in (*op.weights, op.time))
    for p in range(1, _HIGHEST_ORDER + 1):
        trees = forest(p, system)
        result = _Run(trees, program, magnitudes=False, where=where).result()
        sizes = result if exact else _Run(trees, program, magnitudes=True, where=where).result()
        for tree, value, size in zip(trees, result, sizes, strict=True):
            needed = Fraction(1, tree.density)
            if abs(value - needed) > (0 if exact else rounding(max(1, size))):
                return p - 1, FailedTree(p, value, needed)
    raise InputError(f"{where}: its order is above {_HIGHEST_ORDER}, which is as far as orders are worked out")


def order_of(program: Program, system: System = FIRST_ORDER, where: str = "scheme") -> int:
    """Return the order of consistency of `program` on `system`; errors as for `check_order`."""
    return check_order(program, system, where)[0]


class _Run:
    """One run of a program over the coefficients of `trees`; with `magnitudes` over their sizes, for rounding bounds."""

    def __init__(self, trees: tuple[Vertex, ...], program: Program, *, magnitudes: bool, where: str):
        self.trees, self.program, self.where = trees, program, where
        self.number: Callable[[float], Fraction] = lambda value: Fraction(rational(value))
        self.checks_time = not magnitudes
        if magnitudes:
            self.number = lambda value: abs(Fraction(rational(value)))
        self.magnitudes = magnitudes
        self.k: list[Series] = [[Fraction(0)] * len(trees)] * program.slopes
        self._fill_history()

    def _fill_history(self) -> None:
        """Put into the carried registers what the steps before left there, had they been exact."""
        program = self.program
        k0_at = k0_time(program.ops)
        for back in range(program.steps_back, 0, -1):
            if k0_at is not None:
                self.k[0] = self._slope(self._flow(self.number(k0_at - back)))
            started, ended = self._flow(self.number(-back)), self._flow(self.number(1 - back))
            sign = 1 if self.magnitudes else -1
            for op in program.history:
                if op.kind is OpKind.ROTATE:
                    self.k[op.slope] = self.k[op.source]
                else:
                    self.k[op.slope] = [end + sign * start for end, start in zip(ended, started, strict=True)]

    def _flow(self, s: Fraction) -> Series:
        """Return the exact solution after s steps: s^|tree| / density."""
        return [s**tree.order / tree.density for tree in self.trees]

    def _slope(self, z: Series) -> Series:
        """Return h f(z): the product of the coefficients of the subtrees."""
        return [math.prod((z[child] for child in tree.children), start=Fraction(1)) for tree in self.trees]

    def result(self) -> Series:
        """Return the series of the state at the end of a step from the exact solution."""
        z: Series = [Fraction(0)] * len(self.trees)
        for op in self.program.ops:
            z = self._after(op, z)
        return z

    def _after(self, op: Op, z: Series) -> Series:
        weights = [self.number(weight) for weight in op.weights]
        if op.kind is OpKind.COMBINE:
            return self._sum(weights)
        if op.kind is OpKind.KICK:
            return self._added(z, self._sum(weights), "v")
        if op.kind is OpKind.DRIFT:
            # h v has the coefficients of x' = v, which are those of a slope.
            return self._added(z, [weights[0] * slope for slope in self._slope(z)], "x")
        if op.kind is OpKind.SOLVE:
            z, self.k[op.slope] = self._solved(z, weights[0], linear=op.linear)
            self._check_time(op, z)
        elif op.kind is OpKind.EVALUATE:
            self._check_time(op, z)
            self.k[op.slope] = self._slope(z)
        elif op.kind is OpKind.ROTATE:
            self.k[op.slope] = self.k[op.source]
        else:
            self.k[op.slope] = z
        return z

    def _sum(self, weights: Sequence[Fraction]) -> Series:
        used = [(weight, slope) for weight, slope in zip(weights, self.k, strict=False) if weight]
        return [
            sum((weight * slope[i] for weight, slope in used if slope[i]), Fraction(0)) for i in range(len(self.trees))
        ]

    def _added(self, z: Series, change: Series, root: str) -> Series:
        return [old + new if tree.root == root else old for old, new, tree in zip(z, change, self.trees, strict=True)]

    def _solved(self, zbar: Series, w: Fraction, *, linear: bool) -> tuple[Series, Series]:
        """Solve z = zbar + w h f(z) tree by tree: a slope's coefficient needs those of smaller trees only."""
        z, k = list(zbar), list(zbar)
        for i, tree in enumerate(self.trees):
            factors = [zbar[child] if linear else z[child] for child in tree.children]
            k[i] = math.prod(factors, start=Fraction(1))
            if linear:
                # k = h f(zbar) + w h f'(zbar) k: one factor of the product at a time is k's.
                for j, child in enumerate(tree.children):
                    k[i] += w * k[child] * math.prod(factors[:j] + factors[j + 1 :], start=Fraction(1))
            z[i] = zbar[i] + w * k[i]
        return z, k

    def _check_time(self, op: Op, z: Series) -> None:
        """Refuse a time that is not the state's: with t' = 1 as a part of the state it would be another method."""
        # The first tree is the single x: the coefficient of h in t, and in a position that moves at speed 1.
        claimed, actual = self.number(op.time), z[0]
        if self.checks_time and abs(claimed - actual) > rounding(max(1, abs(actual))):
            raise InputError(
                f"{self.where}: {op.kind.name} looks at time {shown(claimed)}, but its state is that of time {shown(actual)}"
            )
