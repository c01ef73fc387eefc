"""What a job renders of a data scene: the counterpart of `library.Script`, with the same questions answered."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..parameter import Parameter
from .files import below, check, parse, read_text, word
from .read import HEAD, check_keys, read_head, read_scene

if TYPE_CHECKING:
    from ..library import Script

_EXTENSION = ("extends", "parameters")
_LONGEST_TEXT = 10_000  # characters of a setting
_MOST_PARTS = 24  # of the path of a setting


@dataclass(frozen=True)
class DataScene:
    """A loaded document. `source` is the text that was read, with that of the script that it extends.

    One that extends a script has the script's parameters, with its own values as defaults. Any other has no parameters; a
    setting of it is a path in the document, `groups[0].emitters[0].births.rate=200`.
    """

    name: str
    path: Path
    source: str
    summary: str
    document: Mapping[str, Any]
    parameters: dict[str, Parameter]
    script: Script | None = None

    def settings(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return `wanted` (text or values, by name or by path) as values.

        Raises:
            InputError: an unknown name, an ill-typed value, a path that cannot be.
        """
        if self.script is not None:
            return self.script.settings(wanted)
        with self._named():
            values = {path: _value(path, value) for path, value in wanted.items()}
            _changed(self.document, values)
        return values

    def values(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of all parameters, `wanted` and others; where there are none, what is set."""
        return {name: p.default for name, p in self.parameters.items()} | self.settings(wanted)

    def build(self, *, quality: str, settings: Mapping[str, Any]) -> Any:
        """Return the `Scene` that the document describes; a plain one describes the same in each quality.

        Raises:
            InputError: what is wrong with it, and where.
        """
        if self.script is not None:
            return self.script.build(quality=quality, settings=self.values(settings))
        with self._named():
            return read_scene(_changed(self.document, self.settings(settings)))

    def blamed(self) -> contextlib.AbstractContextManager[None]:
        """Show what a law of the extended script raises with the script's own line; other laws are ours."""
        return contextlib.nullcontext() if self.script is None else self.script.blamed()

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        with named(self.path):
            yield


@contextlib.contextmanager
def named(path: Path) -> Iterator[None]:
    """Let errors begin with the file that they are of."""
    try:
        yield
    except InputError as error:
        text = str(error)
        raise error if text.startswith((f"{path}:", "scene ")) else InputError(f"{path}: {text}") from None


def load(path: Path, script: Callable[[str], Script]) -> DataScene:
    """Load a document; `script` finds and loads the one that it extends, by name.

    Raises:
        InputError: it cannot be read or parsed, or is no scene on the face of it; the rest is found by `build`.
    """
    text = read_text(path)
    with named(path):
        document = parse(text, path.suffix)
        summary = read_head(document)
        if "extends" not in document:
            if "parameters" in document:
                raise InputError(
                    "$.parameters: only a scene that extends a script has parameters; $.extends is missing"
                )
            return DataScene(path.stem, path, text, summary, document, {})
        check_keys(document, (*HEAD, *_EXTENSION), "$", "a scene that extends a script")
        base = _extended(document["extends"], script)
        own = _own_values(document.get("parameters", {}), base)
    parameters = {
        name: dataclasses.replace(p, default=own[name]) if name in own else p for name, p in base.parameters.items()
    }
    source = f"{text}\n{base.source}"
    return DataScene(path.stem, path, source, summary or base.summary, document, parameters, base)


def _extended(name: Any, script: Callable[[str], Script]) -> Script:
    if not isinstance(name, str) or not re.fullmatch(r"\w[\w-]{0,99}", name):
        raise InputError(
            f'$.extends = {json.dumps(name)[:60]}: should be the name of a script in the scenes folder, such as "campfire"'
        )
    try:
        return script(name)
    except InputError as error:
        raise InputError(f"$.extends: {error}") from None


def _own_values(table: Any, base: Script) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise InputError(f"$.parameters is a {word(table)}: should be a table of the script's parameters")
    check_keys(table, base.parameters, "$.parameters", f"scene '{base.name}'")
    values = {}
    for name, value in table.items():
        try:
            values[name] = base.parameters[name].take(value)
        except InputError as error:
            raise InputError(f"{below('$.parameters', name)}: {error}") from None
    return values


def _value(path: str, value: Any) -> Any:
    """Return a setting as a value: text is read as JSON, a list without its brackets, a number, or as it is."""
    if not isinstance(value, str):
        return value
    if len(value) > _LONGEST_TEXT:
        raise InputError(f"--set {path}: a value of more than {_LONGEST_TEXT} characters")
    text = value.strip()
    for way in (lambda: parse(f'{{"value": {text}}}', ".json"), lambda: parse(f'{{"value": [{text}]}}', ".json")):
        with contextlib.suppress(InputError):
            found = way()
            if list(found) == ["value"] and found["value"] != []:
                return found["value"]
    with contextlib.suppress(ValueError):
        if "_" not in text and math.isfinite(number := float(text)):  # .5, 1e3
            return number
    return value


def _changed(document: Mapping[str, Any], settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a document with other values at some paths; tables on the way are made."""
    result = copy.deepcopy(dict(document))
    for path, value in settings.items():
        *way, last = _parts(path)
        place: Any = result
        shown = "$"
        for part in way:
            place, shown = _entered(place, part, shown)
        _check_part(place, last, shown)
        place[last] = value
    check(result)
    return result


def _parts(path: str) -> list[str | int]:
    """Return the keys and indices of `$.groups[0].name`; the `$.` may be left out."""
    text = path.removeprefix("$.")
    found = re.findall(r"(?:^|\.)([A-Za-z_][\w-]*)|\[(\d{1,6})\]", text)
    written = ".".join(key or f"[{index}]" for key, index in found).replace(".[", "[")
    if written != text or not found or len(found) > _MOST_PARTS:
        raise InputError(f"--set {path}: a path such as look.ev or groups[0].emitters[0].births.rate is needed")
    return [key or int(index) for key, index in found]


def _entered(place: Any, part: str | int, shown: str) -> tuple[Any, str]:
    _check_part(place, part, shown)
    if isinstance(part, str):
        return place.setdefault(part, {}), below(shown, part)
    return place[part], f"{shown}[{part}]"


def _check_part(place: Any, part: str | int, shown: str) -> None:
    if isinstance(part, str) and not isinstance(place, dict):
        raise InputError(f"{shown} is a {word(place)} and has no key '{part}'")
    if isinstance(part, int) and not (isinstance(place, list) and part < len(place)):
        size = f"a list of {len(place)}, counted from 0" if isinstance(place, list) else f"a {word(place)}"
        raise InputError(f"{shown} is {size}: it has no item [{part}]")
