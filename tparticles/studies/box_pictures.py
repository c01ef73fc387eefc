"""The paper's two charts, redrawn: what stiffness a step's time buys."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from . import style
from .box import BoxStudy
from .box_paper import TABLE

_OURS, _THEIRS = style.PALETTE[0], style.PALETTE[1]
_LINES = 36  # of labels that fit above each other
_ASIDE = 0.035  # of the width of a picture, from marks to their labels
_APART = 2.0  # from one time per step to the next: what lies closer shares a column of labels

Mark = tuple[str, float, float, float]  # scheme, microseconds a step, stiffness from and to [N/m]


def against_time(result: BoxStudy) -> Any:
    """Draw spring coefficient against time per step: here, and as the paper has it."""
    fig, axes = style.figure(1, 2, size=(7.0, 5.6), sharey=True)
    ours = [(b.scheme, b.microseconds, b.grows_at, b.blows_up_at) for b in result.boxes if b.grows_at and b.blows_up_at]
    theirs = [(row.scheme, sum(row.microseconds) / 2, *row.stiffness) for row in TABLE]
    throws = f"{result.drops} throw{'s' * (result.drops != 1)}"
    stiffnesses = [k for mark in (*ours, *theirs) for k in mark[2:]]
    axes[0, 0].set(yscale="log", ylim=(min(stiffnesses) / 3.0, max(stiffnesses) * 3.0))
    for ax, marks, color, title in (
        (axes[0, 0], ours, _OURS, f"here, from growth to blow-up ({throws})"),
        (axes[0, 1], theirs, _THEIRS, "Scott 2002, Table 1"),
    ):
        times = [mark[1] for mark in marks or theirs]
        # explicit schemes take a few microseconds, implicit ones a thousand; to the right the last label needs room
        ax.set(xscale="log", xlim=(min(times) / 1.5, max(times) * max(3.0, (max(times) / min(times)) ** 0.3)))
        for _, microseconds, low, high in marks:
            ax.plot([microseconds] * 2, [low, high], marker="_", color=color, linewidth=2.5)
        for column in _columns(marks):
            _label(ax, column)
        if not marks:
            ax.text(0.5, 0.5, "none blew up", transform=ax.transAxes, ha="center")
        ax.set_title(title)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.set_xlabel("time per step [us]")
    axes[0, 0].set_ylabel("spring coefficient [N/m]")
    fig.suptitle(f"Stable spring coefficient against time per step, dt = {result.dt:g} s")
    return fig


def _columns(marks: Sequence[Mark]) -> Iterator[list[Mark]]:
    """Yield marks that take about as long, from the quickest to the slowest."""
    column: list[Mark] = []
    for mark in sorted(marks, key=lambda m: m[1]):
        if column and mark[1] > _APART * column[-1][1]:
            yield column
            column = []
        column.append(mark)
    if column:
        yield column


def _label(ax: Any, marks: Sequence[Mark]) -> None:
    """Write the names of marks into a column to their right, below each other in their order."""
    left, right = ax.get_xlim()
    bottom, top = np.log10(ax.get_ylim())
    column = max(microseconds for _, microseconds, _, _ in marks) * (right / left) ** _ASIDE
    ranked = sorted(marks, key=lambda m: m[2] * m[3])
    middles = [float(0.5 * np.log10(low * high)) for _, _, low, high in ranked]
    places = spread(middles, (top - bottom) / _LINES)
    for (name, microseconds, *_), middle, place in zip(ranked, middles, places, strict=True):
        ax.annotate(
            name,
            (microseconds, 10.0**middle),
            xytext=(column, 10.0**place),
            va="center",
            fontsize=8.5,
            arrowprops={
                "arrowstyle": "-",
                "color": "#AAAAAA",
                "linewidth": 0.7,
                "shrinkA": 1.0,
                "shrinkB": 3.0,
                "relpos": (0.0, 0.5),
            },
        )


def spread(wanted: Sequence[float], gap: float) -> np.ndarray:
    """Return places at least `gap` apart for values in rising order; those that give way stay centred on what they wanted."""
    blocks: list[tuple[float, int]] = []  # the sum of what is wanted, less the gaps below, and how many share it
    for i, value in enumerate(wanted):
        total, count = value - i * gap, 1
        while blocks and blocks[-1][0] / blocks[-1][1] > total / count:
            below = blocks.pop()
            total, count = total + below[0], count + below[1]
        blocks.append((total, count))
    return np.array([total / count for total, count in blocks for _ in range(count)]) + gap * np.arange(len(wanted))


def has_index(result: BoxStudy) -> bool:
    """Whether any scheme has a performance index: one that never blows up has none."""
    return any(b.index is not None for b in result.boxes)


def index(result: BoxStudy) -> Any:
    """Draw the performance indices, each in parts of velocity Verlet's, or of the largest here."""
    ours = {b.scheme: b.index for b in result.boxes if b.index is not None}
    theirs = {row.scheme: row.index for row in TABLE}
    names = [*(n for n in theirs if n in ours), *sorted((n for n in ours if n not in theirs), key=lambda n: ours[n])]
    fig, axes = style.figure(1, 1, size=(max(6.0, 0.62 * len(names) + 2), 4.6))
    ax = axes[0, 0]
    base = ours.get("velocity-verlet") or max(ours.values(), default=1.0) or 1.0
    for shift, values, unit, color, label in (
        (-0.2, ours, base, _OURS, f"here (1 = {_short(base)} N/m per us)"),
        (0.2, theirs, theirs["velocity-verlet"], _THEIRS, f"Scott 2002 (1 = {theirs['velocity-verlet']:g})"),
    ):
        at = [i for i, name in enumerate(names) if name in values]
        bars = ax.bar([i + shift for i in at], [values[names[i]] / unit for i in at], 0.38, color=color, label=label)
        ax.bar_label(bars, [_short(values[names[i]]) for i in at], fontsize=8, rotation=90, padding=3)
    ax.set_yscale("log")
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right")
    ax.margins(y=0.2)
    ax.set_ylabel("stiffness over time, relative")
    ax.set_title("Performance index")
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.3), ncols=2)
    return fig


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"
