"""Reading a log: what it says of its run, the rows of its meshes, the particles of its frames, and states between them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..errors import InputError, unknown
from . import layout

_ROWS = 256  # read at once


@dataclass(frozen=True)
class State:
    """Where something was at a `time` [s] and at `step` (a frame, of particles): `x` [m], `v` [m/s], `a` [m/s^2], (n, 3) each.

    `a` is None for particles, whose `columns`, each (n, components), hold what else is logged of them; v None where they keep none.
    """

    step: int
    time: float
    x: np.ndarray
    v: np.ndarray | None
    a: np.ndarray | None
    columns: Mapping[str, np.ndarray]


class MeshLog:
    """The rows of a mesh.

    `step`, `time` [s], `dt` [s], shape (rows,): of each row the step that it begins, and how long that step is, 0 after the last
    one. `ids`: the logged vertices.
    """

    unit = "step"

    def __init__(self, name: str, group: Any):
        self.name, self._group = name, group
        names = ("step", "time", "dt", "energy", *layout.STATE)
        count = min(len(group[name]) for name in names)  # of a killed run, the last rows may be there in part
        self.step, self.time, self.dt = (group[n][:count] for n in ("step", "time", "dt"))
        self.ids = group["id"][()]
        self.mass = group["mass"][()][self.ids]
        self.vertex_count = int(group.attrs["vertices"])
        self.scheme = str(group.attrs["scheme"])

    def __len__(self) -> int:
        return len(self.step)

    @cached_property
    def springs(self) -> dict[str, np.ndarray]:
        """Springs as the mesh has them: `springs`, `rest`, `stiffness`, `damping`, and `faces`."""
        return {name: self._group[name][()] for name in ("springs", "rest", "stiffness", "damping", "faces")}

    @cached_property
    def energy(self) -> np.ndarray:
        """Kinetic, spring and gravity energy of the whole mesh [J], shape (rows, 3)."""
        return self._group["energy"][: len(self)]

    @cached_property
    def contacts(self) -> np.ndarray:
        """The contacts, a column for each of `EVENT`, in the order of their times."""
        return self._group["contacts"][()]

    @property
    def contacts_lost(self) -> int:
        """How many contacts were too many for the log."""
        return int(self._group["contacts_lost"][()])

    def torn(self, t: float) -> np.ndarray:
        """Return which springs were torn by time `t` [s], as far as it was looked at, once a frame."""
        torn = self._group["torn"][()]
        return torn[torn[:, 0] <= t, 1].astype(np.int64)

    def state(self, row: int) -> State:
        """Return a row as it was logged."""
        x, v, a = (self._group[name][row].T for name in layout.STATE)
        return State(int(self.step[row]), float(self.time[row]), x, v, a, {})

    def series(self, name: str, rows: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return x, v or a of some vertices (places in `ids`) over some rows, which rise, shape (rows, vertices, 3)."""
        found = [self._group[name][part][:, :, places] for part in np.array_split(rows, -(-len(rows) // _ROWS))]
        return np.moveaxis(np.concatenate(found), 1, 2)

    def at(self, t: float) -> State:
        """Return the state at time `t` [s]: a row, or between two of them the cubic through both ends."""
        row = int(np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self) - 1))
        first = self.state(row)
        if t <= first.time or row + 1 == len(self):
            return first
        last = self.state(row + 1)
        assert first.v is not None and last.v is not None and first.a is not None and last.a is not None
        h, s = last.time - first.time, (t - first.time) / (last.time - first.time)
        x = cubic(s, h, first.x, first.v, last.x, last.v)
        v = cubic(s, h, first.v, first.a, last.v, last.a)
        return State(first.step, t, x, v, (1 - s) * first.a + s * last.a, {})


class ParticleLog:
    """The particles of a group, frame by frame: `step`, the number of each logged frame, and its `time` [s]."""

    unit = "frame"

    def __init__(self, name: str, group: Any):
        self.name, self._group, self._columns = name, group, group["columns"]
        count = min(len(group[n]) for n in ("frame", "time", "first", "count"))
        self.step, self.time, self._first, self._count = (group[n][:count] for n in ("frame", "time", "first", "count"))
        self.scheme = str(group.attrs["scheme"])

    def __len__(self) -> int:
        return len(self.step)

    @property
    def names(self) -> tuple[str, ...]:
        """What is logged of each particle."""
        return tuple(self._columns)

    def state(self, row: int) -> State:
        """Return a frame as it was logged."""
        place = slice(int(self._first[row]), int(self._first[row] + self._count[row]))
        columns = {name: array[place] for name, array in self._columns.items()}
        return State(int(self.step[row]), float(self.time[row]), columns["x"], columns.get("v"), None, columns)

    def at(self, t: float) -> State:
        """Return the living at time `t` [s].

        Who lives in both frames around it is on the cubic between them; who dies meanwhile flies on to the later frame, and who is
        born meanwhile has flown to where it is then.
        """
        row = int(np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self) - 1))
        first = self.state(row)
        if t <= first.time or row + 1 == len(self):
            return first
        return _between(t, first, self.state(row + 1))


