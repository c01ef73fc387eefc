"""Pictures of the linear theory: stability regions, limits against damping, growth of alternating steps."""

# pyright: reportMissingImports=false, reportMissingModuleSource=false
# matplotlib is an extra.

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .. import schemes
from . import style
from .linear_maps import LARGEST_RATIO
from .stability import Region, StabilityStudy, amplification
from .variable_steps import Clamp, Map, VariableSteps

_STABLE, _EDGE, _MARK = "#9CC9E8", "#0072B2", "#D55E00"
# left, right, top of a panel's plane
_EXPLICIT, _IMPLICIT = (-4.4, 1.8, 4.0), (-4.6, 12.4, 11.0)
_GRID = 201
_FRAME_SCHEMES = ("velocity-verlet", "position-verlet", "symplectic-euler", "yoshida4", "rk4", "trapezoidal")


def regions(result: StabilityStudy) -> Any:
    """Draw the region of each scheme in the plane of dt lambda on one sheet, with the limits on the axes."""
    ordered = [name for group in style.families(r.scheme for r in result.regions).values() for name in group]
    by_name = {r.scheme: r for r in result.regions}
    rows = math.ceil(len(ordered) / 8)
    columns = math.ceil(len(ordered) / rows)
    fig, axes = style.figure(rows, columns, size=(2.35, 3.2))
    for ax, name in zip(axes.flat, ordered, strict=False):
        _region_axes(ax, by_name[name])
    for ax in axes.flat[len(ordered) :]:
        ax.set_axis_off()
    fig.suptitle(
        "Stability in the plane of dt lambda: blue where a step does not grow; dots: the limits on the axes "
        "(* for second-order systems alone: the pair of roots of a damped oscillator)",
        fontsize=14,
    )
    return fig


def _region_axes(ax: Any, region: Region) -> None:
    scheme = schemes.CATALOGUE[region.scheme]
    left, right, top = _IMPLICIT if scheme.implicit else _EXPLICIT
    re, im = np.meshgrid(np.linspace(left, right, _GRID), np.linspace(top / _GRID / 4, top, _GRID))
    growth = amplification(scheme, re + 1j * im)
    growth = np.minimum(growth, 1e3)
    for side in (1, -1):
        ax.contourf(re, side * im, growth, levels=[-1, 1 + 1e-7], colors=[_STABLE])
        ax.contour(re, side * im, growth, levels=[1 + 1e-7], colors=[_EDGE], linewidths=1.2)
    ax.axhline(0, color="#777777", linewidth=0.7)
    ax.axvline(0, color="#777777", linewidth=0.7)
    splitting = scheme.system_orders == {2}
    if 0 < region.real_limit < -left and not splitting:
        ax.plot(-region.real_limit, 0, "o", color=_MARK, zorder=5)
    if 0 < region.imaginary_limit < top:
        ax.plot([0, 0], [-region.imaginary_limit, region.imaginary_limit], "o", color=_MARK, zorder=5)
    kind = ", L-stable" if region.l_stable else ", A-stable" if region.a_stable else ""
    ax.set_title(f"{region.scheme}{'*' if splitting else ''}{kind}", fontsize=10.5)
    real = "drag alone" if splitting else "real"
    ax.set_xlabel(f"{real} {_limit(region.real_limit)}, imag. {_limit(region.imaginary_limit)}", fontsize=10)
    ax.set_xlim(left, right)
    ax.set_ylim(-top, top)
    ax.set_aspect("equal")
    ax.tick_params(labelsize=9)


def _limit(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:.4g}"


def damping(result: StabilityStudy) -> Any:
    """Draw the limit of omega dt against the damping ratio, a panel for each family."""
    groups = style.families(r.scheme for r in result.regions)
    by_name = {r.scheme: r for r in result.regions}
    fig, axes = style.figure(1, len(groups), size=(5.0, 5.6), sharey=True)
    for ax, (kind, members) in zip(axes[0], groups.items(), strict=True):
        limits = {name: by_name[name].oscillator for name in members}
        for position, name in enumerate(members):
            if not any(map(math.isinf, limits[name])):
                ax.plot(result.zetas, limits[name], label=name, **style.line(position, markers=False))
        ax.set_title(kind)
        _note_unlimited(ax, result.zetas, {name: row for name, row in limits.items() if any(map(math.isinf, row))})
        ax.set_xlabel("damping ratio zeta")
        ax.set_ylim(0, 4.2)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=2, frameon=False, handlelength=3.2)
    axes[0, 0].set_ylabel("largest stable omega dt")
    fig.suptitle("Damped oscillator x'' = -omega² x - 2 zeta omega x': the limit of the step", fontsize=14)
    return fig


