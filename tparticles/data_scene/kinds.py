"""Which tables a data scene is made of, and what each of their keys takes: derived from the specs' own types, `Scene` first.

A new class that a spec's type names (a shape, a controller, a kind of group) is known without a word here. `LAWS` lists the
laws for fields whose type lets in the user's own; `TABLED` the functions that make a value from numbers.
"""

from __future__ import annotations

import collections.abc
import dataclasses
import functools
import inspect
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Union

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, PydanticSchemaGenerationError, TypeAdapter, WithJsonSchema

from .. import schemes
from ..errors import InputError
from ..physics.colliders import Ball, Capsule, Plane, Room
from ..physics.emitters import Keyed
from ..physics.flows import ABC, Plume, Uniform, Vortex
from ..physics.forces import Drag, Gravity
from ..physics.grid_colliders import DistanceGrid, Heightfield
from ..physics.law import Sum
from ..physics.mesh import Mesh
from ..physics.mesh_builders import cloth, lattice, rope, sphere_shell, spring_box
from ..physics.noise import CurlNoise
from ..physics.spread import SpreadLike
from ..render.appearance import Picture
from ..scene import Group
from ..schemes import Scheme

# The laws of fields that take the user's own too, by the name of the field. A list of flows is their sum.
LAWS: dict[str, tuple[type, ...]] = {
    "flow": (ABC, CurlNoise, Plume, Uniform, Vortex),
    "forces": (Drag, Gravity),
    "colliders": (Ball, Capsule, DistanceGrid, Heightfield, Plane, Room),
}
# Values that functions make: a field of such a type takes a table of the arguments of one of them. `NAMES` may stand there, too.
TABLED: dict[type, tuple[Callable[..., Any], ...]] = {
    Scheme: (schemes.adams, schemes.bdf, schemes.modified_euler, schemes.runge_kutta, schemes.splitting),
    Mesh: (cloth, lattice, Mesh, rope, sphere_shell, spring_box),
}
# Methods that return a changed value: a table of such a type takes a list of tables of their arguments, `then`.
CHANGES: dict[type, tuple[Callable[..., Any], ...]] = {
    Mesh: (Mesh.moved, Mesh.turned, Mesh.scaled, Mesh.launched, Mesh.pin, Mesh.driven, Mesh.with_springs, Mesh.joined),
}
# What is meant where several kinds may stand and none is named.
IMPLIED: tuple[type, ...] = (Group,)

Maker = Callable[..., Any]  # a class of specs, or a function
_MOST_COEFFICIENTS = 16
_MOST_VERTICES = 1 << 24


def _coefficient(value: Any) -> Any:
    if isinstance(value, str) and re.fullmatch(r"-?\d{1,15}/0*[1-9]\d{0,14}", value, re.ASCII):
        return Fraction(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("should be a number or a fraction such as '1/6'")
    return value


_Coefficient = Annotated[
    Any,
    BeforeValidator(_coefficient),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": "^-?[0-9]+/[0-9]+$"}]}),
]
_Row = Annotated[tuple[_Coefficient, ...], Field(max_length=_MOST_COEFFICIENTS)]
_ROWS = dict.fromkeys(("b", "c", "b_embedded", "explicit", "implicit", "kicks", "drifts"), _Row)
# The coefficients of schemes: their functions take any sequence of any numbers.
_COEFFICIENTS = {**_ROWS, "a": Annotated[tuple[_Row, ...], Field(max_length=_MOST_COEFFICIENTS)], "alpha": _Coefficient}


def _scheme_of(name: Any) -> Scheme:
    if not isinstance(name, str):
        raise ValueError("should be the name of a scheme, or a table of its coefficients")
    return schemes.get(name)


# What may stand for a value of `TABLED` instead of a table.
NAMES: dict[type, Any] = {
    Scheme: Annotated[Any, BeforeValidator(_scheme_of), WithJsonSchema({"enum": list(schemes.CATALOGUE)})],
}


def _array(value: Any) -> Any:
    value = _with_infinities(value)
    try:
        kind = np.asarray(value).dtype.kind
    except ValueError:
        raise ValueError("the rows of an array should be of one length") from None
    if value is not None and kind not in "biuf":
        raise ValueError("should be numbers, or lists of numbers")
    return value


def _with_infinities(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_with_infinities, value))
    return math.inf if value == "inf" else value


