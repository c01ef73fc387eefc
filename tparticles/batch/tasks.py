"""One task of a batch: a scene, its parameters and how it is rendered, under a name that is safe as a folder's."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError, unknown

# What may be asked of every render; the names of `job.Options`.
OPTIONS: dict[str, type] = {
    "quality": str,
    "size": tuple,
    "frames": str,
    "fps": str,
    "scheme": str,
    "precision": str,
    "arch": str,
    "png": bool,
    "mp4": bool,
    "states": bool,
}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._=+,~-]{0,119}")
_LONGEST_NAME = 100  # of those that we make, characters
_DATA = (".toml", ".json")
_RESERVED = {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}


@dataclass(frozen=True, kw_only=True)
class Task:
    """A film to render.

    name: of its folder. settings: parameters of the scene, as text or as plain values. options: see `OPTIONS`.
    Raises InputError for a name that is no safe folder name or an option of the wrong kind.
    """

    name: str
    scene: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name(self.name)
        for name, value in self.options.items():
            if name not in OPTIONS:
                raise unknown(f"option of job '{self.name}'", name, OPTIONS)
            if type(value) is not OPTIONS[name]:
                raise InputError(f"job '{self.name}': {name} = {value!r} should be a {OPTIONS[name].__name__}")

    def row(self) -> dict[str, Any]:
        """Return the task as JSON can hold it."""
        return {**vars(self), "settings": dict(self.settings), "options": dict(self.options)}

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Task:
        """Return the task of a row that `row` made and somebody may have edited. Raises InputError."""
        kinds = {"name": str, "scene": str, "settings": dict, "options": dict}
        for name, kind in kinds.items():
            if not isinstance(row.get(name), kind):
                raise InputError(f"a job's {name} is {row.get(name)!r}: should be a {kind.__name__}")
        seed = row.get("seed")
        if seed is not None and (type(seed) is not int or seed < 0):
            raise InputError(f"job '{row['name']}': seed = {seed!r} should be an integer from 0")
        options = dict(row["options"])
        if isinstance(options.get("size"), list):
            options["size"] = tuple(options["size"])
        return cls(name=row["name"], scene=row["scene"], settings=row["settings"], seed=seed, options=options)

    def caption(self) -> str:
        """Return what tells this film from the others, for people."""
        told = [f"{name}={value}" for name, value in self.settings.items()]
        return ", ".join([*told, *([] if self.seed is None else [f"seed={self.seed}"])]) or self.scene

    def key(self) -> str:
        """Return a hash of everything that is asked for."""
        asked = {name: value for name, value in self.row().items() if name != "name"}
        return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


def check_name(name: str) -> None:
    """Refuse what is no safe name of a folder on every system. Raises InputError."""
    if not _NAME.fullmatch(name) or name.endswith(".") or name.partition(".")[0].lower() in _RESERVED:
        shown = name if len(name) <= 60 else name[:57] + "..."
        raise InputError(
            f"job name {shown!r}: letters, digits and ._=+,~- are allowed, a letter or digit first, at most 120"
        )


def named(tasks: Iterable[Task]) -> list[Task]:
    """Return the tasks with names that differ, also where a system takes upper and lower case for the same.

    Raises InputError for two tasks that ask for the same film, or that were given the same name by hand.
    """
    result: list[Task] = []
    taken: dict[str, str] = {}
    asked: dict[str, str] = {}
    for task in tasks:
        key = task.key()
        if key in asked:
            raise InputError(f"jobs '{asked[key]}' and '{task.name}' are the same")
        if task.name.casefold() in taken:
            task = dataclasses.replace(task, name=_shortened(task.name, key))
        if task.name.casefold() in taken:
            raise InputError(f"two jobs are named '{task.name}'")
        asked[key] = taken[task.name.casefold()] = task.name
        result.append(task)
    return result


def make_name(prefix: str, settings: Mapping[str, Any], seed: int | None) -> str:
    """Return a readable folder name, `wind=0.5,power=20,seed=1`: what is unsafe in it becomes `_`."""
    parts = [prefix] if prefix else []
    parts += [f"{name}={value}" for name, value in settings.items()]
    parts += [] if seed is None else [f"seed={seed}"]
    text = ",".join(parts)
    safe = re.sub(r"[^A-Za-z0-9._=+,~-]", "_", text)
    safe = re.sub(r"^[^A-Za-z0-9]+", "", safe).rstrip(".") or "job"
    # Two texts may become one, or their ends may be cut off; then a hash tells them apart.
    return (
        safe
        if safe == text and len(safe) <= _LONGEST_NAME
        else _shortened(safe, hashlib.sha256(text.encode()).hexdigest())
    )


def _shortened(name: str, key: str) -> str:
    return f"{name[: _LONGEST_NAME - 9]}~{key[:8]}"


def check_scene(scene: str, *, allow_python: bool) -> None:
    """Refuse a scene that is code from elsewhere: a batch takes names, scripts of ./scenes and data (.toml, .json).

    Raises InputError.
    """
    path = Path(scene)
    if allow_python or path.suffix.lower() in _DATA or (len(path.parts) < 2 and not path.suffix):
        return
    try:
        local = path.parent.resolve() == Path("scenes").resolve()
    except (OSError, ValueError, RuntimeError):  # a loop of links, a NUL
        local = False
    if not local:
        raise InputError(
            f"scene '{scene}' is a Python file outside scenes/, and a script is code: add --allow-python if you trust it"
        )
