"""Quantities over the rows of a log, by name: what graphs and tables show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, unknown
from . import layout
from .read import MeshLog, ParticleLog

UNITS = {"x": "m", "v": "m/s", "a": "m/s²", "force": "N", "speed": "m/s", "energy": "J", "T": "K"}
_BYTES = 2 << 30  # of what is held at once


@dataclass(frozen=True)
class Series:
    """One quantity: `values`, (rows, lines, components), at `time` [s]; names of the lines and of the components."""

    name: str
    time: np.ndarray
    values: np.ndarray
    lines: tuple[str, ...]
    components: tuple[str, ...]


def series(group: MeshLog | ParticleLog, names: Sequence[str], rows: np.ndarray, ids: Sequence[int]) -> list[Series]:
    """Return quantities of a group over some rows; `ids`: whose, but for energies, which are of all.

    Raises:
        InputError: an unknown quantity (the nearest is suggested), an id that is not in the log, too much to hold.
    """
    known = quantities(group)
    for name in names:
        if name not in known:
            raise unknown(
                f"quantity of {'mesh' if isinstance(group, MeshLog) else 'group'} '{group.name}'", name, known
            )
    if 24 * len(rows) * len(ids) * len(names) > _BYTES:
        raise InputError(
            f"{len(rows)} {group.unit}s of {len(ids)} ids are too much at once: give fewer, by --range or --ids"
        )
    find = _mesh if isinstance(group, MeshLog) else _particles
    return [find(group, name, rows, ids) for name in names]  # type: ignore[arg-type]


def quantities(group: MeshLog | ParticleLog) -> tuple[str, ...]:
    """Return the names of what there is of a group."""
    if isinstance(group, MeshLog):
        return ("energy", "x", "v", "a", "force", "speed")
    return tuple(
        name for name in ("x", "v", "speed", "T") if name in group.names or (name == "speed" and "v" in group.names)
    )


def _mesh(group: MeshLog, name: str, rows: np.ndarray, ids: Sequence[int]) -> Series:
    time, lines = group.time[rows], tuple(map(str, ids))
    if name == "energy":
        parts = group.energy[rows]
        values = np.concatenate([parts, parts.sum(axis=1, keepdims=True)], axis=1)
        return Series(name, time, values[:, :, None], (*layout.ENERGIES, "total"), ("",))
    places = _places(group, ids)
    values = group.series({"force": "a", "speed": "v"}.get(name, name), rows, places).astype(float)
    if name == "speed":
        return Series(name, time, np.linalg.norm(values, axis=2, keepdims=True), lines, ("",))
    if name == "force":
        values *= group.mass[places][:, None]
    return Series(name, time, values, lines, ("x", "y", "z"))


def _places(group: MeshLog, ids: Sequence[int]) -> np.ndarray:
    """Return where vertices are in the rows. Raises InputError."""
    missing = sorted(set(ids) - set(group.ids.tolist()))
    if missing:
        raise InputError(f"vertex {missing[0]} of '{group.name}' is not in the log, which has {_short(group.ids)}")
    return np.searchsorted(group.ids, np.asarray(ids))


def _short(ids: np.ndarray) -> str:
    if len(ids) == ids[-1] - ids[0] + 1:
        return f"{ids[0]}-{ids[-1]}"
    return ", ".join(map(str, ids[:5])) + (", ..." if len(ids) > 5 else "")


def _particles(group: ParticleLog, name: str, rows: np.ndarray, ids: Sequence[int]) -> Series:
    source = "v" if name == "speed" else name
    values = None
    for n, row in enumerate(rows):
        columns = group.state(int(row)).columns
        if values is None:
            values = np.full((len(rows), len(ids), columns[source].shape[1]), np.nan)
        _, here, there = np.intersect1d(columns["id"][:, 0], ids, return_indices=True)
        values[n, there] = columns[source][here]
    assert values is not None
    if np.isnan(values).all():
        raise InputError(f"group '{group.name}': none of the ids {', '.join(map(str, ids[:5]))} lived in these frames")
    if name == "speed":
        values = np.linalg.norm(values, axis=2, keepdims=True)
    components = ("x", "y", "z") if values.shape[2] == 3 else ("",)
    return Series(name, group.time[rows], values, tuple(map(str, ids)), components)
