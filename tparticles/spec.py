"""Frozen, validated descriptions: the base of every law, emitter, camera and look.

A spec is a pydantic dataclass whose errors are one line of ours: what is wrong, where, what is allowed, nearest name.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar, dataclass_transform

from pydantic import BeforeValidator, ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass

from .errors import InputError, nearest

Class = TypeVar("Class", bound=type)
_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True)

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Vec3 = Annotated[tuple[Finite, Finite, Finite], BeforeValidator(lambda v: tuple(v) if isinstance(v, Sequence) else v)]


@dataclass_transform(frozen_default=True, kw_only_default=True)
def spec(cls: Class) -> Class:
    """Make `cls` a frozen, keyword-only, validated dataclass whose constructor raises `InputError`."""
    cls = pydantic_dataclass(frozen=True, kw_only=True, config=_CONFIG)(cls)  # type: ignore[assignment]
    construct: Callable[..., None] = cls.__init__

    def __init__(self: Any, *args: Any, **options: Any) -> None:
        try:
            if args:
                raise InputError(f"{cls.__name__} takes keyword arguments only ({', '.join(_fields(cls))})")
            construct(self, **options)
        except ValidationError as error:
            raise InputError(explain(error, cls.__name__, _fields(cls))) from None

    cls.__init__ = __init__
    return cls


def _fields(cls: type) -> list[str]:
    return list(getattr(cls, "__dataclass_fields__", {}))


def explain(error: ValidationError, owner: str, names: Sequence[str] = ()) -> str:
    """Say in one line what pydantic found: owner, parameter, value, what is allowed, nearest right name."""
    found = error.errors(include_url=False)
    first = found[0]
    path = [str(part) for part in first["loc"] if isinstance(part, int) or part.isidentifier()]
    where = f"{owner}.{'.'.join(path)}" if path else owner
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        text = f"{owner} has no parameter '{path[-1]}'{nearest(path[-1], names)} (known: {', '.join(names)})"
    elif first["type"] in ("missing", "missing_argument", "missing_keyword_only_argument"):
        text = f"{where} is missing"
    else:
        reason = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
        text = f"{where} = {_short(first['input'])}: {reason}"
    return text + (f" (and {len(found) - 1} more)" if len(found) > 1 else "")


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
