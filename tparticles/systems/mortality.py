"""Who dies at the end of a frame: the too old, those who left the region, the too cold to glow; and who went astray."""

# pyright: reportInvalidTypeForm=false, reportOptionalCall=false

from typing import Any

import numpy as np
import taichi as ti

from .. import backend
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
        frost: tells the temperature [K] below which a dot shows nothing, `coldest(camera, size, x)`, a `@ti.func`; None where
            nobody dies of cold.
        ages: whether there are lifetimes.
    """

    def __init__(self, columns: Columns, view: View, *, region: Any, frost: Any, ages: bool):
        self.columns, self.view, self.ages = columns, view, ages
        self.frost: Any = frost
        self.region: Any = None if region is None else view.parameters.bind(region)
        self.bounded, self.freezes = region is not None, frost is not None
        self.kills = ages or self.bounded or self.freezes
        self.lanes = backend.current().lanes
        self.dead = ti.field(ti.i32, columns.padded if self.kills else 1)

    def mark(self, count: int, t: float, camera: np.ndarray) -> int:
        """Mark who is dead at time `t` [s] as seen by the camera row `camera`; return how many.

        Raises:
            RunError: a particle's state is not finite or absurdly far away; names its id.
        """
        if not count:
            return 0
        died, astray = self._mark(count, t, camera, self.view.parameters.array)
        if astray != _NOBODY:
            raise RunError(f"particle {astray}: its state is not finite or more than {_FAR:g} m away")
        return int(died)

    @ti.kernel
    def _mark(
        self,
        count: ti.i32,
        t: ti.f64,
        camera: ti.types.ndarray(dtype=ti.f32, ndim=1),
        values: ti.types.ndarray(ndim=1),
    ) -> ti.types.vector(2, ti.i32):
        ti.static(self.view.parameters.read_from(values))
        died, astray = 0, _NOBODY
        for block in range((count + self.lanes - 1) // self.lanes):
            # Verdicts go to locals first: a store to a field inside the lane loop would stop its vectorisation.
            dead, lost = ti.Vector([0] * self.lanes), ti.Vector([0] * self.lanes)
            for lane in range(self.lanes):
                i = block * self.lanes + lane
                lost[lane] = self._is_lost(i, t)
                dead[lane] = self._is_dead(i, t, camera)
            deaths = 0
            for lane in range(self.lanes):
                i = block * self.lanes + lane
                if i < count:
                    deaths += dead[lane]
                    if ti.static(self.kills):
                        self.dead[i] = dead[lane]
                    if lost[lane] != 0:
                        ti.atomic_min(astray, self.columns["id"][0][i])
            died += deaths
        return ti.Vector([died, astray])

    @ti.func
    def _is_lost(self, i, t):
        # A sum keeps a NaN, where max() would drop it.
        reach = ti.abs(self.view.position(i)).sum() + ti.abs(self.view.velocity(i)).sum()
        if ti.static("T" in self.columns):
            reach += ti.abs(self.view.temperature(i, t))
        return ti.select(ti.math.isnan(reach) or reach > _FAR, 1, 0)

    @ti.func
    def _is_dead(self, i, t, camera: ti.template()):
        x, dead = self.view.position(i), 0
        if ti.static(self.ages):
            dead |= ti.select(self.view.age(i, t) >= self.view.lifetime(i), 1, 0)
        if ti.static(self.bounded):
            dead |= ti.select(self.region.contains(x), 0, 1)
        if ti.static(self.freezes):
            dead |= ti.select(self.view.temperature(i, t) < self.frost.coldest(camera, self.view.size(i), x), 1, 0)
        return dead
