"""The paper's two charts, redrawn: what stiffness a step's time buys."""

from __future__ import annotations

from typing import Any

from . import style
from .box import BoxStudy
from .box_paper import TABLE

_OURS, _THEIRS = style.PALETTE[0], style.PALETTE[1]


def against_time(result: BoxStudy) -> Any:
    """Draw spring coefficient against time per step: here, and as the paper has it."""
    fig, axes = style.figure(1, 2, size=(7.0, 5.6))
    shown = [b for b in result.boxes if b.grows_at and b.blows_up_at]
    ours = [(b.scheme, b.microseconds, b.grows_at, b.blows_up_at) for b in shown]
    theirs = [(row.scheme, sum(row.microseconds) / 2, *row.stiffness) for row in TABLE]
    for ax, points, color, title in (
        (axes[0, 0], ours, _OURS, f"here, from growth to blow-up ({result.drops} throws)"),
        (axes[0, 1], theirs, _THEIRS, "Scott 2002, Table 1"),
    ):
        for name, microseconds, low, high in points:
            ax.plot([microseconds] * 2, [low, high], marker="_", color=color, linewidth=2.5)
            ax.annotate(name, (microseconds, high), xytext=(3, 3), textcoords="offset points", fontsize=8.5)
        ax.set_yscale("log")
        ax.set_ylim(2.0, 5e4)
        ax.set_xlim(left=0.0)
        ax.margins(x=0.2)
        ax.set_title(title)
        ax.set_xlabel("time per step [us]")
    axes[0, 0].set_ylabel("spring coefficient [N/m]")
    fig.suptitle(f"Stable spring coefficient against time per step, dt = {result.dt:g} s")
    return fig


def index(result: BoxStudy) -> Any:
    """Draw the performance indices, each in parts of velocity Verlet's, or of the largest here."""
    ours = {b.scheme: b.index for b in result.boxes if b.index is not None}
    theirs = {row.scheme: row.index for row in TABLE}
    names = [*(n for n in theirs if n in ours), *sorted((n for n in ours if n not in theirs), key=lambda n: ours[n])]
    fig, axes = style.figure(1, 1, size=(max(6.0, 0.62 * len(names) + 2), 4.6))
    ax = axes[0, 0]
    base = ours.get("velocity-verlet") or max(ours.values(), default=1.0) or 1.0
    for shift, values, unit, color, label in (
        (-0.2, ours, base, _OURS, f"here (1 = {base:.3g} N/m per us)"),
        (0.2, theirs, theirs["velocity-verlet"], _THEIRS, f"Scott 2002 (1 = {theirs['velocity-verlet']:g})"),
    ):
        at = [i for i, name in enumerate(names) if name in values]
        bars = ax.bar([i + shift for i in at], [values[names[i]] / unit for i in at], 0.38, color=color, label=label)
        ax.bar_label(bars, [f"{values[names[i]]:.3g}" for i in at], fontsize=8, rotation=90, padding=3)
    ax.set_xticks(range(len(names)), names, rotation=40, ha="right")
    ax.margins(y=0.2)
    ax.set_ylabel("stiffness over time, relative")
    ax.set_title("Performance index")
    ax.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.3), ncols=2)
    return fig
