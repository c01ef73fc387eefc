"""Schemes by name that are built when they are first asked for: working out orders and stability takes its time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any, TypeAlias

from tparticles.schemes.program import Scheme

Builder: TypeAlias = Callable[[], Scheme]
Named: TypeAlias = tuple[str, Builder]


def named(name: str, build: Callable[..., Scheme], *tables: Any, **rest: Any) -> Named:
    """Return `name` and how its scheme is built, once: by `build(*tables, name=name, **rest)`."""
    return name, cache(partial(build, *tables, name=name, **rest))


class Lazy(Mapping[str, Scheme]):
    """Schemes by name, in order. Only taking one out builds it, with what it starts from; names need no scheme."""

    def __init__(self, *builders: Named):
        self.builders = builders
        self._by_name = dict(builders)

    def __getitem__(self, name: str) -> Scheme:
        return self._by_name[name]()

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    def __contains__(self, name: object) -> bool:
        return name in self._by_name

    def __repr__(self) -> str:
        return f"Lazy({', '.join(self)})"
