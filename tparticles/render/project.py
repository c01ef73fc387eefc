"""From particles to dots on the film: perspective, footprint, streak, colour."""
# pyright: reportInvalidTypeForm=false

import math
from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from .appearance import Appearance, Glow
from .blackbody import BlackbodyTable
from .dots import Dots
from .look import Look

# Standard deviation [px] of the pixel filter: a dot smaller than a pixel still has a smooth, alias-free footprint.
FILTER_SIGMA = 0.55
NEAR = 1e-3  # [m]; nothing nearer to the pin-hole is drawn


@ti.func
def place(c: ti.template(), x):
    """Return (depth [m], u [px], v [px]) of a point seen by the camera row `c`; v grows downward."""
    d = x - ti.Vector([c[0], c[1], c[2]])
    depth = d[0] * c[9] + d[1] * c[10] + d[2] * c[11]
    scale = c[12] / ti.max(depth, NEAR)
    u = c[13] + scale * (d[0] * c[3] + d[1] * c[4] + d[2] * c[5])
    v = c[14] - scale * (d[0] * c[6] + d[1] * c[7] + d[2] * c[8])
    return ti.max(depth, NEAR * 0.5), u, v


@ti.data_oriented
class Projector:
    """Fills `Dots` with the particles of one group.

    A particle is a disc of its diameter D: energy = colour * area on the film [px^2], spread by a Gaussian of the disc's own
    variance (D/4)^2 plus the pixel filter's. While the shutter is open the dot moves from x - v tau to x; a particle born
    meanwhile has its energy in proportion.

    Arguments:
        view: reads particles, which lie in `columns`: `position(i)`, `velocity(i)`, `temperature(i, t)`, `size(i)`,
            `age(i, t)`, `lifetime(i)`.
        appearance, look: what they look like.
    """

    def __init__(self, view: Any, appearance: Appearance, look: Look):
        self.view = view
        self.shader = view.parameters.bind(appearance.prepare(look))
        self.appearance = view.parameters.bind(appearance)
        if isinstance(appearance, Glow):
            self.frost = view.parameters.table(frost_table(look, appearance.emissivity))
        self.fades = appearance.fade_in > 0 or appearance.fade_out > 0
        self.serial = backend.current().in_one_thread(view.columns.padded)

    @ti.kernel
    def project(
        self,
        dots: ti.template(),
        first: ti.i32,
        count: ti.i32,
        t: ti.f64,
        shutter: ti.f32,
        camera: ti.types.ndarray(dtype=ti.f32, ndim=1),
        values: ti.types.ndarray(ndim=1),
    ):
        """Write particles first..first+count-1 at time `t` [s] into dots 0..count-1; `shutter` [s] before t it opened."""
        ti.static(self.view.parameters.read_from(values))
        ti.loop_config(serialize=ti.static(self.serial))
        for j in range(count):
            i = self.view.columns.first + first + j
            age = ti.cast(self.view.age(i, t), ti.f32)
            size = ti.cast(self.view.size(i), ti.f32) + self.appearance.growth * age
            x = ti.cast(self.view.position(i), ti.f32)
            depth, u, v = place(camera, x)
            open_for = ti.min(shutter, ti.max(age, 0.0))
            depth2, u2, v2 = place(camera, x - open_for * ti.cast(self.view.velocity(i), ti.f32))
            diameter = size * camera[12] / depth
            energy = ti.static(math.pi / 4) * diameter * diameter * self.shader.color(self.view.temperature(i, t), age)
            if shutter > 0.0:
                energy *= open_for / shutter
            if ti.static(self.fades):
                energy *= self.fade(age / ti.cast(self.view.lifetime(i), ti.f32))
            dots.u[j], dots.v[j] = u, v
            dots.du[j] = ti.select(depth2 > NEAR, u2 - u, 0.0)
            dots.dv[j] = ti.select(depth2 > NEAR, v2 - v, 0.0)
            dots.sigma[j] = ti.select(depth > NEAR, self.sigma(diameter), 0.0)
            dots.r[j], dots.g[j], dots.b[j] = energy[0], energy[1], energy[2]

    @ti.func
    def sigma(self, diameter):
        """Return the footprint's standard deviation [px] of a disc of `diameter` [px]."""
        return ti.sqrt(ti.static(FILTER_SIGMA**2) + diameter * diameter / 16.0)

    @ti.func
    def fade(self, s):
        """Return smoothstep(s / fade_in) smoothstep((1 - s) / fade_out), s the fraction of the lifetime."""
        a = ti.math.clamp(s / ti.max(self.appearance.fade_in, 1e-6), 0.0, 1.0)
        b = ti.math.clamp((1.0 - s) / ti.max(self.appearance.fade_out, 1e-6), 0.0, 1.0)
        return a * a * (3.0 - 2.0 * a) * b * b * (3.0 - 2.0 * b)

    @ti.func
    def coldest(self, camera: ti.template(), size, x):
        """Return the temperature [K] below which a dot of diameter `size` [m] at `x` [m] shows nothing (`frost_table`)."""
        depth, _u, _v = place(camera, ti.cast(x, ti.f32))
        diameter = ti.cast(size, ti.f32) * camera[12] / depth
        low, high = ti.static(2.0**_FROST_LOW, 2.0**_FROST_HIGH)
        # the bits of a float order like the float: the upper ones are the table's index, the others the weight
        bits = ti.bit_cast(ti.cast(ti.math.clamp(diameter, low, high), ti.f32), ti.i32)
        bits -= ti.static((_FROST_LOW + 127) << 23)
        i = ti.min(bits >> _FROST_SHIFT, ti.static(len(_FROST_NODES) - 2))
        w = ti.cast(bits - (i << _FROST_SHIFT), ti.f32) * ti.static(2.0**-_FROST_SHIFT)
        return self.frost[i] * (1.0 - w) + self.frost[i + 1] * w


