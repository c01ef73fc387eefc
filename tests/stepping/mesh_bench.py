"""Meshes on their own: a motion without a film, and the plain right-hand side that executors are held against."""

from __future__ import annotations

from typing import Any

import numpy as np

import tparticles as tp
from tparticles import schemes
from tparticles.mesh_motion import MeshMotion

FRAME = 1 / 24


def motion(mesh: tp.Mesh, *, scheme: Any = "velocity-verlet", dt: float = 1 / 240, **options: Any) -> MeshMotion:
    """Return a mesh at work in frames of 1/24 s; `options` are those of `MeshGroup`."""
    group = tp.MeshGroup(name="mesh", mesh=mesh, **{"forces": (tp.Gravity(),), **options})
    result = MeshMotion(
        group, scheme=schemes.get(scheme), steps=tp.Fixed(dt=dt), clamp="equal", look=tp.Look(), frame=FRAME
    )
    result.emit(0.0, FRAME)
    return result


def run(bench: MeshMotion, frames: int, *, first: int = 0) -> None:
    """Advance some frames."""
    for k in range(first, first + frames):
        bench.advance(k * FRAME, (k + 1) * FRAME, np.zeros(15, np.float32))


def right_hand_side(mesh: tp.Mesh, g: tuple[float, float, float] = (0.0, 0.0, -9.81)):
    """Return f(t, z) of z = (x, v): springs with damping along them, gravity, pinned vertices; plain loops in float64."""

    def f(t, z):
        x, v = z
        force = np.zeros_like(x)
        for s, (i, j) in enumerate(mesh.springs):
            d = x[j] - x[i]
            length = np.sqrt(d @ d)
            n = d / length
            pull = mesh.stiffness[s] * (length - mesh.rest[s]) + mesh.damping[s] * ((v[j] - v[i]) @ n)
            force[i] += pull * n
            force[j] -= pull * n
        a = force / mesh.mass[:, None] + np.array(g)
        return np.stack([v, np.where(mesh.pinned[:, None], 0.0, a)])

    return f
