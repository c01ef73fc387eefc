"""A log as files that other programs read: CSV, NumPy's npz, PLY and VTU; USD is in `export_usd`."""

# pyright: reportMissingImports=false, reportArgumentType=false
# meshio is an extra.

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..errors import InputError, RunError
from ..output.files import atomic_file, reason
from . import layout
from .read import MeshLog, ParticleLog, State
from .series import series

_ONE = {"csv", "npz", "usd"}  # the others make a file for each row
FORMATS = ("csv", "npz", "ply", "vtu", "usd")
_BYTES = 2 << 30  # of an npz


def default_name(kind: str, name: str) -> str:
    """Return how what is exported of a group is called: a file, or a folder of files."""
    return f"{name}.{kind}" if kind in _ONE else f"{name}-{kind}"


def export(group: MeshLog | ParticleLog, rows: np.ndarray, kind: str, path: Path) -> list[Path]:
    """Write rows of a group as csv, npz, ply or vtu; return the files.

    Raises:
        InputError: too much for one array, a missing library.
        RunError: a file cannot be written.
    """
    writers = {"csv": _csv, "npz": _npz, "ply": _meshes, "vtu": _meshes}
    try:
        return writers[kind](group, rows, kind, path)
    except OSError as error:
        raise RunError(f"cannot write {path}: {reason(error)}") from error


def _csv(group: MeshLog | ParticleLog, rows: np.ndarray, _kind: str, path: Path) -> list[Path]:
    """A line for each vertex of each row; energies in a second file."""
    with atomic_file(path) as file:
        head = False
        for state in _states(group, rows):
            columns, text = _columns(group, state), io.StringIO()
            table = csv.writer(text, lineterminator="\n")
            if not head:
                table.writerow([group.unit, "time", "id", *columns])
                head = True
            values = np.column_stack(list(columns.values())).tolist()
            ids = _ids(group, state).tolist()
            table.writerows([state.step, state.time, i, *line] for i, line in zip(ids, values, strict=True))
            file.write(text.getvalue().encode())
    if not isinstance(group, MeshLog):
        return [path]
    energies = path.with_name(f"{path.stem}-energy{path.suffix}")
    with atomic_file(energies) as file:
        head_line = ",".join(("step", "time", "dt", *layout.ENERGIES)) + "\n"
        values = np.column_stack([group.step[rows], group.time[rows], group.dt[rows], group.energy[rows]])
        file.write(head_line.encode())
        np.savetxt(file, values, delimiter=",", fmt=["%d", *["%.17g"] * 5])
    return [path, energies]


def _npz(group: MeshLog | ParticleLog, rows: np.ndarray, _kind: str, path: Path) -> list[Path]:
    """All arrays; of particles those of all frames one after the other, `count` of each frame."""
    if isinstance(group, MeshLog):
        if 36 * len(rows) * len(group.ids) > _BYTES:
            raise InputError(
                f"{len(rows)} steps of {len(group.ids)} vertices are too much for one npz: give fewer, by --range"
            )
        of = {s.name: s.values for s in series(group, layout.STATE, rows, group.ids.tolist())}
        arrays = {"step": group.step[rows], "time": group.time[rows], "dt": group.dt[rows], "id": group.ids, **of}
        arrays |= {"mass": group.mass, "energy": group.energy[rows], "contacts": group.contacts, **group.springs}
    else:
        states = list(_states(group, rows))
        arrays = {name: np.concatenate([s.columns[name] for s in states]) for name in group.names}
        arrays |= {"frame": group.step[rows], "time": group.time[rows], "count": np.array([len(s.x) for s in states])}
    with atomic_file(path) as file:
        np.savez_compressed(file, **arrays)
    return [path]


def _meshes(group: MeshLog | ParticleLog, rows: np.ndarray, kind: str, path: Path) -> list[Path]:
    """A file for each row, and for ParaView a list of them with their times."""
    layout.check_libraries("export", "meshio")
    import meshio

    path.mkdir(exist_ok=True)
    written, times = [], []
    for state in _states(group, rows):
        columns = _columns(group, state)
        ids = _ids(group, state)
        if kind == "vtu":
            data = {"id": ids.astype(np.int64), "v": state.v, "a": state.a, "T": state.columns.get("T")}
            if isinstance(group, MeshLog) and state.a is not None:
                data["force"] = group.mass[:, None] * state.a
            data = {name: np.ascontiguousarray(values) for name, values in data.items() if values is not None}
        else:
            data = {"id": ids.astype(np.int32)} | {
                n: np.float32(c) for n, c in columns.items() if n not in ("x", "y", "z")
            }
        mesh = meshio.Mesh(np.ascontiguousarray(state.x), _cells(group, len(state.x), kind), point_data=data)
        file = path / f"{group.unit}-{state.step:06d}.{kind}"
        # under a temporary name, which keeps the suffix that meshio goes by
        part = file.with_name(f".{file.name}.{kind}")
        mesh.write(part, **({"binary": True} if kind == "ply" else {}))
        part.replace(file)
        written.append(file)
        times.append(state.time)
    if kind == "vtu":
        written.append(_collection(path, written, times))
    return written


def _cells(group: MeshLog | ParticleLog, count: int, kind: str) -> list[tuple[str, np.ndarray]]:
    whole = isinstance(group, MeshLog) and len(group.ids) == group.vertex_count
    cells = []
    if whole:
        springs = group.springs  # type: ignore[union-attr]
        cells = [("line", springs["springs"]), ("triangle", springs["faces"])]
        cells = [(name, ends) for name, ends in cells if len(ends) and (kind == "vtu" or name == "triangle")]
    if not cells and kind == "vtu":
        cells = [("vertex", np.arange(count)[:, None])]
    return cells


def _collection(folder: Path, files: Sequence[Path], times: Sequence[float]) -> Path:
    """Write ParaView's list of a series."""
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    listed = ElementTree.SubElement(root, "Collection")
    for file, time in zip(files, times, strict=True):
        ElementTree.SubElement(listed, "DataSet", timestep=repr(time), part="0", file=file.name)
    path = folder / f"{folder.name}.pvd"
    with atomic_file(path) as out:
        out.write(ElementTree.tostring(root, xml_declaration=True))
    return path


def _states(group: MeshLog | ParticleLog, rows: np.ndarray) -> Iterator[State]:
    for row in rows:
        yield group.state(int(row))


def _ids(group: MeshLog | ParticleLog, state: State) -> np.ndarray:
    return group.ids if isinstance(group, MeshLog) else state.columns["id"][:, 0]


def _columns(group: MeshLog | ParticleLog, state: State) -> dict[str, Any]:
    """Return x, v, a and force by component, or what else is logged, each (n,)."""
    found: dict[str, np.ndarray] = {"": state.x}
    if state.v is not None:
        found["v"] = state.v
    if state.a is not None:
        found |= {"a": state.a, "f": group.mass[:, None] * state.a}  # type: ignore[union-attr]
    columns = {f"{name}{axis}": values[:, d] for name, values in found.items() for d, axis in enumerate("xyz")}
    if "T" in state.columns:
        columns["T"] = state.columns["T"][:, 0]
    return columns
