"""The process that writes a log. It ends when the simulation ends, in whatever way, with all that it was given on the disk.

The file is written for readers that open it meanwhile (HDF5's SWMR): at any moment, what was flushed last can be read.
"""

from __future__ import annotations

import contextlib
import json
import math
import mmap
import os
import pickle
import re
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..output.files import temporary_path
from . import layout

_CACHE = 64 << 20  # bytes of chunks that are not full yet
_AHEAD = 16 << 20  # bytes that may wait for the disk before it is set to work
_WORTH = 0.5  # of the size: to compress takes several times as long as to write, and must pay


def main() -> None:
    """Write what comes on stdin, pickled, until it says "end" or is closed; tell on stdout what is free again, or what failed.

    Arguments: the descriptor of the file whose memory is shared, and the size of the blocks in it. Behind them it holds what a log
    is of: the path, the header, the meshes (a dict of attributes, of arrays that stay, and where the memory of its blocks begins),
    the groups of particles (a dict of attributes, and of columns), and how much of the file at that path the log begins with (see
    `marked`), None to begin anew.
    """
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        with contextlib.suppress(AttributeError):
            signal.signal(getattr(signal, name), signal.SIG_IGN)  # the simulation ends first, and says so
    source, replies = sys.stdin.buffer, sys.stdout.buffer

    def reply(*message: Any) -> None:
        with contextlib.suppress(OSError):
            pickle.dump(message, replies)
            replies.flush()

    try:
        descriptor, size = map(int, sys.argv[1:])
        with open(descriptor, "r+b") as file:
            memory = mmap.mmap(descriptor, size)
            file.seek(size)
            path, header, meshes, particles, earlier = pickle.load(file)
            file.truncate(size)
        writer = _Writer(path, header, meshes, particles, memory, earlier)
        writer.serve(source, reply)
    except (OSError, RuntimeError) as error:  # h5py raises either, with HDF5's words in it
        told = re.search(r"error message = '([^']+)'", str(error))
        reply("failed", told[1] if told else getattr(error, "strerror", None) or str(error))
        os._exit(1)  # what HDF5 still holds cannot be written either, and it would say so at length