# Nodes of the table over the diameter [px]: eight in every power of two.
_FROST_LOW, _FROST_HIGH, _FROST_SHIFT = -12, 12, 20
_FROST_NODES = np.ldexp(1 + np.arange(8) / 8, np.arange(_FROST_LOW, _FROST_HIGH)[:, None]).ravel()
_FROST_NODES = np.append(_FROST_NODES, 2.0**_FROST_HIGH)


def frost_table(look: Look, emissivity: float) -> np.ndarray:
    """Return for each node of the diameter [px] the temperature [K] below which a still dot shows nothing.

    Nothing: its brightest pixel, that of a dot centred on a pixel, stays below half a display step in each channel. Where even
    12000 K shows nothing the answer is 12000, where 500 K shows it is 500.
    """
    table = BlackbodyTable.build(adaptation=look.adaptation())
    T = np.linspace(table.T_MIN, table.T_MAX, 20_000)
    color = look.exposure * emissivity * table.lookup(T).max(axis=-1)
    sigma = np.sqrt(FILTER_SIGMA**2 + _FROST_NODES**2 / 16)
    # peak of the normalised footprint: 1 / sum_i exp(-i^2 / (2 sigma^2)) on each axis; 1 / (sqrt(2 pi) sigma) once it is wide
    taps = np.exp(-0.5 * (np.arange(-8, 9)[:, None] / np.minimum(sigma, 2.0)) ** 2).sum(axis=0)
    axis = np.where(sigma < 2.0, taps, math.sqrt(2 * math.pi) * sigma)
    share = math.pi / 4 * _FROST_NODES**2 / axis**2
    return np.interp(np.log(look.threshold() / share), np.log(color), T)


def camera_row(pose: Any, width: int, height: int) -> np.ndarray:
    """Return what kernels need of a camera pose, float32 (15,).

    Position 0-2, right 3-5, up 6-8, forward 9-11 (unit vectors), focal length [px] 12, film centre [px] 13 and 14.
    """
    axes = np.concatenate([pose.position, pose.right, pose.up, pose.forward])
    return np.array([*axes, pose.focal(height), width / 2, height / 2], np.float32)


def draw(
    projector: Projector, film: Any, dots: Dots, *, count: int, t: float, shutter: float, camera: np.ndarray
) -> None:
    """Add `count` particles to the film, as many at a time as the dot buffers hold; integer sums make the split harmless."""
    for first in range(0, count, dots.capacity):
        batch = min(dots.capacity, count - first)
        projector.project(dots, first, batch, t, shutter, camera, projector.view.parameters.array)
        film.add(dots, batch)