def _note_unlimited(ax: Any, zetas: tuple[float, ...], limits: dict[str, tuple[float, ...]]) -> None:
    """List the schemes without a limit, and where they have one nevertheless."""
    if not limits:
        return
    lines = ["stable at any step:"]
    for name, row in limits.items():
        limited = [k for k, limit in enumerate(row) if math.isfinite(limit)]
        lines.append(f"{name} (from zeta = {zetas[limited[-1] + 1]:g} on)" if limited else name)
    ax.text(0.5, 0.97, "\n".join(lines), transform=ax.transAxes, ha="center", va="top", linespacing=1.6)
    if not ax.get_legend_handles_labels()[0]:
        ax.set_xlim(zetas[0], zetas[-1])
        ax.grid(visible=False)


def alternating(result: VariableSteps) -> Any:
    """Draw the growth per pair of steps against the larger step and the ratio, a panel for each scheme."""
    from matplotlib.colors import TwoSlopeNorm

    columns = min(max(len(result.maps), 1), 6)
    rows = max(math.ceil(len(result.maps) / columns), 1)
    fig, axes = style.figure(rows, columns, size=(3.1, 3.0), sharey=True)
    norm, drawn = TwoSlopeNorm(0, vmin=-1, vmax=1), None
    for ax, m in zip(axes.flat, result.maps, strict=False):
        drawn = _map_axes(ax, m, norm)
    for ax in axes.flat[len(result.maps) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("smaller / larger step")
    for column in range(columns):
        last = max(row for row in range(rows) if row * columns + column < max(len(result.maps), 1))
        axes[last, column].set_xlabel("larger step, omega dt")
    if drawn is not None:
        bar = fig.colorbar(drawn, ax=axes, shrink=0.6, pad=0.01, extend="both")
        bar.set_label("ln(growth per pair): above 0 it blows up")
    fig.suptitle(
        "Alternating steps, each stable on its own (black line: the limit of constant ones): red pairs blow up (Wright's effect)",
        fontsize=14,
    )
    return fig


def _map_axes(ax: Any, m: Map, norm: Any) -> Any:
    growth = np.array(m.growth)
    with np.errstate(divide="ignore"):
        logs = np.log(np.maximum(growth, 1e-300))
    logs = np.where(np.abs(growth - 1) < 2e-6, 0, logs)
    drawn = ax.pcolormesh(m.omega_dt, m.ratio, np.clip(logs, -1, 1), norm=norm, cmap="RdBu_r", shading="nearest")
    reach = m.omega_dt[-1] + m.omega_dt[0]
    if math.isfinite(m.limit):
        ax.axvline(m.limit, color="black", linewidth=1.8)
    ax.set_xlim(0, reach * 1.03)
    ax.grid(visible=False)
    note = f"up to {m.worst:.3g} a pair" if m.affected else "no pair grows"
    title = m.scheme
    if m.restarts:
        title = f"{m.scheme}: restarts by {m.starter}"
    elif m.starter:
        title = f"{m.scheme}: {m.starter} beyond 1 : {LARGEST_RATIO}"
    ax.set_title(f"{title}\n{note}", fontsize=10)
    return drawn


def split_frames(result: VariableSteps) -> Any:
    """Draw growth per frame against omega frame: split 0.6 : 0.4 as by slide 32's rule, and halved."""
    wanted = [c for c in result.clamps if c.scheme in _FRAME_SCHEMES] or list(result.clamps[:6])
    wanted.sort(key=lambda c: _FRAME_SCHEMES.index(c.scheme) if c.scheme in _FRAME_SCHEMES else 0)
    columns = min(max(len(wanted), 1), 3)
    rows = max(math.ceil(len(wanted) / columns), 1)
    fig, axes = style.figure(rows, columns, size=(4.8, 3.3), sharey=True)
    for ax, clamp in zip(axes.flat, wanted, strict=False):
        _frame_axes(ax, clamp)
    for ax in axes.flat[len(wanted) :]:
        ax.set_axis_off()
    for ax in axes[:, 0]:
        ax.set_ylabel("growth per frame")
    handles = axes.flat[0].get_legend_handles_labels()
    if handles[0]:
        fig.legend(*handles, loc="outside lower center", ncols=3, frameon=False, handlelength=3.2)
    fig.suptitle("dt = 0.6 frame: what slide 32's rule (0.6, then 0.4) and equal steps (0.5, 0.5) do", fontsize=14)
    return fig


def _frame_axes(ax: Any, clamp: Clamp) -> None:
    x, split = np.array(clamp.omega_frame), np.array(clamp.split)
    ax.plot(x, split, color=_MARK, linewidth=2, label="0.6 and 0.4 of the frame")
    ax.plot(x, clamp.halved, color=_EDGE, linestyle="--", label="0.5 and 0.5 of the frame")
    grows = split > 1 + 1e-6
    ax.fill_between(
        x, 0, 1, where=grows, color=_MARK, alpha=0.15, transform=ax.get_xaxis_transform(), linewidth=0, label="grows"
    )
    span = f": grows for {x[grows][0]:.2f} to {x[grows][-1]:.2f}" if grows.any() else ""
    ax.set_title(f"{clamp.scheme}{span}", fontsize=11)
    ax.set_ylim(0, 3)
    ax.set_xlim(0, x[-1] * 1.02)
    ax.set_xlabel("omega times the frame")
