"""A parameter of a scene: its type, its default, and how a value is read from text."""

from __future__ import annotations

import json
import math
import re
import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import PydanticUserError, TypeAdapter, ValidationError

from .errors import InputError

_LONGEST = 60  # characters shown of a value


@dataclass(frozen=True)
class Parameter:
    """A keyword argument of a scene: its type and default."""

    name: str
    type: Any
    default: Any

    @property
    def type_name(self) -> str:
        """The type as one would write it."""
        kind = typing.get_args(self.type)[0] if typing.get_origin(self.type) is typing.Annotated else self.type
        plain = isinstance(kind, type) and not typing.get_args(kind)
        return kind.__name__ if plain else str(kind).replace("typing.", "")

    def read(self, value: Any) -> Any:
        """Return `value`, text as it is typed after `name=` or a value of Python, as a value of this type.

        Text is taken as the type reads it (`.5`, `yes`, `abc`), else as JSON (`[1, 2]`, `null`), else as a list (`1,2`).

        Raises:
            InputError: it has another type, or holds NaN or infinity.
        """
        return self._checked(value, self._from_text if isinstance(value, str) else self._from_value)

    def take(self, value: Any) -> Any:
        """Return a value of a document, where a text is a text and no number, as a value of this type.

        Raises:
            InputError: it has another type, or holds NaN or infinity.
        """
        return self._checked(value, self._from_value)

    def _checked(self, value: Any, way: Callable[[TypeAdapter[Any], Any], Any]) -> Any:
        try:
            adapter = TypeAdapter(self.type)
        except PydanticUserError:
            raise InputError(f"parameter {self.name} is a {self.type_name}, which cannot be set from outside") from None
        try:
            result = way(adapter, value)
        except ValidationError as error:
            reason = error.errors(include_url=False)[0]["msg"].removeprefix("Input ").partition(", unable to")[0]
            raise self._refused(value, reason) from None
        if not _finite(result):
            raise self._refused(value, "must be finite")
        return result

    def _refused(self, value: Any, reason: str) -> InputError:
        shown = str(value) if len(str(value)) <= _LONGEST else str(value)[:_LONGEST] + "..."
        return InputError(f"parameter {self.name} = {shown}: {reason} ({self.type_name})")

    def _from_text(self, adapter: TypeAdapter[Any], text: str) -> Any:
        ways = [
            lambda: adapter.validate_strings(text),
            lambda: adapter.validate_json(text, strict=True),
            lambda: adapter.validate_json(f"[{text}]", strict=True),
        ]
        if self.type in (Any, object):  # any text would do: numbers first
            ways = [lambda: json.loads(text), lambda: text]
        first: Exception | None = None
        for way in ways:
            try:
                return way()
            except (ValidationError, ValueError, RecursionError) as error:
                # what is said of a list as JSON helps more than "should be a list"
                first = error if first is None or (way is ways[1] and text.lstrip().startswith(("[", "{"))) else first
        assert first is not None
        raise first

    def _from_value(self, adapter: TypeAdapter[Any], value: Any) -> Any:
        try:
            text = json.dumps(value)
        except (TypeError, ValueError, RecursionError):
            return adapter.validate_python(value)
        # strict, or True would be taken for 1.0; as JSON, where a list will do for a tuple
        return adapter.validate_json(text, strict=True)


def description(value: Any) -> str:
    """Return `repr` without addresses: equal for equal values in any process."""
    return re.sub(r" at 0x[0-9A-Fa-f]+", "", repr(value))


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it; what it cannot is described."""
    from .output import jsonable

    try:
        return jsonable(value)
    except TypeError:
        return description(value)


def _finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, Mapping):
        return all(map(_finite, value.values()))
    return all(map(_finite, value)) if isinstance(value, list | tuple | set | frozenset) else True
