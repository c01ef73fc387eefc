"""Contact of vertices with colliders: when it happens within a step, what it does to a velocity, and how it comes to rest.

Between the ends of a step a vertex follows the cubic through both positions and velocities, exact in free fall. Where it enters a
collider the normal velocity is turned back by the restitution, the tangential one loses what Coulomb's friction takes. A ball
bounces infinitely often before it rests: a bounce too slow to carry it through the rest of a step ends at once. A resting vertex
is pushed back by just the normal force that it presses with, which does no work.
"""

# pyright: reportInvalidTypeForm=false, reportArgumentType=false, reportIndexIssue=false, reportAttributeAccessIssue=false
# pyright: reportOptionalSubscript=false

from collections.abc import Sequence
from typing import Any

import numpy as np
import taichi as ti

from .. import backend
from ..physics.colliders import Surface
from ..systems.spring_mesh import SpringMesh

_BOUNCES = 8  # of one vertex in one step; the last one is without restitution


@ti.data_oriented
class Contact:
    """The colliders of a mesh.

    Arguments:
        colliders: objects with `signed_distance(x)` and `normal(x)`, see `physics.colliders`.
        radius: at which distance [m] a vertex touches.

    `touching`: for each vertex the number of the collider that it rests on, counted from 1, or 0.
    """

    def __init__(self, system: SpringMesh, colliders: Sequence[Any], *, radius: float):
        self.system, self.radius = system, radius
        bind = system.parameters.bind
        # a room is six walls: who rests on its floor must still meet the others
        walls = [wall for collider in colliders for wall in getattr(collider, "walls", (collider,))]
        pairs = [(bind(wall), bind(Surface.of(wall))) for wall in walls]
        # (number, shape, surface); the number is what `touching` holds
        self.colliders = [(n, *pair) for n, pair in enumerate(pairs, start=1)]
        self.any = bool(colliders)
        self.touching = ti.field(ti.i32, system.padded) if self.any else None
        f64 = backend.current().precision == "f64"
        self.halvings = 50 if f64 else 24
        self.slack = 1e-9 if f64 else 1e-5  # [m]; nearer than this is on the surface

    def touches(self) -> bool:
        """Return whether a vertex rests on a collider."""
        return self.touching is not None and bool(self.touching.to_numpy().any())

    @ti.func
    def _state(self, fields: ti.template(), i):
        x = ti.Vector([fields[d][i] for d in ti.static(range(3))])
        return x, ti.Vector([fields[3 + d][i] for d in ti.static(range(3))])

    @ti.func
    def _put(self, i, x, v):
        for d in ti.static(range(3)):
            self.system.z[d][i] = x[d]
            self.system.z[3 + d][i] = v[d]

    @ti.func
    def _distance(self, shape: ti.template(), x):
        return shape.signed_distance(x) - ti.static(self.radius)

    @ti.func
    def _path(self, s, h, x0, v0, x1, v1):
        """Return the cubic through both ends of a step at the fraction `s` of it (Hermite)."""
        a, b = s * s * (3.0 - 2.0 * s), s * (1.0 - s)
        return x0 + a * (x1 - x0) + h * b * ((1.0 - s) * v0 - s * v1)

    @ti.func
    def _entry(self, shape: ti.template(), surface: ti.template(), t, h, x0, v0, x1, v1):
        """Return the fraction of the step t..t+h at which the path enters the collider; 2 if it does not."""
        # as the collider sees it
        u = surface.velocity
        y0, y1, w0, w1 = x0 - t * u, x1 - (t + h) * u, v0 - u, v1 - u
        s = ti.cast(2.0, float)
        if self._distance(shape, y1) < 0.0:
            low, high = ti.cast(0.0, float), ti.cast(1.0, float)
            for _ in range(self.halvings):
                middle = 0.5 * (low + high)
                if self._distance(shape, self._path(middle, h, y0, w0, y1, w1)) < 0.0:
                    high = middle
                else:
                    low = middle
            s = low
        return s

    @ti.func
    def near(self, block, t):
        """Return whether a vertex of a block rests on a collider, or is at one: where none is, nothing else here does anything."""
        found = 0
        for lane in range(self.system.lanes):
            i = block * self.system.lanes + lane
            x = ti.Vector([self.system.z[d][i] for d in ti.static(range(3))])
            found |= self.touching[i]
            for _n, shape, surface in ti.static(self.colliders):
                # more than any of them asks for: the compiler may round otherwise there
                found |= ti.select(self._distance(shape, x - t * surface.velocity) < ti.static(8 * self.slack), 1, 0)
        return found != 0

    @ti.func
    def entry(self, i, t, h):
        """Return the fraction of the step z0 -> z at which vertex `i` first enters a collider that it does not rest on, or 2."""
        x0, v0 = self._state(self.system.z0, i)
        x1, v1 = self._state(self.system.z, i)
        first = ti.cast(2.0, float)
        if self.system.inverse_mass[i] > 0.0:
            for n, shape, surface in ti.static(self.colliders):
                if self.touching[i] != n:
                    first = ti.min(first, self._entry(shape, surface, t, h, x0, v0, x1, v1))
        return first

    @ti.func
    def _bounced(self, surface: ti.template(), normal, v, restitution):
        """Return v after an impulse along the normal (restitution) and one across it (Coulomb); v itself where it leaves."""
        w = v - surface.velocity
        wn = w.dot(normal)
        result = v
        if wn < 0.0:
            across = w - wn * normal
            speed = across.norm()
            lost = ti.min(surface.friction * (1.0 + restitution) * -wn, speed)
            result = surface.velocity + across * (1.0 - lost / ti.max(speed, 1e-30)) - restitution * wn * normal
        return result

    @ti.func
    def impulse(self, i, t, slow):
        """Bounce vertex `i` where it is on a surface and moves into it; slower than `slow` [m/s] it rests. Return 1 if it did."""
        done = 0
        if self.system.inverse_mass[i] > 0.0:
            for n, shape, surface in ti.static(self.colliders):
                x, v = self._state(self.system.z, i)
                y = x - t * surface.velocity
                if self.touching[i] != n and self._distance(shape, y) < ti.static(self.slack):
                    normal = shape.normal(y)
                    vn = (v - surface.velocity).dot(normal)
                    if vn <= 0.0:
                        done = 1
                        bounce = surface.restitution
                        if -vn * bounce < slow:
                            bounce = ti.cast(0.0, float)
                            self.touching[i] = n
                        self._put(i, x, self._bounced(surface, normal, v, bounce))
        return done

    @ti.func
    def settle(self, i, t):
        """Keep a resting vertex on its surface, and let go of one that left it."""
        for n, shape, surface in ti.static(self.colliders):
            if self.touching[i] == n:
                x, v = self._state(self.system.z, i)
                y = x - t * surface.velocity
                d, normal = self._distance(shape, y), shape.normal(y)
                vn = (v - surface.velocity).dot(normal)
                if d > ti.static(self.slack) and vn > 0.0:
                    self.touching[i] = 0
                else:
                    self._put(i, x - ti.min(d, 0.0) * normal, v - ti.min(vn, 0.0) * normal)

    @ti.func
    def stop(self, i, t):
        """Stop vertex `i` where an implicit stage has led it to a surface, and leave it there; return 1 if it arrived just now."""
        done = 0
        if self.system.inverse_mass[i] > 0.0:
            for n, shape, surface in ti.static(self.colliders):
                x, v = self._state(self.system.z, i)
                y = x - t * surface.velocity
                d, normal = self._distance(shape, y), shape.normal(y)
                vn = (v - surface.velocity).dot(normal)
                if d > ti.static(4 * self.slack):
                    if self.touching[i] == n:
                        self.touching[i] = 0
                else:
                    if self.touching[i] == 0:
                        self.touching[i], done = n, 1
                    self._put(i, x - ti.min(d, 0.0) * normal, v - ti.min(vn, 0.0) * normal)
        return done

    @ti.func
    def resolve(self, i, t, h):
        """Bounce vertex `i` by itself within the step t..t+h from z0 to z; return 1 if it did.

        What is left of the step is free flight under the mean acceleration of the step.
        """
        done = 0
        self.settle(i, t + h)
        if self.system.inverse_mass[i] > 0.0:
            x0, v0 = self._state(self.system.z0, i)
            x1, v1 = self._state(self.system.z, i)
            left, bounces, more = h, 0, 1
            a = (v1 - v0) / h
            while more > 0:
                more = 0
                first, which = ti.cast(2.0, float), 0
                for n, shape, surface in ti.static(self.colliders):
                    if self.touching[i] != n:
                        s = self._entry(shape, surface, t + h - left, left, x0, v0, x1, v1)
                        if s < first:
                            first, which = s, n
                if which > 0:
                    done, bounces = 1, bounces + 1
                    x, v = self._path(first, left, x0, v0, x1, v1), v0 + first * left * a
                    left *= 1.0 - first
                    for n, shape, surface in ti.static(self.colliders):
                        if which == n:
                            normal = shape.normal(x - (t + h - left) * surface.velocity)
                            e, push = surface.restitution, ti.max(-a.dot(normal), 0.0)
                            if (-e * (v - surface.velocity).dot(normal) < push * h) | (bounces >= _BOUNCES):
                                e = ti.cast(0.0, float)
                                self.touching[i] = n
                                a += push * normal
                            v = self._bounced(surface, normal, v, e)
                    x0, v0 = x, v
                    x1, v1 = x + left * v + 0.5 * left * left * a, v + left * a
                    more = ti.select(bounces < 2 * _BOUNCES, 1, 0)
                    self._put(i, x1, v1)
            if bounces > 0:
                self.settle(i, t + h)
        return done

    @ti.kernel
    def _nearest(
        self, x: ti.types.ndarray(ndim=2), t: float, found: ti.types.ndarray(ndim=2), values: ti.types.ndarray(ndim=1)
    ):
        ti.static(self.system.parameters.read_from(values))
        for i in range(self.system.count):
            at = ti.Vector([x[i, d] for d in ti.static(range(3))])
            found[i, 0] = ti.math.inf
            for _n, shape, surface in ti.static(self.colliders):
                y = at - t * surface.velocity
                distance = self._distance(shape, y)
                if distance < found[i, 0]:
                    normal = shape.normal(y)
                    found[i, 0], found[i, 1] = distance, surface.friction
                    for d in ti.static(range(3)):
                        found[i, 2 + d], found[i, 5 + d] = normal[d], surface.velocity[d]

    def nearest(self, x: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return of the nearest collider of each of the points `x` [m], (n, 3): distance, friction, normal, velocity."""
        kind = self.system.parameters.array.dtype
        found = np.zeros((self.system.count, 8), kind)
        self._nearest(np.ascontiguousarray(x, kind), t, found, self.system.parameters.array)
        return found[:, 0], found[:, 1], found[:, 2:5], found[:, 5:]

    @ti.func
    def press(self, b: ti.template(), block, t, h):
        """Give resting vertices the force of the surface: no acceleration into it, and Coulomb's friction along it."""
        rests = 0
        for lane in range(b.lanes):
            rests |= self.touching[block * b.lanes + lane]
        for lane in range(ti.select(rests != 0, b.lanes, 0)):
            i = block * b.lanes + lane
            if self.touching[i] > 0:
                x = ti.Vector([b.z[d][lane] for d in ti.static(range(3))])
                v = ti.Vector([b.z[3 + d][lane] for d in ti.static(range(3))])
                a = ti.Vector([b.a[d][lane] for d in ti.static(range(3))])
                for n, shape, surface in ti.static(self.colliders):
                    if self.touching[i] == n:
                        normal = shape.normal(x - t * surface.velocity)
                        push = ti.max(-a.dot(normal), 0.0)
                        a += push * normal
                        # what would stop it within the step, but no more than the surface can hold
                        w = v - surface.velocity
                        wanted = (w - w.dot(normal) * normal) / h + a - a.dot(normal) * normal
                        a -= wanted * ti.min(surface.friction * push / ti.max(wanted.norm(), 1e-30), 1.0)
                for d in ti.static(range(3)):
                    b.a[d][lane] = a[d]
