"""Graphs of a log."""

# pyright: reportMissingImports=false
# matplotlib is an extra.

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError, RunError
from ..output.files import atomic_file, reason
from ..studies import style
from . import layout
from .series import UNITS, Series

FORMATS = (".png", ".svg", ".pdf")
_DPI = 110
_MOST_LINES = 40  # with a legend and colours that can be told apart


def draw(found: Sequence[Series], title: str, path: Path) -> None:
    """Draw a row of graphs over time for each quantity, one for each component, as PNG, SVG or PDF by the file's suffix.

    Raises:
        InputError: another suffix, no matplotlib.
        RunError: the file cannot be written.
    """
    if path.suffix not in FORMATS:
        raise InputError(f"--out {path}: one of {', '.join(FORMATS)} is needed")
    layout.check_libraries("log", "matplotlib")
    with style.look():
        figure = _figure(found, title)
        try:
            with atomic_file(path) as file:
                metadata = (
                    {"Software": None} if path.suffix == ".png" else {"Date": None} if path.suffix == ".svg" else None
                )
                figure.savefig(file, format=path.suffix[1:], dpi=_DPI, metadata=metadata)
        except OSError as error:
            raise RunError(f"cannot write {path}: {reason(error)}") from error


def _figure(found: Sequence[Series], title: str) -> Any:
    columns = max(len(series.components) for series in found)
    fig, axes = style.figure(len(found), columns, size=(8.0 if columns == 1 else 4.6, 3.2), sharex=True)
    for row, series in zip(axes, found, strict=True):
        for place, ax in enumerate(row):
            if place >= len(series.components):
                ax.set_visible(False)
                continue
            _graph(ax, series, place)
    for ax in axes[-1]:
        ax.set_xlabel("t [s]")
    fig.suptitle(title)
    return fig


def _graph(ax: Any, series: Series, component: int) -> None:
    name, part = series.name, series.components[component]
    many = len(series.lines) > _MOST_LINES
    for n, label in enumerate(series.lines):
        look = {"color": style.PALETTE[0], "alpha": 0.3, "linewidth": 0.6} if many else style.line(n, markers=False)
        ax.plot(series.time, series.values[:, n, component], label=label, **look)
    ax.set_ylabel(f"{name}{f'.{part}' if part else ''} [{UNITS[name]}]")
    if not many and component == 0:
        ax.legend(ncols=-(-len(series.lines) // 8))
