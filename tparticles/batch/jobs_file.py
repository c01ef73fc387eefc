"""jobs.toml: a list of films and sweeps, as data.

[defaults]
quality = "preview"

[[job]]
scene = "campfire"
name = "windy"
set = { wind = 2.0 }
seed = 3

[[job]]
scene = "swirl"
sweep = { count = [1000, 2000], speed = "0.2:0.6:5" }
seeds = "1-4"
zip = false
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..command_options import size_option
from ..data_scene.files import parse, read_text, word
from ..errors import InputError, unknown
from . import grammar
from .tasks import OPTIONS, Task, make_name

_KEYS: dict[str, type] = {"scene": str, "name": str, "set": dict, "seed": int, "sweep": dict, "seeds": str, "zip": bool}
_SWEEP = {"sweep", "seeds", "zip"}


def read_jobs(path: Path) -> tuple[int, Iterator[Task]]:
    """Return how many films a file asks for, and them, not yet made: there may be very many.

    Raises InputError with the place in the file: `$.job[2].seeds`.
    """
    try:
        if path.suffix.lower() not in (".toml", ".json"):
            raise InputError("jobs are a .toml or a .json file")
        document = parse(read_text(path), path.suffix.lower())
        for key in document:
            if key not in ("defaults", "job"):
                raise unknown("key in $", key, ("defaults", "job"))
        defaults = _options(_table(document.get("defaults", {}), "$.defaults"), "$.defaults")
        jobs = document.get("job")
        if not isinstance(jobs, list) or not jobs:
            raise InputError("$.job: at least one [[job]] is needed")
        parts = [_job(_table(job, f"$.job[{i}]"), defaults, f"$.job[{i}]") for i, job in enumerate(jobs)]
    except InputError as error:
        raise InputError(str(error) if str(error).startswith(f"{path}") else f"{path}: {error}") from None
    total = sum(count for count, _ in parts)
    if total > grammar.MOST_JOBS:
        raise InputError(f"{path}: {total} jobs: at most {grammar.MOST_JOBS} in one batch")
    return total, (task for _, tasks in parts for task in tasks)


def _job(job: dict[str, Any], defaults: Mapping[str, Any], where: str) -> tuple[int, Iterator[Task]]:
    own = {key: job.pop(key) for key in list(job) if key in _KEYS}
    for key, value in own.items():
        if type(value) is not _KEYS[key] and not (key == "seeds" and isinstance(value, list)):
            raise InputError(f"{where}.{key} is a {word(value)}: should be a {word(_KEYS[key]())}")
    if "scene" not in own:
        raise InputError(f"{where}.scene is missing")
    if own.get("seed", 0) < 0:
        raise InputError(f"{where}.seed = {own['seed']}: must be at least 0")
    options = {**defaults, **_options(job, where)}
    if _SWEEP & set(own):
        return _sweep(own, options, where)
    settings, seed = own.get("set", {}), own.get("seed")
    name = own.get("name") or make_name(Path(own["scene"]).stem, settings, seed)
    task = Task(name=name, scene=own["scene"], settings=settings, seed=seed, options=options)
    return 1, iter([task])


def _sweep(own: Mapping[str, Any], options: Mapping[str, Any], where: str) -> tuple[int, Iterator[Task]]:
    if "seed" in own and "seeds" in own:
        raise InputError(f"{where}: seed and seeds are given, one of them is enough")
    try:
        axes = {name: grammar.listed(name, values) for name, values in own.get("sweep", {}).items()}
        if both := set(axes) & set(own.get("set", {})):
            raise InputError(f"{min(both)} is in set and in sweep")
        seeds = _seeds(own["seeds"]) if "seeds" in own else None
        return tasks(
            own["scene"],
            axes,
            seeds=seeds,
            seed=own.get("seed"),
            paired=own.get("zip", False),
            fixed=own.get("set", {}),
            options=options,
            prefix=own.get("name") or Path(own["scene"]).stem,
        )
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _seeds(given: Any) -> tuple[int, ...]:
    return tuple(grammar.seeds(given if isinstance(given, str) else ",".join(map(str, given))))


def tasks(
    scene: str,
    axes: Mapping[str, tuple[Any, ...]],
    *,
    options: Mapping[str, Any],
    seeds: tuple[int, ...] | None = None,
    seed: int | None = None,
    paired: bool = False,
    fixed: Mapping[str, Any] | None = None,
    prefix: str = "",
) -> tuple[int, Iterator[Task]]:
    """Return how many films a sweep asks for, and them, not yet made. Seeds are an axis as any other.

    Raises InputError: see `grammar.count`.
    """
    every = {**axes, **({} if seeds is None else {" seed": seeds})}  # no parameter has a name with a blank

    def make() -> Iterator[Task]:
        for chosen in grammar.combinations(every, paired=paired):
            chosen_seed = chosen.pop(" seed", seed)
            swept = make_name(prefix, chosen, None if seeds is None else chosen_seed)
            settings = {**(fixed or {}), **chosen}
            yield Task(name=swept, scene=scene, settings=settings, seed=chosen_seed, options=options)

    return grammar.count(every, paired=paired), make()


def _options(table: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the options of a render that `table` holds, by `job.Options`."""
    found = {}
    for key, value in table.items():
        if key not in OPTIONS:
            raise unknown(f"key in {where}", key, [*OPTIONS, *([] if where == "$.defaults" else _KEYS)])
        kind = str if key == "size" else OPTIONS[key]
        if type(value) is not kind:
            raise InputError(f"{where}.{key} is a {word(value)}: should be a {word(kind())}")
        found[key] = size_option(None, None, value) if key == "size" else value
    return found


def _table(value: Any, where: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise InputError(f"{where} is a {word(value)}: should be a table")
    return dict(value)
