"""Dots on their way to the film."""
# pyright: reportIndexIssue=false, reportInvalidTypeForm=false

import numpy as np
import taichi as ti
from numpy.typing import ArrayLike

from tparticles.errors import InputError
from tparticles.render import splat

_NAMES = ("u", "v", "du", "dv", "sigma", "r", "g", "b")


@ti.data_oriented
class Dots:
    """Buffers for up to `capacity` splats, one f32 field of shape (capacity,) per quantity.

    `u, v` [px]: position at shutter close; (0, 0) is the top left corner of the film, pixel centres are at +0.5, v grows
    downward. `du, dv` [px]: from there to the position at shutter open; zero is a dot. `sigma` [px]: standard deviation
    of the Gaussian; 0.3..1024, others are drawn at the nearer limit. `r, g, b` [film white * px]: energy, that is the
    sum over the film; a channel may be negative. Energies are clamped to +-2^26.

    A dot with a NaN or infinity, with sigma <= 0, or 2^24 px or more away draws nothing.

    Raises `InputError` if capacity < 1.
    """

    def __init__(self, capacity: int):
        if capacity < 1:
            raise InputError(f"capacity = {capacity}: room for at least 1 dot is needed")
        self.capacity = capacity
        self.u, self.v, self.du, self.dv, self.sigma, self.r, self.g, self.b = (
            ti.field(ti.f32, shape=capacity) for _ in _NAMES
        )

    def upload(
        self, u: ArrayLike, v: ArrayLike, *, sigma: ArrayLike, energy: ArrayLike, du: ArrayLike = 0, dv: ArrayLike = 0
    ) -> int:
        """Fill the buffers from arrays of shape (n,), `energy` (n, 3), or scalars to repeat; return n.

        Raises `InputError` if there are more dots than `capacity`.
        """
        e = np.asarray(energy, dtype=np.float32)
        columns = np.broadcast_arrays(u, v, du, dv, sigma, e[..., 0], e[..., 1], e[..., 2])
        count = columns[0].size
        if count > self.capacity:
            raise InputError(f"{count} dots do not fit into a capacity of {self.capacity}")
        for name, column in zip(_NAMES, columns, strict=True):
            padded = np.zeros(self.capacity, dtype=np.float32)
            padded[:count] = column.ravel()
            getattr(self, name).from_numpy(padded)
        return count

    @ti.func
    def read(self, i):
        """Return dot i as a record of 8 f32 in the order of the fields, its energy in quanta, sigma in its limits."""
        top = ti.f32(splat.ENERGY_MAX)
        energy = ti.min(ti.max(ti.Vector([self.r[i], self.g[i], self.b[i]]), -top), top) * ti.f32(1.0 / splat.QUANTUM)
        path, sigma = ti.Vector([self.u[i], self.v[i], self.du[i], self.dv[i]]), splat.limited(self.sigma[i])
        return ti.Vector([path[0], path[1], path[2], path[3], sigma, energy[0], energy[1], energy[2]])

    @ti.func
    def rows(self, i, width, height):
        """Return the film rows first..last that dot i may touch; first > last if it draws nothing."""
        first, last = 0, -1
        u, v, du, dv, sigma = self.u[i], self.v[i], self.du[i], self.dv[i], self.sigma[i]
        near = splat.reachable(u) and splat.reachable(v) and splat.reachable(du) and splat.reachable(dv)
        energy = splat.finite(self.r[i]) and splat.finite(self.g[i]) and splat.finite(self.b[i])
        if near and energy and splat.finite(sigma) and sigma > 0.0:
            R = splat.radius(splat.limited(sigma))
            u2, v2 = u + du, v + dv
            left, right = ti.cast(ti.floor(ti.min(u, u2)), ti.i32) - R, ti.cast(ti.floor(ti.max(u, u2)), ti.i32) + R
            if right >= 0 and left < width:
                first = ti.max(ti.cast(ti.floor(ti.min(v, v2)), ti.i32) - R, 0)
                last = ti.min(ti.cast(ti.floor(ti.max(v, v2)), ti.i32) + R, height - 1)
        return first, last
