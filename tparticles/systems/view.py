"""Reading a particle inside a kernel, whether a value is stored, common to the group, or a closed form of the age."""

# pyright: reportInvalidTypeForm=false

from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..binding import Parameters
from ..spec import Finite, spec
from .attributes import Columns


@spec
class Constants:
    """What all particles of a group share where it is no attribute: T0 [K], size [m], lifetime [s]."""

    T0: Finite = 0.0
    size: Finite = 0.0
    lifetime: float = float("inf")


@ti.data_oriented
class View:
    """The attributes of particle `i` as `@ti.func`s; times are absolute, float64 [s].

    Kernels that read through a view take its `parameters` (see `Parameters`).
    """

    def __init__(self, columns: Columns, parameters: Parameters, *, cooling: Any, constants: Constants):
        self.columns = columns
        self.parameters = parameters
        self.constants = self.parameters.bind(constants)
        self.cooling: Any = None if cooling is None else self.parameters.bind(cooling)
        self.closed_form = cooling is not None and not cooling.integrated

    @ti.func
    def position(self, i):
        """Return x [m]."""
        return ti.Vector([self.columns["x"][d][i] for d in ti.static(range(3))])

    @ti.func
    def velocity(self, i):
        """Return v [m/s]; zero where it is not kept."""
        v = ti.Vector([0.0, 0.0, 0.0])
        if ti.static("v" in self.columns):
            for d in ti.static(range(3)):
                v[d] = self.columns["v"][d][i]
        return v

    @ti.func
    def age(self, i, t):
        """Return the age [s]: the difference is taken in f64, so it is exact however late it is."""
        return ti.cast(t - self.columns["birth"][0][i], float)

    @ti.func
    def size(self, i):
        """Return the diameter [m]."""
        value = self.constants.size
        if ti.static("size" in self.columns):
            value = self.columns["size"][0][i]
        return value

    @ti.func
    def lifetime(self, i):
        """Return the age at death [s], infinite for the immortal."""
        value = self.constants.lifetime
        if ti.static("lifetime" in self.columns):
            value = self.columns["lifetime"][0][i]
        return value

    @ti.func
    def temperature(self, i, t):
        """Return T [K]."""
        return self.temperature_at(i, self.age(i, t))

    @ti.func
    def temperature_at(self, i, age):
        """Return T [K] of a particle that is `age` [s] old: integrated, a closed form of the age, or as at birth."""
        T = self.constants.T0
        if ti.static("T0" in self.columns):
            T = self.columns["T0"][0][i]
        if ti.static("T" in self.columns):
            T = self.columns["T"][0][i]
        elif ti.static(self.closed_form):
            T = self.cooling.temperature(T, age, self.size(i))
        return T

    def temperatures(self, count: int, t: float) -> np.ndarray:
        """Return T [K] of the first `count` particles at time `t` [s], shape (count,)."""
        out = np.empty(count, np.float64 if backend.current().precision == "f64" else np.float32)
        if count:
            self._temperatures(count, t, out, self.parameters.array)
        return out

    @ti.kernel
    def _temperatures(self, count: ti.i32, t: ti.f64, out: ti.types.ndarray(ndim=1), values: ti.types.ndarray(ndim=1)):
        ti.static(self.parameters.read_from(values))
        for i in range(count):
            out[i] = self.temperature(self.columns.first + i, t)
