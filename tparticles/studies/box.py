"""Scott's study: the falling spring box, and which stiffness each scheme can bear at dt = 0.01 s.

A box is thrown into a room and watched for a minute. Drag, damping and bounces only take energy. Where its mean over 5 s
exceeds the one before by more than 5 % of the first energy, it *grows*; where it ever exceeds a hundred times the first, it *blows
up*. The least stiffness for each is found for many random throws by doubling, then bisection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import backend
from ..errors import InputError
from ..schemes import Scheme
from .box_paper import BY_SCHEME, DAMPING, DRAG, DT
from .ensemble import start_engine

if TYPE_CHECKING:
    from .box_run import BoxRun, Verdict

DROPS = 16
_LEAST, _MOST = 1.0, 2.0**17  # [N/m]
_FINE = 7  # bisections of a factor of 2: to 0.5 %
_NEVER = (10.0, 1e3, 1e5, 1e6, 1e7)  # [N/m] where implicit schemes are tried
_IMPLICIT_HORIZON = 15  # [s]
_TIMED_AT = 5.0  # [N/m], which all bear
VARIED = ("velocity-verlet", "rk4")
SEQUENCES = ((0.01, 0.01), (0.012, 0.008), (0.013, 0.007))  # [s]


@dataclass(frozen=True)
class Box:
    """What one scheme bears; stiffnesses in N/m, None where there is none.

    `grows_at`, `blows_up_at`: medians over the drops; `grows`, `blows_up`: each drop's. `spread`: of `grows_at`, from the least
    to the largest, with what bisection left open. `air`: where the stiffest mode of a falling box first grows, on the engine;
    `theory`: as the scheme's coefficients say. `evaluations` of the forces and `microseconds` per step; `index`: mean of both
    limits per microsecond.
    """

    scheme: str
    grows_at: float | None
    blows_up_at: float | None
    spread: float | None
    evaluations: int
    microseconds: float
    index: float | None
    air: float | None
    theory: float | None
    grows: tuple[float | None, ...]
    blows_up: tuple[float | None, ...]
    implicit: bool


@dataclass(frozen=True)
class Pairs:
    """Two steps [s] in turn: where the stiffest mode first grows under them, and where it would under the longer alone [N/m]."""

    scheme: str
    steps: tuple[float, float]
    grows_at: float | None
    longer_alone: float | None


@dataclass(frozen=True)
class BoxStudy:
    """The result: a box for each scheme; `refused`: schemes for first-order systems, or for undamped springs, alone."""

    dt: float
    drops: int
    horizon: float
    boxes: tuple[Box, ...]
    refused: tuple[str, ...]
    pairs: tuple[Pairs, ...]

    def rows(self) -> list[dict[str, object]]:
        """Return a row for each scheme, with the paper's figures beside ours."""
        rows = []
        for b in self.boxes:
            paper = BY_SCHEME.get(b.scheme)
            row: dict[str, object] = contract(b)
            row |= {"blows up least": _end(b.blows_up, min), "blows up most": _end(b.blows_up, max)}
            row |= {
                "grows least": _end(b.grows, min),
                "grows most": _end(b.grows, max),
                "air": b.air,
                "theory": b.theory,
            }
            row |= {
                "paper k from": paper.stiffness[0] if paper else None,
                "paper k to": paper.stiffness[1] if paper else None,
                "paper us": sum(paper.microseconds) / 2 if paper else None,
                "paper index": paper.index if paper else None,
            }
            rows.append(row)
        return rows


def contract(box: Box) -> dict[str, object]:
    """Return what `tparticles study box --json` prints of a scheme."""
    names = ("scheme", "grows_at", "blows_up_at", "spread", "evaluations", "microseconds", "index")
    return {name: getattr(box, name) for name in names}


def study(chosen: Sequence[Scheme], *, drops: int = DROPS, tell: Callable[[str], None] = lambda _: None) -> BoxStudy:
    """Find what each scheme bears, with `drops` random throws each.

    Raises:
        InputError: none of the schemes runs a damped spring box.
    """
    from . import box_run

    fit = [s for s in chosen if 2 in s.system_orders and "velocity-free forces" not in s.needs]
    if not fit:
        names = ", ".join(s.name for s in chosen)
        raise InputError(f"no scheme to study: {names} cannot run a damped spring box; take velocity-verlet or rk4")
    boxes: list[Box] = []
    pairs: list[Pairs] = []
    for scheme in fit:
        tell(f"box: {scheme.name}")
        backend.stop()  # drops the fields of the scheme before; and cached kernels fit again
        start_engine(threads=1)
        if scheme.implicit:
            boxes.append(_implicit(scheme, drops))
        else:
            run = box_run.BoxRun(scheme)
            boxes.append(_explicit(run, drops, tell))
            if scheme.name in VARIED:
                pairs += _pairs(run)
    return BoxStudy(
        dt=DT,
        drops=drops,
        horizon=box_run.HORIZON,
        boxes=tuple(boxes),
        refused=tuple(s.name for s in chosen if s not in fit),
        pairs=tuple(pairs),
    )


