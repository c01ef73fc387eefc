"""How a mesh was made: by which builder, and what was done to it since. What writes a scene down names these, not their numbers."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numpy as np

_P = ParamSpec("_P")
_R = TypeVar("_R")

Step = tuple[str, dict[str, Any]]  # the name of a function, and what it was given


def recipe(mesh: Any) -> tuple[Step, ...]:
    """Return the builder of a mesh and the changes to it, in turn; nothing where one of them is not known.

    A note, not a promise: an array that was given may have been written to since.
    """
    return vars(mesh).get("_recipe", ())


def builder(build: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let meshes know that this function built them."""
    return _noted(build, lambda arguments: ())


def change(method: Callable[_P, _R]) -> Callable[_P, _R]:
    """Let the meshes that a method returns know what they were made of, and how."""
    return _noted(method, lambda arguments: recipe(arguments.pop("self")) or None)


def _noted(make: Callable[_P, _R], before: Callable[[dict[str, Any]], tuple[Step, ...] | None]) -> Callable[_P, _R]:
    signature = inspect.signature(make)

    @functools.wraps(make)
    def noted(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        made = make(*args, **kwargs)
        arguments = signature.bind(*args, **kwargs).arguments
        mesh = arguments.get("self")
        steps, given = before(arguments), _plain(arguments, mesh)
        if steps is not None and given is not None:
            vars(made)["_recipe"] = (*steps, (make.__name__, given))
        return made

    return noted


def _plain(arguments: dict[str, Any], mesh: Any) -> dict[str, Any] | None:
    """Return arguments as specs and arrays, vertices that a function chose by their indices; None if one is neither."""
    if callable(where := arguments.get("where")):
        chosen = np.flatnonzero(np.asarray(where(mesh.x)))
        arguments = {name: value for name, value in arguments.items() if name != "where"} | {"vertices": chosen}
    found = {}
    for name, value in arguments.items():
        plain = value is None or isinstance(value, str) or dataclasses.is_dataclass(value)
        found[name] = value if plain else np.array(value, ndmin=name == "vertices")  # one, or several
        if not plain and found[name].dtype.kind not in "biuf":
            return None
    return found
