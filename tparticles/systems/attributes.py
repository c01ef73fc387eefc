"""The attribute table: everything a particle can carry, declared in one place. A scene allocates only what it needs."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import taichi as ti

from .. import backend
from ..errors import InputError


@dataclass(frozen=True)
class Attribute:
    """A named value of every particle: `components` scalars of type `kind`, in `unit`; `why` says who needs it."""

    name: str
    components: int
    kind: str  # "real": the precision of the run; else a fixed type
    unit: str
    why: str

    @property
    def type(self) -> Any:
        """The Taichi type of one scalar."""
        return backend.current().real if self.kind == "real" else getattr(ti, self.kind)

    def bytes(self, precision: str) -> int:
        """Bytes per particle."""
        kind = precision if self.kind == "real" else self.kind
        return self.components * int(kind[1:]) // 8


ATTRIBUTES = {
    a.name: a
    for a in (
        Attribute("x", 3, "real", "m", "position, always"),
        Attribute("id", 1, "i32", "", "identity, always: it keys the random numbers"),
        # f64 in every precision: ages and birth times stay exact however long the film is
        Attribute("birth", 1, "f64", "s", "time of birth, always"),
        Attribute("v", 3, "real", "m/s", "velocity: second-order systems, and streaks"),
        Attribute("T", 1, "real", "K", "temperature, where a cooling law integrates it"),
        Attribute("T0", 1, "real", "K", "temperature at birth, where it varies"),
        Attribute("size", 1, "real", "m", "diameter, where it varies"),
        Attribute("lifetime", 1, "real", "s", "age at death, where it varies"),
    )
}


def bytes_per_particle(names: Iterable[str], precision: str) -> int:
    """Return the bytes that one particle with these attributes takes."""
    return sum(ATTRIBUTES[name].bytes(precision) for name in names)


def bytes_allocated(names: Iterable[str], precision: str, more: Iterable[Attribute] = ()) -> int:
    """Return the most bytes that a slot takes: its attributes, a GPU's scratch for compaction, the mark of the dead."""
    kinds = {precision if ATTRIBUTES[name].kind == "real" else ATTRIBUTES[name].kind for name in names}
    each = bytes_per_particle(names, precision) + sum(attribute.bytes(precision) for attribute in more)
    return each + sum(int(kind[1:]) // 8 for kind in kinds) + 4


def _attributes(names: Iterable[str], more: Iterable[Attribute]) -> list[Attribute]:
    wanted = set(names)
    return [*(attribute for name, attribute in ATTRIBUTES.items() if name in wanted), *more]


def padded(capacity: int) -> int:
    """Return so many slots in whole lane blocks."""
    lanes = backend.current().lanes
    return max(1, -(-capacity // lanes)) * lanes


class Columns:
    """The particles' attributes as a structure of arrays: each scalar component in its own contiguous field.

    Arguments:
        names: which attributes of the table to allocate.
        capacity: the most particles at once; padded to whole lane blocks.
        more: attributes beside the table, of a width that only the stepper knows.

    Raises:
        InputError: more particles than 32-bit indices can address.
    """

    def __init__(self, names: Iterable[str], capacity: int, *, more: Iterable[Attribute] = ()):
        wanted = _attributes(names, more)
        self.names = tuple(attribute.name for attribute in wanted)
        if capacity >= 2**31 - 64:
            raise InputError(
                f"{capacity} particles at once: at most {2**31 - 64} fit one group; split it into several groups"
            )
        self.capacity = capacity
        self.padded = padded(capacity)
        self.first = 0  # the slot that the particles begin with
        self._fields = {
            attribute.name: tuple(ti.field(attribute.type, self.padded) for _ in range(attribute.components))
            for attribute in wanted
        }

    def part(self, names: Iterable[str], first: int, capacity: int, *, more: Iterable[Attribute] = ()) -> Columns:
        """Return some of the columns, from slot `first` on, which begins a lane block, with room for `capacity` particles."""
        part = copy.copy(self)
        part._fields = {a.name: self._fields[a.name][: a.components] for a in _attributes(names, more)}
        part.names = tuple(part._fields)
        part.first, part.capacity, part.padded = first, capacity, padded(capacity)
        return part

    def __contains__(self, name: str) -> bool:
        return name in self._fields

    def __getitem__(self, name: str) -> tuple[Any, ...]:
        """Return the scalar fields of an attribute, one per component."""
        return self._fields[name]

    def all(self) -> tuple[Any, ...]:
        """Return every scalar field, in the order of the table."""
        return tuple(field for name in self.names for field in self._fields[name])