def theory(scheme: Scheme, *, dt: float) -> float | None:
    """Return the stiffness [N/m] at which the stiffest mode first grows: omega^2 = 8 k, with damping and drag; None if none.

    Of the graph of the box, in which each vertex is joined to every other, all springs alike: breathing.
    """

    def grows(k: float) -> bool:
        omega = math.sqrt(8.0 * k)
        return scheme.stability.oscillator_limit((8.0 * DAMPING + DRAG) / (2.0 * omega)) < omega * dt

    return first(grows, fine=20)


def first(
    grows: Callable[[float], bool], *, least: float = _LEAST, most: float = _MOST, fine: int = _FINE
) -> float | None:
    """Return the first stiffness that `grows`: by doubling from `least`, then bisection; 0 if even `least` does, None if none."""
    low = least
    if grows(low):
        return 0.0
    while low < most:
        if grows(2.0 * low):
            return _bisected(grows, low, 2.0 * low, fine)
        low *= 2.0
    return None


def _bisected(grows: Callable[[float], bool], low: float, high: float, fine: int) -> float:
    for _ in range(fine):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return math.sqrt(low * high)


def _explicit(run: BoxRun, drops: int, tell: Callable[[str], None]) -> Box:
    found: list[tuple[float | None, float | None]] = []
    for seed in range(drops):
        tell(f"box: {run.scheme.name}, drop {seed + 1} of {drops}")
        # what other drops bear by far, this one bears
        least = min((grows / 2.0 for grows, _ in found if grows), default=_LEAST)
        found.append(_limits(run, seed, least))
    return _box(
        run,
        [grows for grows, _ in found],
        [blows_up for _, blows_up in found],
        microseconds=run.microseconds(_TIMED_AT),
        air=air(run),
    )


def _limits(run: BoxRun, seed: int, least: float) -> tuple[float | None, float | None]:
    """Return where the energy of one drop first grows and where it blows up; it is stable at `least`."""
    from .box_run import Drop

    drop, known = Drop.of(seed), {}

    def verdict(k: float) -> Verdict:
        if k not in known:
            (known[k],) = run.watch([drop], k)
        return known[k]

    grows = first(lambda k: verdict(k).grew, least=_power(least))
    return grows, first(lambda k: verdict(k).blew, least=_power(grows or _LEAST))


def _power(k: float) -> float:
    """Return the power of two below, where scans begin."""
    return max(_LEAST, 2.0 ** math.floor(math.log2(k)))


def air(run: BoxRun, *, least: float = _LEAST, steps: tuple[float, float] = (DT, DT), fine: int = 10) -> float | None:
    """Return the stiffness [N/m], above `least`, at which a squeezed box first swings more and more while it falls.

    `steps` [s] alternate.
    """
    return first(lambda k: run.growth(k, steps=steps) > 1.0, least=least, fine=fine)


def _pairs(run: BoxRun) -> Iterator[Pairs]:
    for steps in SEQUENCES:
        alone = theory(run.scheme, dt=max(steps))
        # every step is a launch: no scan of what the longer step bears eight times over
        found = air(run, least=_power((alone or _LEAST) / 8.0), steps=steps, fine=_FINE)
        yield Pairs(run.scheme.name, steps, found, alone)


def _implicit(scheme: Scheme, drops: int) -> Box:
    """Try a few stiffnesses at once, over many powers of ten: a step costs a hundred times more, and none is expected to fail."""
    from .box_run import BoxRun, Drop

    throws = [Drop.of(seed) for seed in range(min(drops, 2))]
    run = BoxRun(scheme, stiffness=[k for k in _NEVER for _ in throws])
    verdicts = run.watch(throws * len(_NEVER), horizon=_IMPLICIT_HORIZON)
    per_drop = [verdicts[i :: len(throws)] for i in range(len(throws))]
    return _box(
        run,
        [_least(v.grew for v in column) for column in per_drop],
        [_least(v.blew for v in column) for column in per_drop],
        microseconds=run.microseconds(repeats=3),
        air=None,
    )


def _least(failed: Iterator[bool]) -> float | None:
    return next((k for k, bad in zip(_NEVER, failed, strict=True) if bad), None)


def _box(
    run: BoxRun,
    grows: Sequence[float | None],
    blows_up: Sequence[float | None],
    *,
    microseconds: float,
    air: float | None,
) -> Box:
    grows_at, blows_up_at = _median(grows), _median(blows_up)
    both = [k for k in (grows_at, blows_up_at) if k is not None]
    numbers = [k for k in grows if k is not None]
    return Box(
        scheme=run.scheme.name,
        grows_at=grows_at,
        blows_up_at=blows_up_at,
        spread=_spread(numbers) if grows_at is not None else None,
        evaluations=run.evaluations,
        microseconds=microseconds,
        index=sum(both) / 2 / microseconds if len(both) == 2 else None,
        air=air,
        theory=theory(run.scheme, dt=DT),
        grows=tuple(grows),
        blows_up=tuple(blows_up),
        implicit=run.scheme.implicit,
    )


def _spread(found: Sequence[float]) -> float:
    open_to = 2.0 ** (0.5 / 2**_FINE)
    return max(found) * open_to - min(found) / open_to


def _median(found: Sequence[float | None]) -> float | None:
    """Return the median, None counting as infinite."""
    value = float(np.median([math.inf if k is None else k for k in found]))
    return value if math.isfinite(value) else None


def _end(found: Sequence[float | None], which: Callable[..., float]) -> float | None:
    numbers = [k for k in found if k is not None]
    return which(numbers) if numbers else None
