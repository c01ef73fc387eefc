"""Moments of a state: a few numbers that say whether the physics changed, whatever the picture shows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .tolerance import Tolerance

Moments = dict[str, int | float | list[float]]
_WORDS = {"temperature": "mean temperature", "kinetic_energy": "mean kinetic energy"}
_UNITS = {"temperature": "K", "kinetic_energy": "J/kg"}
_ROUNDING = 1e-6  # of a position in f32, after some steps; all there is where a group has no spread
_TINY = 1e-12  # below this a moment is taken for zero, in its unit


def moments(state: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, Moments]:
    """Return the moments of each group of a `Frame.state()`, in float64.

    count; position [m], the mean; spread [m], the root mean square distance from it; temperature [K], the mean; kinetic_energy
    [J/kg], the mean of v^2 / 2. What a group does not have, or an empty one, is left out.
    """
    return {name: _of_group(group) for name, group in state.items()}


def _of_group(group: Mapping[str, np.ndarray]) -> Moments:
    count = len(next(iter(group.values()), ()))
    found: Moments = {"count": count}
    if not count:
        return found
    wide = {name: group[name].astype(np.float64) for name in ("x", "v", "T") if name in group}
    if "x" in wide:
        mean = wide["x"].mean(axis=0)
        found["position"] = mean.tolist()
        found["spread"] = float(np.sqrt(((wide["x"] - mean) ** 2).sum(axis=1).mean()))
    if "T" in wide:
        found["temperature"] = float(wide["T"].mean())
    if "v" in wide:
        found["kinetic_energy"] = float(0.5 * (wide["v"] ** 2).sum(axis=1).mean())
    return found


def faults(reference: Mapping[str, Moments], new: Mapping[str, Moments], limits: Tolerance) -> list[str]:
    """Say in words what differs by more than is allowed."""
    found = []
    for name in reference.keys() | new.keys():
        if name not in new or name not in reference:
            found.append(f"group '{name}' is {'gone' if name not in new else 'new'}")
            continue
        found += [f"{name}: {text}" for text in _group_faults(reference[name], new[name], limits)]
    return sorted(found)


def _group_faults(reference: Moments, new: Moments, limits: Tolerance) -> list[str]:
    found = []
    counts = int(_number(reference.get("count"))), int(_number(new.get("count")))
    if abs(counts[1] - counts[0]) > limits.count:
        found.append(f"{counts[1]} particles, not {counts[0]}")
    if ("position" in reference) and ("position" in new):
        found += _place_faults(reference, new, limits.moments)
    for name, words in _WORDS.items():
        if (name in reference) != (name in new):
            if min(counts):
                found.append(f"{words} is {'new' if name in new else 'gone'}")
        elif name in reference:
            old, now = _number(reference[name]), _number(new[name])
            if not abs(now - old) <= limits.moments * abs(old) + _TINY:
                found.append(f"{words} {now:.6g} {_UNITS[name]}, not {old:.6g}")
    return found


def _place_faults(reference: Moments, new: Moments, limit: float) -> list[str]:
    old, now = (np.asarray(m["position"], np.float64) for m in (reference, new))
    spread = _number(reference.get("spread"))
    allowed = limit * spread + _ROUNDING * float(np.abs(old).max()) + _TINY
    found = []
    if old.shape != now.shape or not np.abs(now - old).max() <= allowed:
        found.append(f"mean position ({_list(now)}) m, not ({_list(old)})")
    if not abs(_number(new.get("spread")) - spread) <= allowed:
        found.append(f"spread {_number(new.get('spread')):.6g} m, not {spread:.6g}")
    return found


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _list(values: np.ndarray) -> str:
    return ", ".join(f"{v:.5g}" for v in values)
