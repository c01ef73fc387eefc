"""Who dies at the end of a frame: the too old, those who left the region, the too cold to glow; and who went astray."""

# pyright: reportInvalidTypeForm=false, reportOptionalCall=false, reportIndexIssue=false

from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..errors import RunError
from ..hints import rolled
from .attributes import Columns
from .kernels import FEW, lowest_bit
from .view import View

_NOBODY = 2**31 - 1
_FAR = 1e18  # [m]; whoever is farther has blown up


def marks(columns: Columns) -> Any:
    """Return a field for who is dead: bit l of entry b stands for the particle in lane l of block b."""
    return ti.field(ti.i32, columns.padded // backend.current().lanes)


@ti.data_oriented
class Mortality:
    """Marks the dead of one group.

    Arguments:
        view: reads the particles.
        region: where particles may be (`contains(x)`), or None.
        frost: tells the temperature [K] below which a dot shows nothing, `coldest(camera, size, x)`, a `@ti.func`; None where
            nobody dies of cold.
        ages: whether there are lifetimes.
        dead: `marks` of the columns, or of the whole that they are a part of; its own by default.
        vectorised: whether to look at a block's lanes together; by default if there can be many particles.
    """

    def __init__(
        self,
        columns: Columns,
        view: View,
        *,
        region: Any,
        frost: Any,
        ages: bool,
        dead: Any = None,
        vectorised: bool | None = None,
    ):
        self.columns, self.view, self.ages = columns, view, ages
        self.frost: Any = frost
        self.region: Any = None if region is None else view.parameters.bind(region)
        self.bounded, self.freezes = region is not None, frost is not None
        self.kills = ages or self.bounded or self.freezes
        self.lanes = backend.current().lanes
        self.vectorised = self.lanes > 1 and (columns.padded > FEW if vectorised is None else vectorised)
        self.serial = backend.current().in_one_thread(columns.padded)
        self.dead = marks(columns) if self.kills and dead is None else dead

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
        ti.loop_config(serialize=ti.static(self.serial))
        for block in range((count + self.lanes - 1) // self.lanes):
            rolled(self.columns["id"][0])
            start = self.columns.first + block * self.lanes
            dead, lost = self._verdicts(start, ti.min(count - block * self.lanes, self.lanes), t, camera)
            if ti.static(self.kills):
                self.dead[ti.static(self.columns.first // self.lanes) + block] = dead
            while dead != 0:
                died += 1
                dead &= dead - 1
            while lost != 0:
                ti.atomic_min(astray, self.columns["id"][0][start + lowest_bit(lost)])
                lost &= lost - 1
        return ti.Vector([died, astray])

    @ti.func
    def _verdicts(self, start, count, t, camera: ti.template()):
        """Return who is dead and who went astray of the block that begins with particle `start`, a bit for each lane."""
        dead, lost = 0, 0
        if ti.static(self.vectorised):
            # Ages first, as they are differences in f64, of which half as many fit a vector. The loops over the lanes only
            # add up: a store to a field inside would stop their vectorisation.
            ages = ti.Vector([0.0] * self.lanes)
            for lane in range(self.lanes):
                ages[lane] = self.view.age(start + lane, t)
            for lane in range(self.lanes):
                bit = ti.select(lane < count, 1 << lane, 0)
                dead |= bit * self._is_dead(start + lane, ages[lane], camera)
                lost |= bit * self._is_lost(start + lane, ages[lane])
        else:
            # counts in powers of two: the compiler would unroll and vectorise any other loop
            i, bit = start, 1
            while bit < 1 << count:
                age = self.view.age(i, t)
                dead |= bit * self._is_dead(i, age, camera)
                lost |= bit * self._is_lost(i, age)
                i, bit = i + 1, bit << 1
        return dead, lost

    @ti.func
    def _is_lost(self, i, age):
        # A sum keeps a NaN, where max() would drop it.
        away, speed = ti.abs(self.view.position(i)), ti.abs(self.view.velocity(i))
        reach = away[0] + away[1] + away[2] + speed[0] + speed[1] + speed[2]
        if ti.static("T" in self.columns):
            reach += ti.abs(self.view.temperature_at(i, age))
        return ti.select(ti.math.isnan(reach) or reach > _FAR, 1, 0)

    @ti.func
    def _is_dead(self, i, age, camera: ti.template()):
        x, dead = self.view.position(i), 0
        if ti.static(self.ages):
            dead |= ti.select(age >= self.view.lifetime(i), 1, 0)
        if ti.static(self.bounded):
            dead |= ti.select(self.region.contains(x), 0, 1)
        if ti.static(self.freezes):
            dead |= ti.select(self.view.temperature_at(i, age) < self.frost.coldest(camera, self.view.size(i), x), 1, 0)
        return dead
