"""What a spring mesh looks like: springs as lines of light, vertices as dots."""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportOptionalCall=false

import math
from typing import Annotated, Any, Literal

import numpy as np
import taichi as ti
from pydantic import Field

from ..errors import InputError
from ..spec import Finite, NonNegative, Positive, spec
from .appearance import Color
from .blackbody import BlackbodyTable
from .dots import Dots
from .look import Look, srgb_decode
from .project import FILTER_SIGMA, NEAR, place

By = Literal["constant", "strain", "speed", "temperature"]


@spec
class Wires:
    """Springs drawn as lines of `width` [m], vertices as dots of diameter `dot` [m]; 0 draws none.

    `by`: what decides the colour. "constant": the first of `colors`. "strain": the relative stretch of a spring, "speed": that
    of its ends [m/s]; `low` is drawn in the first of `colors` (sRGB, 0..1), `high` in the last. "temperature": the glow of a black
    body at the mesh's temperature. `brightness`: the film value of what covers a pixel, 1 being film white; of a black body, its
    emissivity. A line adds the energy of its area to the film, however thin it is and wherever it lies between the pixels.

    Raises:
        InputError: `high` does not exceed `low`.
    """

    by: By = "constant"
    colors: Annotated[tuple[Color, ...], Field(min_length=1)] = ((1.0, 1.0, 1.0),)
    low: Finite = 0.0
    high: Finite = 1.0
    width: NonNegative = 0.002
    dot: NonNegative = 0.0
    brightness: Positive = 1.0

    def __post_init__(self) -> None:
        if not self.high > self.low:
            raise InputError(f"Wires.high = {self.high:g}: must be above low = {self.low:g}")

    def stops(self, look: Look, temperature: float | None) -> np.ndarray:
        """Return the colours from `low` to `high`, linear film values, float32 (n, 3); `temperature` [K] of the mesh now."""
        if self.by == "temperature":
            table = BlackbodyTable.build(adaptation=look.adaptation())
            stops = look.exposure * table.lookup(np.array([0.0 if temperature is None else temperature]))
        else:
            stops = srgb_decode(np.array(self.colors, float))[: 1 if self.by == "constant" else None]
        return (self.brightness * stops).astype(np.float32)


@ti.data_oriented
class WireProjector:
    """Fills `Dots` with the lines and dots of a mesh.

    `view` reads it: `position(i)`, `velocity(i)` of a vertex, `ends(j)`, `strain(j)`, `whole(j)` of a spring,
    `vertex_count` and `spring_count`.
    """

    def __init__(self, view: Any, wires: Wires, look: Look):
        self.view, self.wires, self.look = view, wires, look

    def draw(self, film: Any, dots: Dots, *, temperature: float | None, shutter: float, camera: np.ndarray) -> None:
        """Add the mesh to the film; `shutter` [s] for the streaks of the dots."""
        stops, wires = self.wires.stops(self.look, temperature), self.wires
        scale = np.array([wires.width, wires.dot, wires.low, 1.0 / (wires.high - wires.low)], np.float32)
        for count, project, wanted in (
            (self.view.spring_count, self._lines, wires.width),
            (self.view.vertex_count, self._dots, wires.dot),
        ):
            for first in range(0, count if wanted > 0 else 0, dots.capacity):
                batch = min(dots.capacity, count - first)
                project(dots, first, batch, shutter, camera, stops, scale)
                film.add(dots, batch)

    @ti.func
    def _color(self, value, stops: ti.template(), scale: ti.template()):
        last = ti.cast(stops.shape[0] - 1, ti.f32)
        s = ti.math.clamp((value - scale[2]) * scale[3], 0.0, 1.0) * last
        i = ti.cast(s, ti.i32)
        j, w = ti.min(i + 1, stops.shape[0] - 1), s - ti.cast(i, ti.f32)
        return ti.Vector([stops[i, c] * (1.0 - w) + stops[j, c] * w for c in ti.static(range(3))])

    @ti.func
    def _write(self, dots: ti.template(), j, u, v, du, dv, sigma, energy):
        dots.u[j], dots.v[j], dots.du[j], dots.dv[j], dots.sigma[j] = u, v, du, dv, sigma
        dots.r[j], dots.g[j], dots.b[j] = energy[0], energy[1], energy[2]

    @ti.kernel
    def _lines(
        self,
        dots: ti.template(),
        first: ti.i32,
        count: ti.i32,
        shutter: ti.f32,
        camera: ti.types.ndarray(dtype=ti.f32, ndim=1),
        stops: ti.types.ndarray(dtype=ti.f32, ndim=2),
        scale: ti.types.ndarray(dtype=ti.f32, ndim=1),
    ):
        for j in range(count):
            a, b = self.view.ends(first + j)
            xa, xb = ti.cast(self.view.position(a), ti.f32), ti.cast(self.view.position(b), ti.f32)
            value = ti.cast(0.0, ti.f32)
            if ti.static(self.wires.by == "strain"):
                value = ti.cast(self.view.strain(first + j), ti.f32)
            if ti.static(self.wires.by == "speed"):
                value = 0.5 * ti.cast(self.view.velocity(a).norm() + self.view.velocity(b).norm(), ti.f32)
            # What lies behind the pin-hole is cut off.
            forward = ti.Vector([camera[9], camera[10], camera[11]])
            eye = ti.Vector([camera[0], camera[1], camera[2]])
            za, zb = (xa - eye).dot(forward), (xb - eye).dot(forward)
            seen = ti.max(za, zb) > NEAR and self.view.whole(first + j)
            if za < NEAR:
                xa = xb + (xa - xb) * ((zb - NEAR) / ti.max(zb - za, 1e-12))
            elif zb < NEAR:
                xb = xa + (xb - xa) * ((za - NEAR) / ti.max(za - zb, 1e-12))
            da, ua, va = place(camera, xa)
            db, ub, vb = place(camera, xb)
            width = scale[0] * camera[12] / ti.sqrt(da * db)
            length = ti.sqrt((ub - ua) ** 2 + (vb - va) ** 2)
            sigma = ti.select(seen, ti.sqrt(ti.static(FILTER_SIGMA**2) + width * width / 12.0), 0.0)
            self._write(dots, j, ua, va, ub - ua, vb - va, sigma, width * length * self._color(value, stops, scale))

    @ti.kernel
    def _dots(
        self,
        dots: ti.template(),
        first: ti.i32,
        count: ti.i32,
        shutter: ti.f32,
        camera: ti.types.ndarray(dtype=ti.f32, ndim=1),
        stops: ti.types.ndarray(dtype=ti.f32, ndim=2),
        scale: ti.types.ndarray(dtype=ti.f32, ndim=1),
    ):
        for j in range(count):
            x = ti.cast(self.view.position(first + j), ti.f32)
            velocity = ti.cast(self.view.velocity(first + j), ti.f32)
            value = ti.cast(0.0, ti.f32)
            if ti.static(self.wires.by == "speed"):
                value = velocity.norm()
            depth, u, v = place(camera, x)
            depth2, u2, v2 = place(camera, x - shutter * velocity)
            near = ti.min(depth, depth2) <= NEAR
            diameter = scale[1] * camera[12] / depth
            sigma = ti.select(depth > NEAR, ti.sqrt(ti.static(FILTER_SIGMA**2) + diameter * diameter / 16.0), 0.0)
            energy = ti.static(math.pi / 4) * diameter * diameter * self._color(value, stops, scale)
            self._write(dots, j, u, v, ti.select(near, 0.0, u2 - u), ti.select(near, 0.0, v2 - v), sigma, energy)
