"""What a spring mesh must hold; every refusal names the vertex or spring."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import InputError
from ..track import Track

_NAMES = {"f": "numbers", "i": "whole numbers", "b": "true or false"}
_ACCEPTED = {"f": "fiu", "i": "iu", "b": "b"}


def numbers(name: str, value: Any, kind: Any, shape: tuple[int | None, ...]) -> np.ndarray:
    """Return `value` as a read-only array of this kind and shape (None: any length); one number stands for all.

    Raises:
        InputError: it is ragged, of another kind or shape; `name` says which.
    """
    letter = np.dtype(kind).kind
    try:
        array = np.asarray(value)
    except ValueError:  # ragged
        raise InputError(f"{name}: should be an array of {_NAMES[letter]}, its rows differ in length") from None
    if array.shape == (0,) and shape[0] in (None, 0):  # an empty list has no kind and no columns
        array = np.empty([n or 0 for n in shape], kind)
    if array.dtype.kind not in _ACCEPTED[letter]:
        raise InputError(f"{name}: should be {_NAMES[letter]}, not {array.dtype}")
    fits = array.ndim == len(shape) and all(m in (None, n) for n, m in zip(array.shape, shape, strict=True))
    if not fits and (array.ndim or None in shape):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(f"{name}: should have shape ({wanted}), not {array.shape}")
    if letter == "i" and array.size and max(int(array.max()), -int(array.min())) > np.iinfo(kind).max:
        raise InputError(f"{name}: {array.max()} is out of range")
    result = np.array(array if fits else np.broadcast_to(array, [n or 0 for n in shape]), dtype=kind, order="C")
    if letter == "f":
        result += 0.0  # no -0.0: equal meshes have equal bytes
    result.flags.writeable = False
    return result


def vector(name: str, value: Any) -> np.ndarray:
    """Return three finite numbers as an array, shape (3,)."""
    result = numbers(name, value, np.float64, (3,))
    if not np.ndim(value) or not np.isfinite(result).all():
        raise InputError(f"{name} = {value}: should be three finite numbers")
    return result


def number(name: str, value: Any) -> float:
    """Return one finite number."""
    result = float(numbers(name, value, np.float64, ()))
    if not math.isfinite(result):
        raise InputError(f"{name} = {value}: should be finite")
    return result


def positive(name: str, value: Any) -> float:
    """Return one finite number above 0."""
    result = number(name, value)
    if not result > 0:
        raise InputError(f"{name} = {value}: must be above 0")
    return result


def check_indices(kind: str, rows: np.ndarray, count: int) -> None:
    """Refuse rows of vertices, of springs or faces, that do not exist."""
    _refuse(((rows < 0) | (rows >= count)).any(axis=1), kind, f"vertices {{}}, the mesh has 0 to {count - 1}", rows)


def check(mesh: Any) -> None:
    """Refuse what cannot be moved, naming the first thing that is wrong."""
    _check_vertices(mesh)
    _check_pairs(mesh)
    _check_springs(mesh)


def _check_vertices(mesh: Any) -> None:
    for name in ("x", "v"):
        _refuse(
            ~np.isfinite(getattr(mesh, name)).all(axis=1), "vertex", f"{name} = {{}} is not finite", getattr(mesh, name)
        )
    _refuse(~((mesh.mass > 0) & np.isfinite(mesh.mass)), "vertex", "mass = {} kg must be above 0 and finite", mesh.mass)
    moving = mesh.pinned & (mesh.v != 0).any(axis=1)
    _refuse(moving, "vertex", "it is pinned and cannot have a velocity, v = {} m/s", mesh.v)
    for path in mesh.paths:
        if not isinstance(path, Track) or not path.is_vector:
            raise InputError(f"mesh.paths: {path!r} is no Track of vectors")
    unknown = (mesh.driver < -1) | (mesh.driver >= len(mesh.paths))
    _refuse(unknown, "vertex", f"driver = {{}}: there are {len(mesh.paths)} paths, or -1 for none", mesh.driver)
    _refuse((mesh.driver >= 0) & ~mesh.pinned, "vertex", "driver = {}, but it is not pinned", mesh.driver)


def _check_pairs(mesh: Any) -> None:
    a, b = mesh.springs[:, 0].astype(np.int64), mesh.springs[:, 1]
    _refuse(a == b, "spring", "it joins vertex {} to itself", a)
    key = np.minimum(a, b) * len(mesh.x) + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    again = np.flatnonzero(np.diff(key[order]) == 0)
    if len(again):
        first, second = order[again[0]], order[again[0] + 1]
        raise InputError(
            f"springs {first} and {second} both join vertices {a[first]} and {b[first]}: give each pair once"
        )


def _check_springs(mesh: Any) -> None:
    for name, unit in (("stiffness", "N/m"), ("damping", "N s/m")):
        values = getattr(mesh, name)
        _refuse(
            ~((values >= 0) & np.isfinite(values)),
            "spring",
            f"{name} = {{}} {unit} must be at least 0 and finite",
            values,
        )
    _refuse(mesh.lengths == 0, "spring", "it joins vertices {} at the same place, so it has no direction", mesh.springs)
    _refuse(~((mesh.rest > 0) & np.isfinite(mesh.rest)), "spring", "rest = {} m must be above 0 and finite", mesh.rest)
    _refuse(~(mesh.tear > 0), "spring", "tear = {} must be above 0, a strain, or infinite", mesh.tear)


def _refuse(wrong: Any, kind: str, text: str, values: np.ndarray) -> None:
    """Raise for the first row that is wrong, with its value in place of {}."""
    if wrong.any():
        i = int(np.argmax(wrong))
        more = int(wrong.sum()) - 1
        shown = ", ".join(f"{v:g}" for v in np.atleast_1d(values[i]))
        value = f"({shown})" if np.ndim(values[i]) else shown
        raise InputError(f"mesh, {kind} {i}: {text.format(value)}" + (f" (and {more} more)" if more else ""))
