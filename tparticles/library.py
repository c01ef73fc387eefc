"""Scene scripts: find them by name or path, read their parameters, run their `scene` function.

A script is a Python file with `def scene(quality, *, name=default, ...) -> Scene`. Whatever it raises is shown with the script's
own line.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import math
import sys
import traceback
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from .errors import InputError, TparticlesError, nearest, unknown

SCENES = Path("scenes")


@dataclass(frozen=True)
class Parameter:
    """A keyword argument of a scene: its type and default."""

    name: str
    type: Any
    default: Any

    @property
    def type_name(self) -> str:
        """The type as one would write it."""
        return getattr(self.type, "__name__", str(self.type))


@dataclass(frozen=True)
class Script:
    """A loaded scene script."""

    name: str
    path: Path
    summary: str
    function: Callable[..., Any]
    parameters: dict[str, Parameter]

    def settings(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return `wanted` (text or values, by name) as values of the right types.

        Raises:
            InputError: an unknown name (the nearest is suggested), an ill-typed value, NaN or infinity.
        """
        result = {}
        for name, value in wanted.items():
            if name not in self.parameters:
                known = sorted(self.parameters)
                raise InputError(
                    f"scene '{self.name}' has no parameter '{name}'{nearest(name, known)} (known: {', '.join(known) or 'none'})"
                )
            result[name] = self._value(self.parameters[name], value)
        return result

    def _value(self, parameter: Parameter, value: Any) -> Any:
        where = f"parameter {parameter.name} = {value}"
        if isinstance(value, str) and parameter.type is not str:
            try:
                value = json.loads(value)  # numbers, true, lists
            except (ValueError, RecursionError):
                pass  # pydantic says what is wrong with it
        try:
            result = TypeAdapter(parameter.type).validate_python(value)
        except ValidationError as error:
            reason = error.errors()[0]["msg"].removeprefix("Input ")
            raise InputError(f"scene '{self.name}': {where}: {reason} ({parameter.type_name})") from None
        if isinstance(result, float) and not math.isfinite(result):
            raise InputError(f"scene '{self.name}': {where}: must be a finite number")
        return result

    def build(self, *, quality: str, settings: Mapping[str, Any]) -> Any:
        """Return the `Scene` that the script describes.

        Raises:
            InputError: the script raised something (its own line is shown) or returned something else.
        """
        from .scene import Scene

        try:
            scene = self.function(quality, **self.settings(settings))
        except TparticlesError as error:
            if line := _own_line(self.path, error):
                raise type(error)(f"{line}: {error}") from None
            raise
        except (Exception, SystemExit) as error:
            raise InputError(f"{_own_line(self.path, error) or self.path}: {type(error).__name__}: {error}") from None
        if not isinstance(scene, Scene):
            raise InputError(f"{self.path}: scene() must return a tparticles.Scene, not {type(scene).__name__}")
        return scene


def _own_line(path: Path, error: BaseException) -> str:
    """Return `file:line: source` of the innermost frame inside the script, or an empty string."""
    own = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    return f"{path}:{own[-1].lineno}: `{own[-1].line}`" if own else ""


def find(scene: str) -> Path:
    """Return the path of a scene: a file, or a name in ./scenes.

    Raises:
        InputError: there is none; the nearest name is suggested.
    """
    path = Path(scene)
    if path.suffix == ".py" or len(path.parts) != 1:
        if not path.is_file():
            raise InputError(f"scene file '{scene}' does not exist")
        return path.resolve()
    named = SCENES / f"{scene}.py"
    if not named.is_file():
        raise unknown("scene", scene, names())
    return named.resolve()


def names() -> list[str]:
    """Return the names of the scenes in ./scenes."""
    return sorted(p.stem for p in SCENES.glob("*.py") if not p.stem.startswith("_"))


def load(scene: str) -> Script:
    """Load the script of a scene given by name or path, without running its `scene` function.

    Raises:
        InputError: not found, a syntax error or an exception at import (its line is shown), no `scene`, an odd signature.
    """
    path = find(scene)
    spec = importlib.util.spec_from_file_location(f"tparticles_scene_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # Taichi and pydantic look the source up by module
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise InputError(f"{error.filename}:{error.lineno}: {error.msg}: `{(error.text or '').strip()}`") from None
    except TparticlesError as error:
        raise InputError(f"{_own_line(path, error) or path}: {error}") from None
    except (Exception, SystemExit) as error:
        raise InputError(f"{_own_line(path, error) or path}: {type(error).__name__}: {error}") from None
    function = getattr(module, "scene", None)
    if not callable(function):
        raise InputError(f"{path}: a scene script defines `def scene(quality, *, name=default, ...) -> Scene`")
    summary = (module.__doc__ or "").strip().partition("\n")[0]
    return Script(path.stem, path, summary, function, _parameters(path, function))


def _parameters(path: Path, function: Callable[..., Any]) -> dict[str, Parameter]:
    found = inspect.signature(function).parameters
    try:
        hints = typing.get_type_hints(function)
    except Exception as error:
        raise InputError(f"{path}: the annotations of scene() cannot be read: {error}") from None
    result = {}
    for i, p in enumerate(found.values()):
        if i == 0 and p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD):
            continue  # quality
        if p.kind != p.KEYWORD_ONLY or p.default is p.empty:
            raise InputError(f"{path}: parameter '{p.name}' of scene() must be keyword-only and have a default")
        result[p.name] = Parameter(p.name, hints.get(p.name, type(p.default)), p.default)
    if not found:
        raise InputError(f"{path}: scene() must take `quality` as its first argument")
    return result
