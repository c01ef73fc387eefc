"""Pictures of what runs gave: error against step, energy and phase against time."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import style
from .energy import PROBLEMS as SWINGS
from .energy import Energy
from .order import PROBLEMS, Order

_TITLES = {
    "spiral": "first order: spiral flow",
    "shaken": "second order, force without velocity",
    "rubbing": "second order, force with velocity",
}


def order(result: Order) -> Any:
    """Draw error against step: a row for each family, a column for each problem, lines of whole orders behind."""
    names = [p.name for p in PROBLEMS if any(c.problem == p.name for c in result.curves)]
    groups = style.families(c.scheme for c in result.curves)
    fig, axes = style.figure(len(groups), len(names), size=(5.0, 3.9), sharex=True, sharey=True)
    for row, (kind, members) in enumerate(groups.items()):
        for column, problem in enumerate(names):
            ax = axes[row, column]
            _order_axes(ax, result, problem, members)
            ax.set_title(f"{kind}\n{_TITLES.get(problem, problem)}")
        axes[row, 0].set_ylabel("error, relative")
        handles = [_handle(axes[row, 0], position, name) for position, name in enumerate(members)]
        axes[row, -1].legend(
            handles=handles, loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, handlelength=3.2
        )
    for ax in axes[-1]:
        ax.set_xlabel("step dt")
    fig.suptitle(
        f"Error against step (engine, f64, t = {result.span:g}): grey lines fall with order 1 to 5; in brackets the declared order",
        fontsize=14,
    )
    return fig


def _order_axes(ax: Any, result: Order, problem: str, members: list[str]) -> None:
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_ylim(1e-15, 3)
    curves = {c.scheme: c for c in result.curves if c.problem == problem}
    if not curves:
        return
    dt = np.array(next(iter(curves.values())).dt)
    for p in range(1, 6):
        guide = 0.3 * (dt / dt[0]) ** p
        ax.plot(dt[guide > 1e-15], guide[guide > 1e-15], color="#C8C8C8", linewidth=1, zorder=1)
    for position, name in enumerate(members):
        if name in curves:
            error = np.array(curves[name].error)
            drawn = np.where(np.isfinite(error) & (error < 3), error, np.nan)
            ax.plot(curves[name].dt, drawn, **style.line(position))
    if not any(name in curves for name in members):
        ax.text(0.5, 0.5, "do not apply", transform=ax.transAxes, ha="center", color="#666666")


def _handle(ax: Any, position: int, name: str) -> Any:
    from .. import schemes

    scheme = schemes.CATALOGUE.get(name)
    label = f"{name} ({scheme.order})" if scheme else name
    return ax.plot([], [], label=label, **style.line(position))[0]


def energy(result: Energy) -> Any:
    """Draw energy error and phase error against time: a column for each family, the oscillator and a pendulum."""
    groups = style.families(d.scheme for d in result.drifts)
    shown = [(SWINGS[0], "energy"), (SWINGS[1], "energy"), (SWINGS[0], "phase"), (SWINGS[1], "phase")]
    fig, axes = style.figure(len(shown), len(groups), size=(4.6, 3.3), sharex=True, sharey="row")
    for column, (kind, members) in enumerate(groups.items()):
        for row, (problem, what) in enumerate(shown):
            ax = axes[row, column]
            ax.set_xscale("log")
            ax.set_yscale("log")
            for position, name in enumerate(members):
                drift = next(d for d in result.drifts if (d.scheme, d.problem) == (name, problem))
                _drift_line(ax, drift, what, style.line(position, markers=False), name)
            ax.set_ylim((1e-16, 1e4) if what == "energy" else (1e-7, 3e3))
            ax.set_title(f"{kind if row == 0 else ''}\n{problem}".strip())
        axes[-1, column].set_xlabel("periods")
        axes[-1, column].legend(
            *axes[0, column].get_legend_handles_labels(),
            loc="upper center",
            bbox_to_anchor=(0.5, -0.2),
            ncols=2,
            frameon=False,
            handlelength=3.2,
        )
    for row, (_, what) in enumerate(shown):
        label = "largest energy error\n|E / E0 - 1|" if what == "energy" else "phase error [turns]"
        axes[row, 0].set_ylabel(label)
    fig.suptitle(
        f"Energy and phase over {result.periods} periods of {result.steps_per_period} steps "
        f"(omega dt = {result.omega_dt:.3f}; engine, f64, {result.phases} phases; a cross: it blew up)",
        fontsize=14,
    )
    return fig


def _drift_line(ax: Any, drift: Any, what: str, look: dict[str, Any], name: str) -> None:
    t = np.array(drift.periods)
    value = np.abs(np.array(drift.spread if what == "energy" else drift.phase))
    value = np.where(value > 0, value, np.nan)
    value = np.where(value < 1e7, value, np.nan)
    ax.plot(t, value, label=name, **look)
    if what == "energy" and drift.verdict == "blows up":
        seen = np.flatnonzero(np.isfinite(value) & (value < 1e4))
        if len(seen):
            ax.plot(t[seen[-1]], value[seen[-1]], marker="x", markersize=8, color=look["color"], markeredgewidth=2)
