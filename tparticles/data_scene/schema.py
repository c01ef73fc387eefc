"""JSON Schema of the documents, from the same kinds that read them: for editors, and for programs that write scenes."""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from ..scene import Scene
from .kinds import Kind, Maker, Slot, implied, kind
from .read import HEAD
from .write import plain_value

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a data scene.

    What it refuses, the program refuses; a document may still be refused for what no schema says, such as a lifetime that
    can be negative.
    """
    definitions: dict[str, Any] = {}
    todo: list[Maker] = [Scene]
    while todo:
        maker = todo.pop()
        if maker.__name__ not in definitions:
            definitions[maker.__name__] = _definition(kind(maker))
            todo += [m for slot in _slots(kind(maker)).values() for m in (*slot.single, *slot.listed)]
    head = {key: {"type": "string"} for key in HEAD}
    film = definitions.pop("Scene")
    del film["properties"]["kind"]
    film["properties"] = head | film["properties"]
    extended = {
        "title": "Extension",
        "description": "A script of the scenes folder with other values of its parameters.",
        "type": "object",
        "properties": head | {"extends": {"type": "string"}, "parameters": {"type": "object"}},
        "required": ["extends"],
        "additionalProperties": False,
    }
    return {
        "$schema": _DIALECT,
        "title": "tparticles scene",
        "oneOf": [film, extended],
        "$defs": dict(sorted(definitions.items())),
    }


def _slots(this: Kind) -> dict[str, Slot]:
    return {**this.slots, **({"then": this.then} if this.then else {})}


def _definition(this: Kind) -> dict[str, Any]:
    properties = {name: _value(slot) | _default(this, name) for name, slot in _slots(this).items()}
    return {
        "title": this.name,
        "description": this.text,
        "type": "object",
        "properties": {"kind": {"const": this.name}} | properties,
        "required": [name for name in this.slots if name in this.required],
        "additionalProperties": False,
    }


def _default(this: Kind, name: str) -> dict[str, Any]:
    try:
        value = plain_value(this.slots[name], this.defaults[name], "") if name in this.defaults else None
    except InputError:
        return {}
    return {} if value is None else {"default": value}


def _value(slot: Slot) -> dict[str, Any]:
    choices: list[dict[str, Any]] = []
    if slot.single:
        choices.append(_tables(slot.single))
    if slot.listed:
        choices.append({"type": "array", "items": _tables(slot.listed)})
    if slot.plain is not None:
        choices.append(slot.plain_schema)
    if slot.optional:
        choices.append({"type": "null"})
    return dict(choices[0]) if len(choices) == 1 else {"anyOf": choices}


def _tables(makers: tuple[Maker, ...]) -> dict[str, Any]:
    meant = implied(makers)
    choices = [
        {"$ref": f"#/$defs/{maker.__name__}"} | ({} if maker is meant else {"required": ["kind"]}) for maker in makers
    ]
    return choices[0] if len(choices) == 1 else {"oneOf": choices}