class _Writer:
    def __init__(
        self,
        path: Path,
        header: Mapping[str, Any],
        meshes: Sequence[Any],
        particles: Sequence[Any],
        memory: mmap.mmap,
        earlier: Mapping[str, int] | None,
    ):
        h5py, self._plugin = layout.hdf5()
        new = path if earlier is None else temporary_path(path)
        self._file = h5py.File(new, "w", libver="latest", rdcc_nbytes=_CACHE)
        self._rows: dict[str, Any] = {}  # the arrays that grow, by their place in the file
        self._file.attrs.update(format=layout.FORMAT, version=layout.VERSION, header=json.dumps(header))
        self._complete = self._file.create_dataset("complete", data=0)
        self._meshes = [self._mesh(mesh) for mesh in meshes]
        self._blocks = [
            [layout.block(memory, place, mesh["vertices"], mesh["kind"]) for place in mesh["places"]] for mesh in meshes
        ]
        self._particles = [self._group(group) for group in particles]
        if earlier is not None:
            try:
                # as a reader: its writer may be at its last rows, or have been killed, and then nobody could write into it
                with h5py.File(path, "r", libver="latest", swmr=True) as old:
                    self._begin_with(old, earlier)
                self._file.flush()
                os.replace(new, path)
            except BaseException:
                new.unlink(missing_ok=True)
                raise
        self._file.swmr_mode = True
        self._kept = 0  # the size up to which the file was left to the disk

    def _begin_with(self, old: Any, counts: Mapping[str, int]) -> None:
        """Copy the first rows of an earlier log."""
        for name, array in self._rows.items():
            count, many = counts[name], max(1, _CACHE // max(1, array.dtype.itemsize * math.prod(array.shape[1:])))
            if len(old[name]) < count:
                raise OSError(f"it ends before the checkpoint, after {len(old[name])} of {count} rows of {name}")
            array.resize(count, axis=0)
            for first in range(0, count, many):
                array[first : min(first + many, count)] = old[name][first : min(first + many, count)]
        for group in self._meshes:
            group["contacts_lost"][()] = counts[group["contacts_lost"].name]

    def marked(self) -> dict[str, int]:
        """Return how many rows there are in each array, all with the system now, and how many contacts each mesh has lost."""
        self._file.flush()
        lost = (group["contacts_lost"] for group in self._meshes)
        return {name: len(array) for name, array in self._rows.items()} | {one.name: int(one[()]) for one in lost}

    def serve(self, source: BinaryIO, reply: Callable[..., None]) -> None:
        """Write until there is no more."""
        try:
            while True:
                kind, *content = pickle.load(source)
                if kind == "end":
                    self._complete[()] = content[0]
                    break
                if kind == "mark":
                    reply("marked", self.marked())
                    continue
                getattr(self, f"_write_{kind}")(*content)
                self._leave_to_disk()
                if kind == "rows":
                    reply("free", *content[:2])
        except (EOFError, pickle.UnpicklingError):
            pass  # it was killed
        self._file.close()

    def _leave_to_disk(self) -> None:
        """Have what was written brought to the disk, and the memory back of what has got there.

        Nobody reads a log soon, and new memory for each of its pages may cost more than all else (a virtual machine first asks its
        host for it).
        """
        size = self._file.id.get_filesize()
        if size - self._kept > _AHEAD and hasattr(os, "posix_fadvise"):
            os.posix_fadvise(self._file.id.get_vfd_handle(), 0, 0, os.POSIX_FADV_DONTNEED)
            self._kept = size

    def _growing(self, group: Any, name: str, shape: tuple[int, ...], kind: str) -> Any:
        """Make an array of rows of this shape."""
        width = int(np.prod(shape, dtype=np.int64))
        blosc = self._plugin.Blosc(cname="lz4", clevel=1, shuffle=self._plugin.Blosc.BITSHUFFLE)
        chunk = (layout.rows_per_chunk(width, kind), *shape)
        array = group.create_dataset(
            name, shape=(0, *shape), maxshape=(None, *shape), chunks=chunk, dtype=kind, **blosc
        )
        self._rows[array.name] = array
        return array

    def _mesh(self, mesh: Mapping[str, Any]) -> dict[str, Any]:
        """Make the group of a mesh; return what grows, and its count of lost contacts."""
        group = self._file.create_group(f"meshes/{mesh['name']}")
        group.attrs.update(mesh["attributes"])
        for name, values in mesh["arrays"].items():
            group.create_dataset(name, data=values)
        state = (3, len(mesh["arrays"]["id"])), mesh["kind"]
        grows = dict.fromkeys(layout.STATE, state) | {"step": ((), "i8"), "time": ((), "f8"), "dt": ((), "f8")}
        grows |= {
            "energy": ((len(layout.ENERGIES),), "f8"),
            "contacts": ((len(layout.EVENT),), "f8"),
            "torn": ((2,), "f8"),
        }
        arrays = {name: self._growing(group, name, shape, kind) for name, (shape, kind) in grows.items()}
        return arrays | {"contacts_lost": group.create_dataset("contacts_lost", data=0)}

    def _group(self, particles: Mapping[str, Any]) -> dict[str, Any]:
        """Make the group of a group of particles; return what grows."""
        group = self._file.create_group(f"particles/{particles['name']}")
        group.attrs.update(particles["attributes"])
        grows = {"frame": ((), "i8"), "time": ((), "f8"), "first": ((), "i8"), "count": ((), "i8")}
        grows |= {f"columns/{name}": ((components,), kind) for name, (components, kind) in particles["columns"].items()}
        return {name: self._growing(group, name, shape, kind) for name, (shape, kind) in grows.items()}

    def _append(self, array: Any, values: Any) -> None:
        count, more = len(array), len(values)
        if more:
            array.resize(count + more, axis=0)
            array[count:] = values
            array.flush()

    def _append_state(self, array: Any, values: np.ndarray) -> None:
        """Do as `_append` for many rows; their first whole chunk tells whether the others are worth compressing."""
        rows, count = array.chunks[0], len(array)
        at = -(-count // rows) * rows  # where the first whole chunk begins
        tried, left = np.split(values, [at + rows - count])
        self._append(array, tried)
        whole = len(left) - len(left) % rows
        if whole and array.id.get_chunk_info_by_coord((at, 0, 0)).size > _WORTH * tried[0].nbytes * rows:
            array.resize(at + rows + whole, axis=0)
            for n in range(0, whole, rows):
                array.id.write_direct_chunk((at + rows + n, 0, 0), left[n : n + rows], filter_mask=1)
            left = left[whole:]
        self._append(array, left)

    def _write_rows(self, mesh: int, block: int, filled: int) -> None:
        group, rows = self._meshes[mesh], self._blocks[mesh][block]
        met = int(rows.events[0, 0])
        events = rows.events[1 : 1 + met]
        self._append(group["contacts"], events[np.lexsort((events[:, 2], events[:, 1]))])
        if met > len(events):
            group["contacts_lost"][()] += met - len(events)
        for place, name in enumerate(layout.STATE):
            self._append_state(group[name], rows.state[place, :filled])
        for name in ("energy", "dt", "time", "step"):  # `step` last: a reader counts rows by it
            self._append(group[name], getattr(rows, name)[:filled])

    def _write_rewind(self, mesh: int, rows: int, time: float) -> None:
        group = self._meshes[mesh]
        for name in ("step", "time", "dt", "energy", *layout.STATE):
            array = group[name]
            if len(array):
                # HDF5 remembers of the chunk that it looked up last that it was not there, though it was then written as it is,
                # and fails to cut it. So it has to look another one up.
                array.id.read_direct_chunk((0,) * array.ndim)
            array.resize(rows, axis=0)
        contacts = group["contacts"]
        contacts.resize(int(np.searchsorted(contacts[:, 1], time)), axis=0)

    def _write_torn(self, mesh: int, time: float, springs: np.ndarray) -> None:
        self._append(self._meshes[mesh]["torn"], np.column_stack([np.full(len(springs), time), springs]))

    def _write_particles(self, index: int, frame: int, time: float, columns: Mapping[str, np.ndarray]) -> None:
        group = self._particles[index]
        first, count = len(group["columns/id"]), len(columns["id"])
        for name, values in columns.items():
            self._append(group[f"columns/{name}"], values)
        for name, value in (("first", first), ("count", count), ("time", time), ("frame", frame)):
            self._append(group[name], [value])


if __name__ == "__main__":
    main()
