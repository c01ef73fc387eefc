"""The text of a document in TOML, laid out to be read and edited: short tables in one line, long ones as sections.

The standard library reads TOML and writes none; the packages that do put each number of a vector on a line of its own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_WIDTH = 110  # characters of a line ...
_WIDTH_OF_ITEM = 150  # ... and of one that holds a whole table, without further tables in it
_SHORT = 40  # of an item that shares its line with others


def dumps(document: Mapping[str, Any]) -> str:
    """Return `document`, tables of texts, numbers, booleans, lists and tables, as TOML; floats to the last bit."""
    return "\n".join(_section(document, "")).strip("\n") + "\n"


def _section(table: Mapping[str, Any], path: str) -> list[str]:
    """Return the lines of a table: first the keys that fit in lines, as TOML would take them for the last section's."""
    lines: list[str] = []
    single: list[str] = []
    several: list[str] = []
    for key, value in table.items():
        place = f"{path}.{_key(key)}" if path else _key(key)
        if own := _lines(_key(key), value, tables=path != ""):
            lines += own
        elif isinstance(value, dict):
            single += ["", f"[{place}]", *_section(value, place)]
        else:
            for item in value:
                several += ["", f"[[{place}]]", *_section(item, place)]
    return lines + single + several


def _lines(key: str, value: Any, *, tables: bool) -> list[str]:
    """Return `key = value`, a list with an item a line where one line is too short; nothing for what needs a section."""
    items = value if isinstance(value, list) else [value]
    tabled = bool(items) and all(isinstance(item, dict) for item in items)
    line = f"{key} = {_inline(value)}"
    if tabled and not tables:
        return []
    if len(line) <= _WIDTH or not isinstance(value, list | dict):
        return [line]
    below = [f"    {_inline(item)}," for item in items]
    if not tabled:
        return [f"{key} = [", *(below if max(map(len, below)) > _SHORT else _filled(below)), "]"]
    flat = all(_flat(part) for item in items for part in item.values())
    if isinstance(value, list) and flat and max(map(len, below)) <= _WIDTH_OF_ITEM:
        return [f"{key} = [", *below, "]"]
    return []


def _filled(items: list[str]) -> list[str]:
    """Return short items, several to a line."""
    lines = [""]
    for item in items:
        if len(lines[-1]) + len(item) > _WIDTH:
            lines.append("")
        lines[-1] += item[3:] if lines[-1] else item
    return lines


def _flat(value: Any) -> bool:
    return not isinstance(value, dict) and (not isinstance(value, list) or all(map(_flat, value)))


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        # JSON's escapes are TOML's, but for DEL
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, dict):
        inside = ", ".join(f"{_key(key)} = {_inline(item)}" for key, item in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    return f"[{', '.join(map(_inline, value))}]"


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _inline(key)