def _between(t: float, first: State, last: State) -> State:
    ids, later = first.columns["id"][:, 0], last.columns["id"][:, 0]
    born = ~np.isin(later, ids) & (last.columns["birth"][:, 0] <= t)
    _, here, there = np.intersect1d(ids, later, return_indices=True)
    h, s = last.time - first.time, (t - first.time) / (last.time - first.time)
    columns = {name: np.concatenate([values, last.columns[name][born]]) for name, values in first.columns.items()}
    count = len(ids)
    for name in ("x", "v", "T"):
        if name in columns:
            a, b = first.columns[name][here], last.columns[name][there]
            columns[name][here] = (1 - s) * a + s * b
    if first.v is not None and last.v is not None:
        x = columns["x"]
        x[:count] = first.x + (t - first.time) * first.v
        x[here] = cubic(s, h, first.x[here], first.v[here], last.x[there], last.v[there])
        x[count:] = last.x[born] - (last.time - t) * last.v[born]
    return State(first.step, t, columns["x"], columns.get("v"), None, columns)


def cubic(s: float, h: float, x0: np.ndarray, v0: np.ndarray, x1: np.ndarray, v1: np.ndarray) -> np.ndarray:
    """Return the cubic through two points `h` [s] apart with these derivatives, at the fraction `s` of the way (Hermite)."""
    b = s * (1 - s)
    return x0 + s * s * (3 - 2 * s) * (x1 - x0) + h * b * ((1 - s) * v0 - s * v1)


class Log:
    """An open log; use it in a `with`. Its run may still be at work, or have been killed.

    Raises:
        InputError: no such file, no log, a log of another version, a missing library.
    """

    def __init__(self, path: Path):
        self.path = path
        h5py, _ = layout.hdf5()
        if not path.is_file():
            raise InputError(f"log '{path}' " + ("is a folder" if path.is_dir() else "does not exist") + _near(path))
        try:
            self._file = h5py.File(path, "r", libver="latest", swmr=True, locking=False)
        except OSError:
            raise InputError(f"'{path}' is no log of tparticles, or a damaged one") from None
        try:
            self._read()
        except BaseException:
            self._file.close()
            raise

    def _read(self) -> None:
        attributes = self._file.attrs
        if attributes.get("format") != layout.FORMAT:
            raise InputError(f"'{self.path}' is no log of tparticles")
        if attributes["version"] != layout.VERSION:
            raise InputError(
                f"log '{self.path}' has version {attributes['version']} of the format, this tparticles reads {layout.VERSION}"
            )
        self.header: dict[str, Any] = json.loads(attributes["header"])
        self.complete = bool(self._file["complete"][()])
        self.meshes = {name: MeshLog(name, group) for name, group in self._file.get("meshes", {}).items()}
        self.particles = {name: ParticleLog(name, group) for name, group in self._file.get("particles", {}).items()}

    @property
    def groups(self) -> dict[str, MeshLog | ParticleLog]:
        """All groups that are logged, in the order of the scene."""
        found = {**self.meshes, **self.particles}
        return {name: found[name] for name in self.header["groups"] if name in found}

    def group(self, name: str | None) -> MeshLog | ParticleLog:
        """Return a group by name; without one the first mesh, or, where there is none, the first of all.

        Raises:
            InputError: there is none of that name, or nothing is logged of it yet.
        """
        if name is not None and name not in self.groups:
            raise unknown("group", name, self.groups)
        found = self.groups[name] if name else next(iter([*self.meshes.values(), *self.groups.values()]))
        if not len(found):
            raise InputError(f"log '{self.path}' is empty: nothing of '{found.name}' was written before the run ended")
        return found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _near(path: Path) -> str:
    """Return the log that was meant, if it lies in the folder, or is unfinished."""
    folder = path if path.is_dir() else path.parent
    found = [folder / name for name in (layout.NAME, layout.UNFINISHED) if (folder / name).is_file()]
    return f"; did you mean '{found[0]}'?" if found else ""


def row_range(text: str | None, group: MeshLog | ParticleLog) -> np.ndarray:
    """Return the rows of a range of steps such as `100-200`, `100-200x5` (every fifth row), `100-` or `7`; all without one.

    Raises:
        InputError: it cannot be read, or leaves the log.
    """
    first, last = int(group.step[0]), int(group.step[-1])
    if text is None:
        return np.arange(len(group))
    begin, dash, end = text.partition("-")
    end, cross, stride = end.partition("x")
    parts = [begin, *([end] if end else []), *([stride] if cross else [])]
    if not all(part.strip().isascii() and part.strip().isdecimal() and len(part) < 18 for part in parts):
        raise InputError(f"range '{text}': {group.unit}s such as 100-200, 100-200x5, 100- or 7 are needed")
    low, high, each = int(begin), int(end) if end else (last if dash else int(begin)), int(stride or 1)
    if each < 1 or high < low:
        raise InputError(f"range '{text}' is empty")
    if low < first or high > last:
        raise InputError(f"range '{text}' leaves the log: '{group.name}' has {group.unit}s {first}-{last}")
    rows = np.flatnonzero((group.step >= low) & (group.step <= high))[::each]
    if not len(rows):
        raise InputError(f"range '{text}': no {group.unit} in it is logged; the nearest is {_nearest(low, group)}")
    return rows


def _nearest(step: int, group: MeshLog | ParticleLog) -> int:
    return int(group.step[np.abs(group.step - step).argmin()])