# Arrays, whose shapes are checked by what they are for. Neither JSON nor we have a number for infinity: it is a text.
_Array = Annotated[
    Any,
    BeforeValidator(_array),
    WithJsonSchema(
        {"anyOf": [{"type": "number"}, {"type": "boolean"}, {"const": "inf"}, {"type": "array"}, {"type": "null"}]}
    ),
]
_INDICES = {"vertices": tuple[Annotated[int, Field(ge=0)], ...] | None}
# JSON Schema of types that say less than their validator takes.
_SHORT: tuple[tuple[Any, dict[str, Any]], ...] = (
    (
        SpreadLike,
        {
            "anyOf": [
                {"type": "number"},
                {"type": "array", "prefixItems": [{"type": "number"}] * 2, "minItems": 2, "maxItems": 2},
            ]
        },
    ),
    (Keyed, {"anyOf": [{"type": "number", "minimum": 0}, TypeAdapter(Keyed).json_schema()]}),
    (Fraction, {"anyOf": [{"type": "number"}, {"type": "string"}]}),
)
_BOUNDS = {
    "le": ("maximum", min),
    "lt": ("exclusiveMaximum", min),
    "ge": ("minimum", max),
    "gt": ("exclusiveMinimum", max),
}


@dataclass(frozen=True)
class Slot:
    """What a key takes: a table of one of the kinds in `single`, a list of tables of those in `listed`, or what `plain` takes.

    `join` makes one value of a list. `optional`: None may stand there, which TOML has no word for.
    """

    single: tuple[Maker, ...] = ()
    listed: tuple[Maker, ...] = ()
    join: Callable[[tuple[Any, ...]], Any] = tuple
    plain: Any = None
    optional: bool = False

    @cached_property
    def adapter(self) -> TypeAdapter[Any]:
        """What validates a value that is no table."""
        return TypeAdapter(self.plain)

    @cached_property
    def plain_schema(self) -> dict[str, Any]:
        """JSON Schema of the values that are no tables."""
        found = [_json_schema(one) for one in _alternatives(self.plain)]
        return found[0] if len(found) == 1 else {"anyOf": found}


@dataclass(frozen=True)
class Kind:
    """A kind of table: what makes a value of it, what its keys take, which must be there, the defaults of the others.

    `then`: what takes a list of changes to the value, if it can be changed.
    """

    name: str
    make: Maker
    slots: Mapping[str, Slot]
    required: frozenset[str]
    defaults: Mapping[str, Any]
    text: str
    then: Slot | None


@cache
def kind(maker: Maker) -> Kind:
    """Return the kind of table that a class, or a function, stands for."""
    hints: dict[str, Any]
    if isinstance(maker, type):
        fields = [f for f in dataclasses.fields(maker) if f.init]
        names = [f.name for f in fields]
        defaults = {f.name: f.default for f in fields if f.default is not dataclasses.MISSING}
        # Named here: left to itself, it has lambdas in annotations look names up in the class.
        hints = typing.get_type_hints(maker, vars(sys.modules[maker.__module__]), include_extras=True)
    else:
        parameters = inspect.signature(maker).parameters
        names = [name for name in parameters if name != "self"]
        defaults = {
            name: parameters[name].default for name in names if parameters[name].default is not inspect.Parameter.empty
        }
        hints = typing.get_type_hints(maker, include_extras=True)
        hints |= _COEFFICIENTS if hints.get("return") is Scheme else _INDICES
        hints = {name: _Array if hint in (ArrayLike, ArrayLike | None) else hint for name, hint in hints.items()}
    slots = {name: _slot(name, hints[name], defaults.get(name, ...)) for name in names}
    text = " ".join((inspect.getdoc(maker) or "").split())
    changes = tuple(map(_later, CHANGES.get(hints.get("return", maker), ())))
    then = Slot(listed=changes) if changes else None
    return Kind(maker.__name__, maker, slots, frozenset(names) - frozenset(defaults), defaults, text, then)


@cache
def _later(method: Callable[..., Any]) -> Maker:
    """Return what takes the arguments of a method, and gives what calls it with them."""

    @functools.wraps(method)
    def change(**arguments: Any) -> Callable[[Any], Any]:
        return lambda value: method(value, **arguments)

    return change


def implied(makers: tuple[Maker, ...]) -> Maker | None:
    """Return what is meant by a table that names no kind, where one of `makers` may stand; None if that is not clear."""
    if len(makers) == 1:
        return makers[0]
    return next((maker for maker in makers if maker in IMPLIED), None)


