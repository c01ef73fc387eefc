"""A document from a file: TOML or JSON of a bounded size and depth, without duplicate keys, NaN, infinities or dates.

Standard library only: `tparticles list` reads many documents and must be quick.
"""

from __future__ import annotations

import json
import math
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any, NoReturn

from ..errors import InputError

SUFFIXES = (".toml", ".json")
LARGEST_FILE = 8 << 20  # bytes
_DEEPEST = 24
_LARGEST_INTEGER = 2**63
_LONGEST = 60  # characters shown of a key
_LONGEST_REASON = 200
# What tomllib needs for such a key grows faster than with the square of its length.
_LONG_KEY = re.compile(r"""(?<![\w."'-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){32}""")


def read_text(path: Path) -> str:
    """Return the text of a document.

    Raises:
        InputError: it cannot be read, is no regular file, too large or not UTF-8.
    """
    try:
        # a pipe that nobody writes into would keep us waiting
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        with open(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise InputError(f"scene file {path} is no regular file")
            data = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise InputError(f"scene file {path} cannot be read: {error.strerror}") from None
    if len(data) > LARGEST_FILE:
        raise InputError(f"{path} is larger than {LARGEST_FILE >> 20} MiB, which is too large for a scene")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: a byte that is no UTF-8 ({data[error.start]:#x}): save it as UTF-8") from None


def parse(text: str, suffix: str) -> dict[str, Any]:
    """Return the document that a text in the language of `suffix` holds.

    Raises:
        InputError: a syntax error, a key given twice, more than can stand in a scene; line or path say where.
    """
    document = _toml(text) if suffix == ".toml" else _json(text)
    if not isinstance(document, dict):
        raise InputError(f"$ is a {word(document)}: a scene is a table of keys and values")
    check(document)
    return document


def _toml(text: str) -> Any:
    if _LONG_KEY.search(text):
        raise InputError("a key of more than 32 dotted parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"no valid TOML: {_short(error)}") from None
    except RecursionError:
        raise InputError(f"nested more than {_DEEPEST} deep") from None
    except ValueError as error:  # an integer of thousands of digits, an impossible date
        raise InputError(f"no valid TOML: {_short(error)}") from None


def _json(text: str) -> Any:
    def refuse(name: str) -> NoReturn:
        raise InputError(f"{name} is no JSON: numbers must be finite")

    try:
        return json.loads(text, object_pairs_hook=_once, parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise InputError(f"no valid JSON: {_short(error)}") from None
    except RecursionError:
        raise InputError(f"nested more than {_DEEPEST} deep") from None
    except ValueError as error:  # an integer of thousands of digits
        raise InputError(f"no valid JSON: {_short(error)}") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"key '{twice[:_LONGEST]}' is given twice in one object")
    return table


def _short(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST_REASON else text[:_LONGEST_REASON] + "..."


def check(value: Any, path: str = "$", depth: int = 0) -> None:
    """Refuse what no scene holds, wherever it stands.

    Raises:
        InputError: NaN, an infinity, an integer of more than 64 bits, a date, too deep a nest; the path is named.
    """
    if depth > _DEEPEST:
        raise InputError(f"nested more than {_DEEPEST} deep")
    if isinstance(value, dict):
        for key, item in value.items():
            if not _is_text(key):
                raise InputError(f"{path}: a key with half a character (a lone surrogate)")
            check(item, below(path, key), depth + 1)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            check(item, f"{path}[{i}]", depth + 1)
    elif isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{path} = {value}: must be finite")
    elif isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
        raise InputError(f"{path}: an integer of more than 64 bits")
    elif isinstance(value, str) and not _is_text(value):
        raise InputError(f"{path}: half a character (a lone surrogate)")
    elif not (value is None or isinstance(value, bool | int | float | str)):
        raise InputError(f"{path} is a {word(value)}: a scene has no use for it")


def _is_text(value: str) -> bool:
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True


def below(path: str, key: str) -> str:
    """Return the path of a key in the table at `path`, as errors print it: `$.groups[0].name`, `$."odd key"`."""
    shown = key if len(key) <= _LONGEST else key[:_LONGEST] + "..."
    return f"{path}.{shown}" if re.fullmatch(r"[\w$-]+(\.\.\.)?", shown) else f"{path}.{json.dumps(shown)}"


def word(value: Any) -> str:
    """Return what TOML and JSON call such a value."""
    for kind, name in ((bool, "boolean"), (dict, "table"), (list, "list"), (str, "text"), (int | float, "number")):
        if isinstance(value, kind):
            return name
    return "null" if value is None else type(value).__name__
