"""From a scene to a document that describes the same scene to the last bit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from ..errors import InputError
from ..physics.emitters import Keyed
from ..physics.law import Sum
from ..physics.mesh import Mesh
from ..physics.mesh_recipe import recipe
from ..physics.samples import Samples
from ..physics.spread import Spread
from ..scene import Scene
from ..schemes import Scheme
from .files import below
from .kinds import CHECKS, DERIVED, TABLED, Maker, Slot, implied, kind
from .read import read_table
from .scheme_tables import scheme_value


def write_scene(scene: Scene, *, summary: str = "") -> dict[str, Any]:
    """Return the document of a scene; what is as by default is left out.

    Raises:
        InputError: it has a law of its own, or another thing that data cannot say; the path and the thing are named.
    """
    document = _table(scene, "$", (Scene,))
    if scene.says_steps and not {"scheme", "steps"} & set(document):
        # the same as by default, but said: see `Scene.of_quality`
        document["steps"] = _value(kind(Scene).slots["steps"], scene.steps, "$.steps")
    return ({"summary": summary} if summary else {}) | document


def _table(value: Any, path: str, makers: tuple[Maker, ...]) -> dict[str, Any]:
    maker = type(value)
    if maker is Mesh and (by_recipe := _recipe_table(value, path)):
        return by_recipe
    if maker not in makers:
        names = ", ".join(maker.__name__ for maker in makers)
        whose = (
            "which is not among" if maker.__module__.startswith("tparticles.") else "the scene's own, and not one of"
        )
        raise InputError(f"{path} is a {maker.__name__}, {whose} what a data scene holds there ({names})")
    try:
        CHECKS.get(maker, lambda _: None)(value)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    this = kind(maker)
    row: dict[str, Any] = {} if implied(makers) is maker else {"kind": this.name}
    for name, slot in this.slots.items():
        item = getattr(value, name)
        derived = DERIVED.get((maker, name))
        default = derived(value) if derived else this.defaults.get(name, ...)
        if not _same(item, default):
            row[name] = _value(slot, item, below(path, name))
    return row


def _recipe_table(mesh: Mesh, path: str) -> dict[str, Any] | None:
    """Return a mesh by its builder and what was done to it; None where that is not known, or would make another mesh."""
    if not (steps := recipe(mesh)):
        return None
    this = kind(Mesh)
    known = {maker.__name__: maker for maker in (*TABLED[Mesh], *(this.then.listed if this.then else ()))}
    try:
        rows = [_arguments(known[name], arguments, path) for name, arguments in steps]
        row = rows[0] | ({"then": rows[1:]} if rows[1:] else {})
        return row if read_table(TABLED[Mesh], row, path) == mesh else None
    except (InputError, LookupError):
        return None


def _arguments(maker: Maker, arguments: Mapping[str, Any], path: str) -> dict[str, Any]:
    """Return the table of a call of `maker`."""
    this = kind(maker)
    row: dict[str, Any] = {"kind": this.name}
    for name, value in arguments.items():
        if isinstance(value, np.ndarray):
            row[name] = _listed(value)
        elif value is not None:
            row[name] = _value(this.slots[name], value, below(path, name))
    return row


def _same(left: Any, right: Any) -> bool:
    # repr, too: -0.0 == 0.0
    if isinstance(left, np.ndarray) and isinstance(right, tuple):
        return left.size == len(right) == 0
    if isinstance(left, np.ndarray):  # one number stands for an array of it
        return isinstance(right, int | float | np.ndarray) and bool(np.all(left == right))
    return type(left) is type(right) and left == right and repr(left) == repr(right)


def _value(slot: Slot, value: Any, path: str) -> Any:
    if isinstance(value, Scheme):
        return scheme_value(value, path)
    if isinstance(value, Sum):
        return [_table(flow, f"{path}[{i}]", slot.listed) for i, flow in enumerate(value.flows)]
    if isinstance(value, tuple) and slot.listed:
        return [_table(item, f"{path}[{i}]", slot.listed) for i, item in enumerate(value)]
    if isinstance(value, Spread):
        return _spread(value)
    if slot.plain == Keyed and [time for time, _ in value] == [0.0]:
        return value[0][1]
    if slot.plain is None or type(value) in slot.single:
        return _table(value, path, slot.single or slot.listed)
    return plain_value(slot, value, path)


def _spread(value: Spread) -> Any:
    if value.distribution != "uniform":
        return {"mean": value.mean, "variance": value.variance, "distribution": value.distribution}
    return [value.mean, value.variance] if value.varies else value.mean


def _array(value: np.ndarray) -> Any:
    """Return an array as lists, or as one number where that stands for many of it; infinity is a text."""
    if value.ndim == 1 and len(value) and len({item.tobytes() for item in value}) == 1:
        value = value[0]
    return _listed(value)


def _listed(value: np.ndarray) -> Any:
    items = value.tolist()
    if value.dtype.kind != "f" or np.isfinite(value).all():
        return items
    return [_number(item) for item in items] if isinstance(items, list) else _number(items)


def _number(value: Any) -> Any:
    return "inf" if value == math.inf else value


def plain_value(slot: Slot, value: Any, path: str) -> Any:
    """Return a value that is no table as TOML and JSON have it.

    Raises:
        InputError: they have no word for it.
    """
    if isinstance(value, Fraction):
        return int(value) if value.denominator == 1 else str(value)
    if isinstance(value, Spread):
        return _spread(value)
    if isinstance(value, Scheme):
        return scheme_value(value, path)
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, Samples):
        return value.values.tolist()
    if isinstance(value, tuple | list):
        return [plain_value(slot, item, f"{path}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, bool | int | str) or (isinstance(value, float) and math.isfinite(value)):
        return value
    raise InputError(f"{path} = {value!r} ({type(value).__name__}): a data scene cannot say it")
