"""The bare loop that the engine is held against: one octave of curl noise, an unrolled tableau, nothing else.

No births, no deaths, no cooling, no frame clamp, coefficients as compile-time constants, blocks of 32 lanes: what a
hand-written kernel for just this work reaches on the same machine in the same run.
"""

import time

import numpy as np
import taichi as ti

TABLEAUX = {
    "midpoint": (((), (0.5,)), (0.0, 1.0)),
    "rk4": (((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}


@ti.func
def corner_hash(i, j, k):
    h = ti.cast(i, ti.u32) * ti.u32(0x8DA6B343) ^ ti.cast(j, ti.u32) * ti.u32(0xD8163841)
    h ^= ti.cast(k, ti.u32) * ti.u32(0xCB1AB31F)
    h = (h ^ (h >> 16)) * ti.u32(0x7FEB352D)
    h = (h ^ (h >> 15)) * ti.u32(0x846CA68B)
    return h ^ (h >> 16)


@ti.func
def curl_noise(p):
    """Return the curl of one octave of gradient noise: the package's formula, on purpose not its code."""
    f = ti.floor(p)
    c, r = ti.cast(f, ti.i32), p - f
    u = r * r * r * (r * (r * 6.0 - 15.0) + 10.0)
    du = 30.0 * r * r * (r * (r - 2.0) + 1.0)
    xy = xz = yx = yz = zx = zy = 0.0
    for corner in ti.static(range(8)):
        ox, oy, oz = ti.static(corner & 1, (corner >> 1) & 1, corner >> 2)
        h = corner_hash(c[0] + ox, c[1] + oy, c[2] + oz)
        a = [ti.cast((h >> (10 * d)) & 1023, ti.i32) * (1 / 512) - 1.0 for d in ti.static(range(3))]
        d = [r[0] - ox, r[1] - oy, r[2] - oz]
        w = [o * u[i] + (1 - o) * (1 - u[i]) for i, o in ti.static(enumerate((ox, oy, oz)))]
        g = [(2 * o - 1) * du[i] for i, o in ti.static(enumerate((ox, oy, oz)))]
        all_w = w[0] * w[1] * w[2]
        n = [a[i] * d[0] + a[(i + 1) % 3] * d[1] + a[(i + 2) % 3] * d[2] for i in ti.static(range(3))]
        gx, gy, gz = g[0] * w[1] * w[2], w[0] * g[1] * w[2], w[0] * w[1] * g[2]
        xy += gy * n[0] + all_w * a[1]
        xz += gz * n[0] + all_w * a[2]
        yx += gx * n[1] + all_w * a[1]
        yz += gz * n[1] + all_w * a[0]
        zx += gx * n[2] + all_w * a[2]
        zy += gy * n[2] + all_w * a[0]
    return ti.Vector([zy - yz, xz - zx, yx - xy])


@ti.data_oriented
class Bare:
    """`count` points stepped through curl noise."""

    def __init__(self, name: str, count: int, *, lanes: int = 32):
        self.a, self.b = TABLEAUX[name]
        self.count, self.lanes = count, lanes
        self.x = [ti.field(ti.f32, count) for _ in range(3)]
        start = np.random.default_rng(0).random((3, count), np.float32) * 8
        for d in range(3):
            self.x[d].from_numpy(start[d])

    @ti.func
    def step(self, dt, x):
        k = [x * 0.0 for _ in range(len(self.b))]
        for s in ti.static(range(len(self.b))):
            z = x
            for j in ti.static(range(s)):
                if ti.static(self.a[s][j] != 0.0):
                    z += self.a[s][j] * dt * k[j]
            k[s] = curl_noise(z)
        for j in ti.static(range(len(self.b))):
            if ti.static(self.b[j] != 0.0):
                x += self.b[j] * dt * k[j]
        return x

    @ti.kernel
    def advance(self, dt: ti.f32, steps: ti.i32):
        for b in range(self.count // self.lanes):
            block = [ti.Vector([0.0] * self.lanes) for _ in range(3)]
            for lane in range(self.lanes):
                for d in ti.static(range(3)):
                    block[d][lane] = self.x[d][b * self.lanes + lane]
            for _ in range(steps):
                for lane in range(self.lanes):
                    x = self.step(dt, ti.Vector([block[0][lane], block[1][lane], block[2][lane]]))
                    for d in ti.static(range(3)):
                        block[d][lane] = x[d]
            for lane in range(self.lanes):
                for d in ti.static(range(3)):
                    self.x[d][b * self.lanes + lane] = block[d][lane]

    def rate(self, steps: int = 4) -> float:
        """Run once; return particle-steps per second."""
        start = time.perf_counter()
        self.advance(1e-3, steps)
        ti.sync()
        return steps * self.count / (time.perf_counter() - start)
