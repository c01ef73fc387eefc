"""From a document to a scene. Every error says where: `$.groups[1].emitters[0].births.rate = -1: should be ...`."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..errors import InputError, nearest
from ..scene import Scene
from .files import below, word
from .kinds import CHECKS, LIMITS, Maker, Slot, implied, kind

HEAD = ("$schema", "summary")  # keys of any document that describe no part of the scene
_EXACT = 2.0**53
_LONGEST = 60  # characters shown of a value


def read_scene(document: Mapping[str, Any]) -> Scene:
    """Return the scene that a document describes.

    Raises:
        InputError: in one line, with the path, the value, what is allowed, the nearest right name.
    """
    read_head(document)
    return _made(Scene, {key: value for key, value in document.items() if key not in HEAD}, "$", also=HEAD)


def read_head(document: Mapping[str, Any]) -> str:
    """Return the summary of a document, an empty text if it has none.

    Raises:
        InputError: the summary, or the name of the schema, is no text.
    """
    for key in HEAD:
        if not isinstance(value := document.get(key, ""), str):
            raise InputError(f"$.{key} = {_short(value)}: should be a text, not a {word(value)}")
    return " ".join(document.get("summary", "").split())


def check_keys(table: Mapping[str, Any], known: Iterable[str], path: str, owner: str) -> None:
    """Refuse a key that is not known, and name the nearest one that is."""
    names = list(known)
    for key in table:
        if key not in names:
            raise InputError(
                f"{below(path, key)}: {owner} has no such key{nearest(key, names)} (known: {', '.join(names)})"
            )


def _made(maker: Maker, table: Mapping[str, Any], path: str, *, also: Iterable[str] = ()) -> Any:
    """Return what a table describes."""
    this = kind(maker)
    check_keys(table, (*this.slots, *(("then",) if this.then else ()), *also), path, this.name)
    missing = [name for name in this.slots if name in this.required and name not in table]
    if missing:
        raise InputError(f"{path}.{missing[0]} is missing: {this.name} needs {' and '.join(missing)}")
    values = {name: _read(this.slots[name], table[name], below(path, name)) for name in table if name in this.slots}
    with _blamed(path, this.name):
        LIMITS.get(maker, lambda _: None)(values)
        made = maker(**values)
        CHECKS.get(maker, lambda _: None)(made)
    for i, change in enumerate(_read(this.then, table.get("then", []), f"{path}.then") if this.then else ()):
        with _blamed(f"{path}.then[{i}]", this.name):
            made = change(made)
    return made


@contextlib.contextmanager
def _blamed(path: str, name: str) -> Iterator[None]:
    """Let what a constructor says begin with the path of its table."""
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            yield
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (ArithmeticError, MemoryError):
        raise InputError(f"{path}: {name} cannot be worked out, its numbers are too large or too small") from None


def _read(slot: Slot, value: Any, path: str) -> Any:
    if isinstance(value, dict) and slot.single:
        return read_table(slot.single, value, path)
    if isinstance(value, dict) and slot.listed:
        raise InputError(f"{path} is a table: should be a list of tables")
    if isinstance(value, list) and slot.listed:
        return _listed(slot, value, path)
    if value is None and slot.optional:
        return None
    if slot.plain is not None:
        return _plain(slot, value, path)
    raise InputError(f"{path} = {_short(value)}: should be a table of kind {_any_of(slot.single or slot.listed)}")


def _listed(slot: Slot, values: list[Any], path: str) -> Any:
    for i, value in enumerate(values):
        if not isinstance(value, dict):
            raise InputError(f"{path}[{i}] = {_short(value)}: should be a table of kind {_any_of(slot.listed)}")
    items = tuple(read_table(slot.listed, value, f"{path}[{i}]") for i, value in enumerate(values))
    try:
        return slot.join(items)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_table(makers: tuple[Maker, ...], table: Mapping[str, Any], path: str) -> Any:
    """Return what a table of one of the kinds `makers` describes. Raises InputError, with its path."""
    names = {maker.__name__: maker for maker in makers}
    rest = {key: value for key, value in table.items() if key != "kind"}
    if "kind" not in table:
        maker = implied(makers)
        if maker is None:
            raise InputError(f"{path}.kind is missing: should be {_any_of(makers)}")
        return _made(maker, rest, path, also=("kind",))
    name = table["kind"]
    if not isinstance(name, str) or name not in names:
        hint = nearest(name, names) if isinstance(name, str) else ""
        raise InputError(f"{path}.kind = {_short(name)}: should be {_any_of(makers)}{hint}")
    return _made(names[name], rest, path)


def _plain(slot: Slot, value: Any, path: str) -> Any:
    try:
        return slot.adapter.validate_python(_frozen(value), strict=True)  # or texts would be taken for numbers
    except ValidationError as error:
        deepest = max(error.errors(include_url=False), key=lambda e: len(_indices(e, value)))
        where = path + "".join(f"[{i}]" for i in _indices(deepest, value))
        more = f", or a table of kind {_any_of(slot.single)}" if slot.single and where == path else ""
        raise InputError(f"{where} = {_short(deepest['input'])}: {_reason(deepest)}{more}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _reason(error: Any) -> str:
    text = error["msg"].removeprefix("Value error, ").removeprefix("Input ")
    text = text.replace("tuple", "list").replace("Tuple", "List").replace("string", "text")
    if error["type"] == "literal_error" and isinstance(error["input"], str):
        text += nearest(error["input"], re.findall(r"'([^']*)'", error["ctx"]["expected"]))
    return text


def _indices(error: Any, value: Any) -> list[int]:
    """Return where in a list an error lies; a number may have stood for a list."""
    found = []
    for part in error["loc"]:
        if isinstance(part, int) and isinstance(value, list) and part < len(value):
            found.append(part)
            value = value[part]
    return found


def _frozen(value: Any) -> Any:
    """Return lists as tuples, as specs have them, and whole floats as integers: `count = 1e5` is one. -0.0 stays."""
    if isinstance(value, list):
        return tuple(map(_frozen, value))
    return int(value) if isinstance(value, float) and value.is_integer() and 0 < abs(value) < _EXACT else value


def _any_of(makers: tuple[Maker, ...]) -> str:
    *names, last = dict.fromkeys(maker.__name__ for maker in makers)
    return f"{', '.join(names)} or {last}" if names else last


def _short(value: Any) -> str:
    try:
        text = json.dumps(value, ensure_ascii=False)
    except (TypeError, ValueError):
        text = repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
