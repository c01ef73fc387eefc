"""What `--set` and `--seeds` of a sweep say: values of parameters, evenly spaced or listed, and how they combine."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

from ..errors import InputError

MOST_JOBS = 1_000_000  # that one batch holds
_MOST_VALUES = 10_000  # of one parameter
_LARGEST_SEED = 2**31
_SPACED = re.compile(r"([^:]*):([^:]*):([^:]*)")
_NUMBER = re.compile(r"[+-]?([0-9]{1,300}(\.[0-9]{0,300})?|\.[0-9]{1,300})([eE][+-]?[0-9]{1,3})?", re.ASCII)
_OPEN, _CLOSE = "[{(", "]})"
_SHOWN = 60  # characters of what somebody typed


def axis(text: str) -> tuple[str, tuple[str, ...]]:
    """Return name and values of `name=SPEC`, where SPEC is a list with commas of values and of `a:b:n`, n values from a to b.

    Values are text, as they are typed after `--set` of a render. A comma in brackets belongs to the value.
    Raises InputError.
    """
    name, equals, spec = text.partition("=")
    name = name.strip()
    if not equals or not name:
        raise InputError(f"--set {_short(text)}: name=values is needed, such as wind=0:2:5 or power=20,50,100")
    return name, values(name, spec)


def values(name: str, spec: str) -> tuple[str, ...]:
    """Return the values that `spec` lists for parameter `name`. Raises InputError."""
    found: list[str] = []
    for item in _items(spec):
        found += _spaced(name, item)
        if len(found) > _MOST_VALUES:
            raise InputError(f"{name} = {_short(spec)}: more than {_MOST_VALUES} values")
    return tuple(_once(name, found))


def listed(name: str, given: Any) -> tuple[Any, ...]:
    """Return the values of a sweep in a file: text in the grammar of `--set`, or a list of plain values. Raises InputError."""
    if isinstance(given, str):
        return values(name, given)
    return tuple(_once(name, list(given) if isinstance(given, list | tuple) else [given]))


def seeds(text: str) -> Sequence[int]:
    """Return the seeds of `1-4`, `1-9x2` (every second), `7`, or several with commas.

    Raises InputError: it cannot be read, is empty or too long, or names a seed twice.
    """
    found: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"([0-9]{1,10})(?:-([0-9]{1,10})(?:x([0-9]{1,10}))?)?", part.strip(), re.ASCII)
        if not match:
            raise InputError(f"seeds '{_short(text)}': '{_short(part.strip())}' is no range such as 1-4, 1-9x2 or 7")
        first, stride = int(match[1]), int(match[3] or 1)
        last = int(match[2]) if match[2] else first
        if last < first or stride < 1 or last > _LARGEST_SEED:
            raise InputError(f"seeds '{_short(text)}': '{part.strip()}' is empty or leaves 0 to {_LARGEST_SEED}")
        chosen = range(first, last + 1, stride)
        if len(found) + len(chosen) > MOST_JOBS:
            raise InputError(f"seeds '{_short(text)}': more than {MOST_JOBS}")
        found += chosen
    return _once("seeds", found)


def count(axes: Mapping[str, Sequence[Any]], *, paired: bool) -> int:
    """Return how many combinations there are: the product, or, `paired`, as many as each axis has values.

    Raises InputError: paired axes have different lengths, or there are more than a batch holds.
    """
    lengths = {name: len(found) for name, found in axes.items()}
    if paired:
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{name} has {n}" for name, n in lengths.items())
            raise InputError(f"--zip pairs values one by one: {told}; give each as many as the others")
        total = next(iter(lengths.values()), 1)
    else:
        total = math.prod(lengths.values())
    if total > MOST_JOBS:
        raise InputError(f"{total} jobs: at most {MOST_JOBS} in one batch")
    return total


def combinations(axes: Mapping[str, Sequence[Any]], *, paired: bool) -> Iterator[dict[str, Any]]:
    """Return one mapping of names to values for each combination, the last axis running fastest."""
    if not axes:
        return iter([{}])
    rows = zip(*axes.values(), strict=True) if paired else itertools.product(*axes.values())
    return (dict(zip(axes, row, strict=True)) for row in rows)


def _items(spec: str) -> Iterator[str]:
    """Return what the commas outside brackets part."""
    depth, start = 0, 0
    for i, letter in enumerate(spec):
        depth = max(0, depth + (letter in _OPEN) - (letter in _CLOSE))
        if letter == "," and not depth:
            yield spec[start:i]
            start = i + 1
    yield spec[start:]


def _spaced(name: str, item: str) -> Sequence[str]:
    """Return the values of `a:b:n`, exact where they can be written so, or the item itself."""
    item = item.strip()
    if not item:
        raise InputError(f"{name}: an empty value")
    match = _SPACED.fullmatch(item)
    if not match or not any(_NUMBER.fullmatch(part.strip()) for part in match.groups()):
        return [item]
    low, high, n = (part.strip() for part in match.groups())
    if not (_NUMBER.fullmatch(low) and _NUMBER.fullmatch(high) and re.fullmatch("[0-9]{1,7}", n, re.ASCII)):
        raise InputError(f"{name} = {_short(item)}: a:b:n is n values from a to b, such as 0:2:5")
    if not (math.isfinite(float(low)) and math.isfinite(float(high))):
        raise InputError(f"{name} = {_short(item)}: must be finite")
    a, b, steps = Fraction(low), Fraction(high), int(n)
    if not 1 <= steps <= _MOST_VALUES:
        raise InputError(f"{name} = {_short(item)}: 1 to {_MOST_VALUES} values are allowed")
    if (steps == 1) != (a == b):
        raise InputError(f"{name} = {_short(item)}: one value needs equal ends, several need different ones")
    return [_written(a + (b - a) * i / max(1, steps - 1)) for i in range(steps)]


def _written(number: Fraction) -> str:
    """Return a number as one would type it: an integer without a point, so that a parameter that takes integers takes it."""
    return str(number.numerator) if number.denominator == 1 and abs(number) < 10**15 else repr(float(number))


def _once(name: str, found: list[Any]) -> list[Any]:
    seen: set[str] = set()
    for value in found:
        key = str(value)
        if key in seen:
            raise InputError(f"{name}: {_short(key)} is given twice")
        seen.add(key)
    if not found:
        raise InputError(f"{name}: no value is given")
    return found


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."
