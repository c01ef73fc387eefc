"""The work-precision diagram."""

# pyright: reportMissingImports=false, reportMissingModuleSource=false
# matplotlib is an extra.

from __future__ import annotations

from typing import Any

from . import style
from .precision import Point, Precision

_PEER = "#777777"


def precision(result: Precision) -> Any:
    """Draw wall time and evaluations against the largest error: a row for each precision, a line for each scheme and control.

    Fixed steps are solid lines with filled markers, tolerances dashed ones with open markers, scipy's solvers grey.
    """
    rows = list(dict.fromkeys(p.precision for p in result.points if not p.peer)) or ["f64"]
    lines = _lines(result)
    looks = _looks(result)
    fig, axes = style.figure(len(rows), 2, size=(6.2, max(4.4, 0.2 * len(lines) / len(rows))), sharey="col")
    for row, name in enumerate(rows):
        for column, what in enumerate(("seconds", "evaluations")):
            ax = axes[row, column]
            ax.set_xscale("log")
            ax.set_yscale("log")
            for label, points in lines.items():
                shown = [p for p in points if p.peer or p.precision == name]
                if column == 1 and shown and shown[0].peer and "each" in label:
                    continue
                _line(ax, shown, what, looks[label])
            ax.set_title(f"{'wall time' if column == 0 else 'evaluations per particle'}, {name}")
            ax.set_ylabel("wall time [s]" if column == 0 else "evaluations per particle")
            for target in {c.target for c in result.choices}:
                ax.axvline(target, color="#AAAAAA", linewidth=0.9, linestyle=":", zorder=0)
            ax.invert_xaxis()
    for ax in axes[-1]:
        ax.set_xlabel(f"largest error [{result.unit}]")
    handles = [axes[0, 0].plot([], [], label=label, **looks[label])[0] for label in lines]
    fig.legend(
        handles=handles,
        loc="outside right center",
        frameon=False,
        handlelength=3.2,
        ncols=1 + (len(lines) > 36 * len(rows)),
    )
    fig.suptitle(f"Work against error, {result.particles} particles: {result.what}", fontsize=14)
    return fig


def _lines(result: Precision) -> dict[str, list[Point]]:
    """Group the points by line, families together, peers last."""
    names = [p.solver for p in result.points if not p.peer]
    ordered = [name for members in style.families(names).values() for name in members]
    rank = {name: i for i, name in enumerate(ordered)}
    points = sorted(result.points, key=lambda p: (p.peer, rank.get(p.solver, 0), "" if p.peer else p.control))
    lines: dict[str, list[Point]] = {}
    for p in points:
        lines.setdefault(p.solver if p.peer else p.label, []).append(p)
    return lines


def _looks(result: Precision) -> dict[str, dict[str, Any]]:
    """Return colour and marker by scheme, dashes by control."""
    looks: dict[str, dict[str, Any]] = {}
    ours: list[str] = []
    peers: list[str] = []
    for label, points in _lines(result).items():
        p = points[0]
        if p.peer:
            method = label.rsplit(" ", 1)[0]  # the same marker stacked and each
            if method not in peers:
                peers.append(method)
            look = {"color": _PEER, "marker": style.MARKERS[peers.index(method) % len(style.MARKERS)]}
            dashes = ":" if label.endswith("each") else "-"
            looks[label] = look | {"linestyle": dashes, "linewidth": 1.2, "markersize": 4}
            continue
        if p.solver not in ours:
            ours.append(p.solver)
        position = ours.index(p.solver)
        look = {
            "color": style.PALETTE[position % len(style.PALETTE)],
            "marker": style.MARKERS[(position + position // len(style.PALETTE)) % len(style.MARKERS)],
            "linestyle": {"fixed": "-", "error": "--"}.get(p.control, ":"),
        }
        looks[label] = look | ({} if p.control == "fixed" else {"markerfacecolor": "white"})
    return looks


def _line(ax: Any, points: list[Point], what: str, look: dict[str, Any]) -> None:
    shown = [p for p in points if 1e-11 < p.largest < 10 or (p.largest < 1e3 and "px" in p.control)]
    ax.plot([p.largest for p in shown], [getattr(p, what) for p in shown], **look)
