"""Frozen, validated descriptions: the base of every law, emitter, camera and look.

A spec is a pydantic dataclass whose errors are one line of ours: what is wrong, where, what is allowed, nearest name.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar, dataclass_transform

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass

from .errors import InputError, nearest

Class = TypeVar("Class", bound=type)
_UNKNOWN = ("unexpected_keyword_argument", "extra_forbidden")
_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True)


def _number(value: Any) -> Any:
    # pydantic would read "2" as 2 and True as 1; in a scene both are slips
    if isinstance(value, str | bytes | bool):
        raise ValueError("should be a number")
    return value


Finite = Annotated[float, Field(allow_inf_nan=False), BeforeValidator(_number)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), BeforeValidator(_number)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False), BeforeValidator(_number)]
Count = Annotated[int, Field(ge=1, le=2**31), BeforeValidator(_number)]
Seed = Annotated[int, Field(ge=0), BeforeValidator(_number)]
Vec3 = Annotated[tuple[Finite, Finite, Finite], BeforeValidator(lambda v: tuple(v) if isinstance(v, Sequence) else v)]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def spec(cls: Class) -> Class:
    """Make `cls` a frozen, keyword-only, validated dataclass whose constructor raises `InputError`."""
    # Of our own specs a scene uses a few: their validators are built by the first that is made.
    config: ConfigDict = {**_CONFIG, "defer_build": cls.__module__.startswith("tparticles.")}
    cls = pydantic_dataclass(kw_only=True, repr=False, eq=False, config=config)(cls)  # type: ignore[assignment]
    for name, method in _METHODS.items():
        if name not in vars(cls):
            setattr(cls, name, method)
    construct: Callable[..., None] = cls.__init__

    def __init__(self: Any, *args: Any, **options: Any) -> None:  # noqa: N807
        try:
            if args:
                raise InputError(f"{cls.__name__} takes keyword arguments only ({', '.join(_fields(cls))})")
            construct(self, **options)
        except ValidationError as error:
            raise InputError(explain(error, cls.__name__, _fields(cls))) from None
        finally:
            cls.__init__ = __init__  # building the validator took it away

    cls.__init__ = __init__
    return cls


def _values(self: Any) -> tuple[Any, ...]:
    return tuple(getattr(self, f.name) for f in dataclasses.fields(self))


def _repr(self: Any) -> str:
    return f"{type(self).__qualname__}({', '.join(f'{f.name}={getattr(self, f.name)!r}' for f in dataclasses.fields(self))})"


def _equal(self: Any, other: object) -> Any:
    if other.__class__ is not self.__class__:
        return NotImplemented
    return _values(self) == _values(other)


def _hash(self: Any) -> int:
    return hash(_values(self))


def _refuse(self: Any, name: str, *value: Any) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot {'assign to' if value else 'delete'} field {name!r}")


# What a frozen dataclass has. For each class anew, Python would write them as source and compile that, a good part of our import.
_METHODS = {"__repr__": _repr, "__eq__": _equal, "__hash__": _hash, "__setattr__": _refuse, "__delattr__": _refuse}


def _fields(cls: type) -> list[str]:
    return list(getattr(cls, "__dataclass_fields__", {}))


def explain(error: ValidationError, owner: str, names: Sequence[str] = ()) -> str:
    """Say in one line what pydantic found: owner, parameter, value, what is allowed, nearest right name."""
    # a wrong name first: it is why the right one is missing
    found = sorted(error.errors(include_url=False), key=lambda e: e["type"] not in _UNKNOWN)
    # of the members of a union, the one whose error lies deepest is the one that was meant
    deepest = max(len(e["loc"]) for e in found if e["loc"][:1] == found[0]["loc"][:1])
    same = [e for e in found if e["loc"][:1] == found[0]["loc"][:1] and len(e["loc"]) == deepest]
    first = same[0]
    others = len({e["loc"][:1] for e in found}) - 1
    path = _path(first["loc"])
    where = f"{owner}.{path}" if path else owner
    if first["type"] in _UNKNOWN:
        text = f"{owner} has no parameter '{path}'{nearest(path, names)} (known: {', '.join(names)})"
    elif first["type"] in ("missing", "missing_argument", "missing_keyword_only_argument"):
        text = f"{where} is missing"
    elif first["type"] == "dataclass_type":
        kinds = (e.get("ctx", {})["class_name"] for e in same if e["type"] == "dataclass_type")
        text = f"{where} = {_short(first['input'])}: should be a {' or a '.join(dict.fromkeys(kinds))}"
    elif first["type"] == "too_short":
        text = f"{where} = {_short(first['input'])}: at least {first.get('ctx', {})['min_length']} is needed"
    else:
        reason = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
        text = f"{where} = {_short(first['input'])}: {reason}"
    return text + (f" (and {others} more)" if others else "")


def _path(location: Sequence[int | str]) -> str:
    """Print where an error lies as it would be written, `keys[0][1]`; the names of a union's members are left out."""
    text = str(location[0]) if location else ""
    for part in location[1:]:
        if isinstance(part, int):
            text += f"[{part}]"
        elif part.isidentifier() and not part[0].isupper():
            text += f".{part}"
    return text


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def unit(name: str, value: Vec3) -> Vec3:
    """Return a direction at unit length.

    Raises:
        InputError: it is zero; `name` says which.
    """
    largest = max(map(abs, value))  # scaled first: squares of huge or tiny numbers leave the range
    if largest == 0.0:
        raise InputError(f"{name} = {value}: a direction must not be zero")
    scaled = tuple(v / largest for v in value)
    length = math.hypot(*scaled)
    return scaled[0] / length, scaled[1] / length, scaled[2] / length
