"""The look of the pictures: readable sizes, a palette for colour-blind readers, schemes grouped by family."""

# pyright: reportMissingImports=false, reportMissingModuleSource=false
# matplotlib is an extra.

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .. import schemes

# M. Okabe, K. Ito, Color Universal Design (2008), without yellow: too pale for lines.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7A5195", "#8C6D31", "#888888")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)))
FAMILIES = ("explicit Runge-Kutta", "for second-order systems", "explicit multistep", "implicit", "others")
_SIZES: Any = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.labelsize": 11,
    "legend.fontsize": 10,
    "xtick.labelsize": 10,
    "ytick.labelsize": 10,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
}


def look() -> Any:
    """Return the context in which pictures are drawn."""
    import matplotlib

    return matplotlib.rc_context(_SIZES)


def figure(rows: int, columns: int, *, size: tuple[float, float], **more: Any) -> tuple[Any, Any]:
    """Return a figure and its axes, an array (rows, columns); `size` of one of the axes [inches]. No window, no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(columns * size[0], rows * size[1]), layout="constrained")
    FigureCanvasAgg(fig)
    return fig, fig.subplots(rows, columns, squeeze=False, **more)


def family(name: str) -> str:
    """Return the family of a built-in scheme; "others" for the rest."""
    scheme = schemes.CATALOGUE.get(name)
    if scheme is None:
        return FAMILIES[4]
    if scheme.implicit:
        return FAMILIES[3]
    if scheme.system_orders == {2}:
        return FAMILIES[1]
    return FAMILIES[0] if scheme.one_step else FAMILIES[2]


def families(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the names by family, those families that have some, each name once."""
    unique = list(dict.fromkeys(names))
    grouped = {kind: [name for name in unique if family(name) == kind] for kind in FAMILIES}
    return {kind: members for kind, members in grouped.items() if members}


def line(position: int, *, markers: bool = True) -> dict[str, Any]:
    """Return colour, dashes and marker of the line at this position of its family."""
    look: dict[str, Any] = {
        "color": PALETTE[position % len(PALETTE)],
        "linestyle": DASHES[position % len(DASHES)],
    }
    if markers:
        look["marker"] = MARKERS[position % len(MARKERS)]
    return look
