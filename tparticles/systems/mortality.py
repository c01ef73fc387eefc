"""Who dies at the end of a frame: the too old, those who left the region, the too cold to glow; and who went astray."""

from typing import Any

import numpy as np
import taichi as ti

from ..errors import RunError
from .attributes import Columns
from .view import View

_NOBODY = 2**31 - 1
_FAR = 1e18  # [m]; whoever is farther has blown up


@ti.data_oriented
class Mortality:
    """Marks the dead of one group.

    Arguments:
        view: reads the particles.
        region: where particles may be (`contains(x)`), or None.
        brightness: what tells the brightest pixel of a dot (`brightest(camera, T, size, x)`, a
            `@ti.func`, in film values), or None
            where nobody dies of cold.
        ages: whether there are lifetimes.
    """

    def __init__(self, columns: Columns, view: View, *, region: Any, brightness: Any, ages: bool):
        self.columns, self.view, self.brightness, self.ages = columns, view, brightness, ages
        self.region = None if region is None else view.parameters.bind(region)
        self.bounded, self.freezes = region is not None, brightness is not None
        self.kills = ages or self.bounded or self.freezes
        self.dead = ti.field(ti.i32, columns.padded if self.kills else 1)

    def mark(self, count: int, t: float, threshold: float, camera: np.ndarray) -> int:
        """Mark who is dead at time `t` [s]; return how many. A dot dimmer than `threshold` (film value) is too cold.

        Raises:
            RunError: a particle's state is not finite; its id is in `args[1]`.
        """
        if not count:
            return 0
        died, astray = self._mark(count, t, threshold, camera, self.view.parameters.array)
        if astray != _NOBODY:
            raise RunError(f"particle {astray}: its state is not finite or more than {_FAR:g} m away")
        return int(died)

    @ti.kernel
    def _mark(
        self,
        count: ti.i32,
        t: ti.f64,
        threshold: float,
        camera: ti.types.ndarray(dtype=ti.f32, ndim=1),
        values: ti.types.ndarray(ndim=1),
    ) -> ti.types.vector(2, ti.i32):
        ti.static(self.view.parameters.read_from(values))
        died, astray = 0, _NOBODY
        for i in range(count):
            x, v = self.view.position(i), self.view.velocity(i)
            # fast math drops v != v: compare in a way that NaN fails
            reach = ti.abs(x).max() + ti.abs(v).max()
            if ti.static("T" in self.columns):
                reach += ti.abs(self.view.temperature(i, t))
            if ti.math.isnan(reach) or reach > _FAR:
                ti.atomic_min(astray, self.columns["id"][0][i])
            dead = 0
            if ti.static(self.ages):
                if self.view.age(i, t) >= self.view.lifetime(i):
                    dead = 1
            if ti.static(self.bounded):
                if not self.region.contains(x):
                    dead = 1
            if ti.static(self.freezes):
                if self.brightness.brightest(camera, self.view.temperature(i, t), self.view.size(i), x) < threshold:
                    dead = 1
            if ti.static(self.kills):
                self.dead[i] = dead
            died += dead
        return ti.Vector([died, astray])
