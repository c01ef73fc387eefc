"""Which vertices an implicit stage holds at the surfaces they would enter.

A stage is solved as if nothing were in the way; what is then inside a collider is given the speed, along the surface's normal
alone, that leads to the surface instead, and the stage is solved again: all else of it follows its springs, or a stiff body would
be torn. A surface pushes and does not pull: a vertex that it would have to hold back is let go. Friction takes what the push
allows of the speed along the surface (Coulomb). A step was too long for a bounce to be told from a rest: contact is inelastic.

Only backward Euler is held so: it damps what a sudden stop sets swinging. A step of another scheme that enters a collider is taken
back and made by it; the past of a multistep scheme is worthless then anyway.
"""

from __future__ import annotations

import numpy as np

from .contact import Contact
from .mesh_solver import SolveResult

ROUNDS = 8  # solutions of a stage at most, beside the first
_NEAR = 1e-8  # of a spring: so far inside is not inside

Array = np.ndarray


class Walls:
    """The contacts of one stage.

    Arguments:
        contact: the mesh's colliders.
        x, v: zbar of the stage, (n, 3) each.
        t: when the colliders are where the stage leads to [s].
        w: its step [s].
        length: of a spring [m].
    """

    def __init__(self, contact: Contact, x: Array, v: Array, *, t: float, w: float, length: float):
        self.contact, self.v, self.t, self.w = contact, v, t, w
        self.near = max(contact.slack, _NEAR * length)
        self.movable = contact.system.inverse_mass.to_numpy()[: len(x)] > 0
        self.normals, self.speeds = np.zeros_like(x), np.zeros(len(x))
        self.vbar = v
        self._active = np.zeros(len(x), bool)
        self._friction, self._carried, self._free = np.zeros(len(x)), np.zeros_like(x), v
        self._rounds = 0

    def enters(self, x: Array) -> bool:
        """Whether a vertex is inside a collider with the vertices at `x`, (n, 3)."""
        return bool(((self.contact.nearest(x, self.t)[0] < -self.near) & self.movable).any())

    def take(self, found: SolveResult) -> bool:
        """Take in a solution of the stage; return whether there is another one to be found, with `vbar`, `normals` and `speeds`."""
        distance, friction, normal, carried = self.contact.nearest(found.x, self.t)
        inside = (distance < -self.near) & self.movable
        pushes = np.broadcast_to(found.pushes, inside.shape).copy()
        pulled = self._active & (pushes < 0.0) & ~inside
        if self._rounds == 0:
            self._free = found.v
        if not (inside.any() or pulled.any() or (self._rounds == 1 and self._active.any())):
            return False
        speed = -distance / self.w
        new = inside & ~self._active
        self.normals[inside], self._friction[inside], self._carried[inside] = (
            a[inside] for a in (normal, friction, carried)
        )
        self.speeds[inside] = np.sum(found.v * normal, axis=1)[inside] + speed[inside]
        pushes[new] = speed[new]
        self._active = (self._active | inside) & ~pulled
        self.normals[pulled], self.speeds[pulled] = 0.0, 0.0
        along = self._free - self._carried
        along -= np.sum(along * self.normals, axis=1, keepdims=True) * self.normals
        slip = np.linalg.norm(along, axis=1)
        stopped = np.minimum(self._friction * np.maximum(pushes, 0.0) / np.maximum(slip, 1e-30), 1.0)
        self.vbar = self.v - np.where(self._active, stopped, 0.0)[:, None] * along
        self._rounds += 1
        return True
