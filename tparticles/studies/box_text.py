"""What the box study found, in words and a table beside the paper's."""

from __future__ import annotations

import textwrap

import numpy as np

from .box import Box, BoxStudy
from .box_paper import BY_SCHEME, DIFFERENCES, PER_CALL, PER_EVALUATION
from .report import table

_WIDTH = 120


def summary(result: BoxStudy) -> str:
    """Return the table beside the paper's, why they differ, and what came of the paper's open questions."""
    head = ["scheme", "grows", "blows up", "in the air", "theory", "eval.", "us/step", "index"]
    rows: list[list[object]] = [[*head, "paper k", "paper us", "paper index"]]
    rows += [_row(box) for box in result.boxes]
    drops = f"{result.drops} throw{'s' * (result.drops != 1)}"
    lines = [
        f"Spring coefficient [N/m] at dt = {result.dt:g} s: medians (least .. largest) of {drops} over {result.horizon:g} s",
        table(rows),
    ]
    if result.refused:
        lines.append(f"left out, of first order alone or for forces without velocity: {', '.join(result.refused)}")
    paragraphs = [DIFFERENCES, *_implicit(result), *_gear(result), *_varied(result), *_optimised(result)]
    return "\n\n".join(["\n".join(lines), *(textwrap.fill(" ".join(p.split()), _WIDTH) for p in paragraphs)])


def _row(box: Box) -> list[object]:
    paper = BY_SCHEME.get(box.scheme)
    theirs = ["-"] * 3
    if paper:
        theirs = [_span(*paper.stiffness), _span(*paper.microseconds), f"{paper.index:g}"]
    return [
        box.scheme,
        _found(box.grows_at, box.grows),
        _found(box.blows_up_at, box.blows_up),
        "-" if box.implicit else _number(box.air),
        _number(box.theory),
        box.evaluations,
        f"{box.microseconds:.3g}",
        "-" if box.index is None else f"{box.index:.3g}",
        *theirs,
    ]


def _found(median: float | None, each: tuple[float | None, ...]) -> str:
    numbers = [k for k in each if k is not None]
    if median is None or not numbers:
        return "never"
    return f"{_number(median)} ({_number(min(numbers))} .. {_number(max(numbers))})"


def _number(k: float | None) -> str:
    if k is None:
        return "never"
    return f"{k:.0f}" if k >= 100 else f"{k:.3g}"


def _span(low: float, high: float) -> str:
    return f"{low:g}-{high:g}"


def _implicit(result: BoxStudy) -> list[str]:
    if not any(b.implicit for b in result.boxes):
        return []
    return [
        "Implicit schemes are tried at a few k from 10 to 1e7 alone, for 15 s: the k given is the first of them that failed. "
        "A contact within their steps is resolved vertex by vertex, as if it flew on freely: from k = 1e6 on that can kick a "
        "box that its scheme does not damp."
    ]


def _gear(result: BoxStudy) -> list[str]:
    gear = next((b for b in result.boxes if b.scheme == "bdf2"), None)
    if gear is None:
        return []
    fate = "never grew" if gear.grows_at is None else f"first grew at k = {_number(gear.grows_at)}"
    return [
        f"Gear's method (bdf2): on the same box, tried from k = 10 to 1e7, its energy {fate}; a step takes "
        f"{gear.microseconds:.0f} us, as its stage is solved on the host: accurate for stiff springs where their vibration "
        "does not matter, which it damps away."
    ]


def _varied(result: BoxStudy) -> list[str]:
    if not result.pairs:
        return []
    found = [
        f"{p.scheme}, {p.steps[0]:g} / {p.steps[1]:g} s: {_number(p.grows_at)} (the longer alone: {_number(p.longer_alone)})"
        for p in result.pairs
    ]
    return [
        f"Varying steps: two steps in turn of the same mean, and where the stiffest mode of the falling box first grows [N/m]. "
        f"{'; '.join(found)}. Below the longer step's own limit Verlet's pairs can grow together although each step is stable "
        "(J. P. Wright 1998), so steps are better equal; a step chosen from the springs, StabilityLimit(), bears any k."
    ]


def _optimised(result: BoxStudy) -> list[str]:
    explicit = [b for b in result.boxes if not b.implicit]
    if len({b.evaluations for b in explicit}) < 2:
        return []
    per_evaluation, per_call = np.polyfit([b.evaluations for b in explicit], [b.microseconds for b in explicit], 1)
    return [
        f"Optimised code: time per step fits {per_call:.2g} us + {per_evaluation:.2g} us per force evaluation here (one "
        f"thread, f64, many steps in one launch), against {PER_CALL:g} us + {PER_EVALUATION:g} us in 2002: "
        f"{PER_EVALUATION / per_evaluation:.0f} times as fast per evaluation."
    ]