def _slot(name: str, hint: Any, default: Any) -> Slot:
    if name in LAWS:
        return Slot(LAWS[name], LAWS[name], join=_sum if name == "flow" else tuple)
    single: list[Maker] = []
    listed: list[Maker] = []
    plain: list[Any] = []
    alternatives = _alternatives(hint)
    for one in alternatives:
        core = _core(one)
        items = _alternatives(typing.get_args(core)[0]) if typing.get_origin(core) is tuple else ()
        if items and all(map(_tabled, items)):
            listed += items
            single += items if core is not one else ()  # a validator makes a list of a single one
        elif _tabled(core):
            single += TABLED.get(core, (core,))
            if core in NAMES or (core is not one and core not in TABLED):
                plain.append(NAMES.get(core, one))
        elif core is not type(None) and typing.get_origin(core) is not collections.abc.Callable:
            plain.append(one if _has_schema(one) else _Array)
    return Slot(
        tuple(single),
        tuple(listed),
        plain=Union[tuple(plain)] if plain else None,  # noqa: UP007
        optional=type(None) in alternatives or default is None,
    )


def _has_schema(hint: Any) -> bool:
    try:
        TypeAdapter(hint)
    except PydanticSchemaGenerationError:
        return False
    return True


def _tabled(value: Any) -> bool:
    return isinstance(value, type) and dataclasses.is_dataclass(value)


def _alternatives(hint: Any) -> tuple[Any, ...]:
    """Return the members of a union, also of one that an alias names, or that has a validator if tables are among them."""
    core = _core(hint)
    members = typing.get_args(core) if typing.get_origin(core) in (Union, types.UnionType) else ()
    found = tuple(m for member in members for m in _alternatives(member))
    return found if found and (core is hint or any(_tabled(_core(m)) for m in found)) else (hint,)


def _core(hint: Any) -> Any:
    return typing.get_args(hint)[0] if typing.get_origin(hint) is Annotated else hint


def _json_schema(hint: Any) -> dict[str, Any]:
    for short, schema in _SHORT:
        if hint == short or _core(hint) == short:
            return schema
    return _in_words_of_json_schema(TypeAdapter(hint).json_schema())


def _in_words_of_json_schema(schema: Any) -> Any:
    """Return a schema of pydantic's, which leaves bounds that it cannot place as `le` and the like, in JSON Schema's own words."""
    if isinstance(schema, list):
        return [_in_words_of_json_schema(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    result = {key: _in_words_of_json_schema(value) for key, value in schema.items() if key not in _BOUNDS}
    for key, (name, tighter) in _BOUNDS.items():
        if key in schema:
            result[name] = tighter(schema[key], schema.get(name, schema[key]))
    return result


def _sum(flows: tuple[Any, ...]) -> Sum:
    if not flows:
        raise InputError("an empty list is no flow")
    return Sum(*flows)


def check_picture(picture: Picture) -> None:
    """Refuse a picture that is no regular file below the working folder: a document may come from anywhere.

    Raises:
        InputError: it lies elsewhere or is no file.
    """
    here = Path.cwd().resolve()
    try:
        path = (here / picture.path).resolve()
        if not path.is_relative_to(here) or Path(picture.path).is_absolute():
            raise InputError(
                f"path '{picture.path}' leaves the working folder: a data scene takes pictures below it only"
            )
        if not path.is_file():
            raise InputError(f"path '{picture.path}' is no file in {here}")
    except (OSError, ValueError, RuntimeError) as error:  # too long, NUL, links in a circle
        raise InputError(f"path {picture.path!r} cannot be read: {error}") from None


# Defaults that depend on the rest of the value.
DERIVED: dict[tuple[Maker, str], Callable[[Any], Any]] = {(Mesh, "rest"): lambda mesh: mesh.lengths}


def check_vertices(arguments: Mapping[str, Any]) -> None:
    """Refuse a mesh of so many vertices that its builder would take all memory.

    Raises:
        InputError: more than `_MOST_VERTICES`.
    """
    counts = arguments.get("counts", (arguments.get("count", 1),))
    # what is no list of numbers is for the builder to refuse
    total = math.prod(n for n in counts if isinstance(n, int | float)) if isinstance(counts, Sequence) else 0
    if total > _MOST_VERTICES:
        raise InputError(f"{total} vertices, at most {_MOST_VERTICES} are allowed")


# What the arguments of a table are held against before anything is made of them.
LIMITS: dict[Maker, Callable[[Mapping[str, Any]], None]] = dict.fromkeys((cloth, lattice, rope), check_vertices)
# What a table may not say though its spec may.
CHECKS: dict[Maker, Callable[[Any], None]] = {Picture: check_picture}
