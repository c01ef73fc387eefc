"""The colours and widths that the points of a log have in other programs: those of the renderer, before its tone curve."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..render.appearance import Glow
from ..render.blackbody import BlackbodyTable
from ..render.look import Look, srgb_decode
from .read import MeshLog, ParticleLog, State


def widths(spec: Any, group: MeshLog | ParticleLog, state: State) -> np.ndarray:
    """Return diameters [m], shape (n,); `spec`: the group in the scene."""
    if isinstance(group, MeshLog):
        return np.full(len(state.x), spec.appearance.dot or spec.appearance.width)
    if "size" in state.columns:
        size = state.columns["size"][:, 0]
    else:
        size = np.full(len(state.x), spec.constants().size)
    return size + spec.appearance.growth * (state.time - state.columns["birth"][:, 0])


def colors(spec: Any, look: Look, group: MeshLog | ParticleLog, state: State) -> np.ndarray:
    """Return linear sRGB colours, shape (n, 3), 0..1: what is brighter than white keeps its hue."""
    values = _mesh(spec, look, group, state) if isinstance(group, MeshLog) else _particles(spec, look, state)
    values = np.maximum(values, 0.0)
    return values / np.maximum(values.max(axis=1, keepdims=True, initial=0.0), 1.0)


def _particles(spec: Any, look: Look, state: State) -> np.ndarray:
    if isinstance(spec.appearance, Glow):
        table = BlackbodyTable.build(adaptation=look.adaptation())
        return look.exposure * spec.appearance.emissivity * table.lookup(state.columns["T"][:, 0].astype(float))
    stops = srgb_decode(np.array(spec.appearance.colors, float)) * spec.appearance.brightness
    return _between(stops, (state.time - state.columns["birth"][:, 0]) / spec.appearance.span)


def _mesh(spec: Any, look: Look, group: MeshLog, state: State) -> np.ndarray:
    wires, count = spec.appearance, len(state.x)
    stops = wires.stops(look, spec.temperature_at(state.time))
    assert state.v is not None
    value = np.zeros(count)
    if wires.by == "speed":
        value = np.linalg.norm(state.v, axis=1)
    elif wires.by == "strain" and count == group.vertex_count and len(group.springs["springs"]):
        i, j = group.springs["springs"].T
        strain = np.linalg.norm(state.x[j] - state.x[i], axis=1) / group.springs["rest"] - 1
        ends = np.concatenate([i, j])
        degree = np.maximum(np.bincount(ends, minlength=count), 1)
        value = np.bincount(ends, np.concatenate([strain, strain]), count) / degree  # the mean of its springs
    return _between(stops, (value - wires.low) / (wires.high - wires.low))


def _between(stops: np.ndarray, s: np.ndarray) -> np.ndarray:
    place = np.clip(s, 0.0, 1.0) * (len(stops) - 1)
    return np.stack([np.interp(place, np.arange(len(stops)), column) for column in stops.T], axis=1)
