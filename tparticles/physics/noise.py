"""Curl noise: a turbulent flow that is divergence-free by construction.

u = curl psi of a vector potential made of gradient noise (Bridson, Hourihan, Nordenstam, "Curl-noise for procedural fluid
flow", SIGGRAPH 2007). Each lattice corner hashes to one vector a and adds w(r) a x r to the potential, r from the corner, w
its quintic fade: locally the potential of a uniform flow, so that a lattice point moves with 2 a and the components of
the velocity are uncorrelated. (Three gradients that permute one vector are no cheaper; if they are symmetric, every lattice
point is at rest.) Derivatives are analytic. A distance ramp and the amplitude go inside the potential, so that the flow stays
divergence-free where they vary.
"""

from typing import Annotated

import numpy as np
import taichi as ti
from pydantic import Field

from ..rng import stream_key
from ..spec import Count, Finite, NonNegative, Positive, Seed, Vec3, spec
from .law import Bound, Flow

# Root mean square of |curl psi| for unit amplitude and length, measured over 10^6 points (tests/physics/test_noise.py).
_RMS = 1.0
# Largest Frobenius norm of du/dx for unit amplitude and length, sampled over 10^7 points, with a tenth to spare.
_JACOBIAN = 1.0


@ti.func
def _corner_hash(i, j, k, seed):
    h = ti.cast(i, ti.u32) * ti.u32(0x8DA6B343) ^ ti.cast(j, ti.u32) * ti.u32(0xD8163841)
    h ^= ti.cast(k, ti.u32) * ti.u32(0xCB1AB31F) ^ seed
    h = (h ^ (h >> 16)) * ti.u32(0x7FEB352D)
    h = (h ^ (h >> 15)) * ti.u32(0x846CA68B)
    return h ^ (h >> 16)


@ti.func
def _centred(h):
    """Map ten hash bits to the centres of 1024 equal cells of (-1, 1)."""
    return ti.cast(h & 1023, ti.i32) * (1 / 512) - ti.static(1 - 1 / 1024)


@ti.func
def _swing(s):
    """Return a wave of period 2 with values in [-1, 1]: 4 s (1 - |s|) for s in [-1, 1), the C1 stand-in for sin(pi s)."""
    s -= 2.0 * ti.floor(0.5 * s + 0.5)
    return 4.0 * s * (1.0 - ti.abs(s))


@ti.func
def potential(p, seed, phase, turning: ti.template(), with_value: ti.template()):
    """Return (psi, curl psi) of one octave at lattice coordinates `p`; psi is only filled `with_value`.

    `turning` (compile time) lets the gradients swing with `phase`, a time in units of half periods.
    """
    f = ti.floor(p)
    c = ti.cast(f, ti.i32)
    r = p - f
    # quintic fade: u = r^3 (6 r^2 - 15 r + 10), C2 across cells
    u = r * r * r * (r * (r * 6.0 - 15.0) + 10.0)
    du = 30.0 * r * r * (r * (r - 2.0) + 1.0)
    ux = uy = uz = 0.0
    px = py = pz = 0.0
    for corner in ti.static(range(8)):
        ox, oy, oz = ti.static(corner & 1, (corner >> 1) & 1, corner >> 2)
        h = _corner_hash(c[0] + ox, c[1] + oy, c[2] + oz, seed)
        a0, a1, a2 = _centred(h), _centred(h >> 10), _centred(h >> 20)
        if ti.static(turning):
            a0, a1, a2 = _swing(a0 + phase), _swing(a1 + phase), _swing(a2 + phase)
        dx, dy, dz = r[0] - ox, r[1] - oy, r[2] - oz
        wx = ox * u[0] + (1 - ox) * (1 - u[0])
        wy = oy * u[1] + (1 - oy) * (1 - u[1])
        wz = oz * u[2] + (1 - oz) * (1 - u[2])
        gx, gy, gz = (2 * ox - 1) * du[0] * wy * wz, wx * (2 * oy - 1) * du[1] * wz, wx * wy * (2 * oz - 1) * du[2]
        w = wx * wy * wz
        # n = a x r; curl(w n) = grad w x n + 2 w a
        nx, ny, nz = a1 * dz - a2 * dy, a2 * dx - a0 * dz, a0 * dy - a1 * dx
        w2 = 2.0 * w
        ux += gy * nz - gz * ny + w2 * a0
        uy += gz * nx - gx * nz + w2 * a1
        uz += gx * ny - gy * nx + w2 * a2
        if ti.static(with_value):
            px += w * nx
            py += w * ny
            pz += w * nz
    return ti.Vector([px, py, pz]), ti.Vector([ux, uy, uz])


@spec
class CurlNoise(Flow):
    """Turbulence: u = curl(ramp * sum_o psi_o), octaves of gradient noise.

    Octave o has lattice spacing `length / lacunarity^o` [m] and speed `speed * gain^o` [m/s, root mean square]. The
    pattern is carried along with `drift` [m/s] and its gradients swing with a period of `period` [s] (0: frozen;
    smaller octaves swing faster, by lacunarity^(2/3) each, as in Kolmogorov's cascade). `ramp` [m] makes it vanish at
    the plane z = `ground`: no flow through the ground; 0 switches the ramp off.
    """

    speed: NonNegative = 1.0
    length: Positive = 1.0
    octaves: Annotated[Count, Field(le=16)] = 1
    lacunarity: Annotated[Positive, Field(ge=1)] = 2.0
    gain: NonNegative = 0.5
    drift: Vec3 = (0.0, 0.0, 0.0)
    period: NonNegative = 0.0
    ramp: NonNegative = 0.0
    ground: Finite = 0.0
    seed: Seed = 0

    @property
    def passes(self) -> int:
        """One pass an octave: the stepper loops over them outside its lane loop, and the code is compiled once."""
        return self.octaves

    def derived(self) -> dict[str, np.ndarray | bool]:
        """Return what each octave needs: lattice frequency [1/m], potential [m^2/s], half periods per second, seed."""
        o = np.arange(self.octaves)
        frequency = self.lacunarity**o / self.length
        return {
            "frequency": frequency,
            "strength": self.speed * self.gain**o / frequency / _RMS,
            "rate": self.lacunarity ** (o * 2 / 3) * (2 / self.period if self.period else 0.0),
            # 24 bits: exact as a real of either precision
            "octave_seed": np.array([stream_key(self.seed, f"octave {i}") >> 8 for i in o], float),
            "turning": self.period > 0,
            "ramped": self.ramp > 0,
        }

    @ti.func
    def velocity_pass(self, o, t, x):
        """Return the velocity [m/s] of octave `o`."""
        f = self.frequency[o]
        p = (x - t * self.drift) * f
        psi, curl = potential(p, ti.cast(self.octave_seed[o], ti.u32), t * self.rate[o], self.turning, self.ramped)
        u = (self.strength[o] * f) * curl
        if ti.static(self.ramped):
            # curl(s psi) = s curl psi + grad s x psi, s = smoothstep((z - ground) / ramp)
            s = ti.math.clamp((x[2] - self.ground) / self.ramp, 0.0, 1.0)
            ds = 30.0 * s * s * (s * (s - 2.0) + 1.0) / self.ramp * self.strength[o]
            s = s * s * s * (s * (s * 6.0 - 15.0) + 10.0)
            u = s * u + ds * ti.Vector([-psi[1], psi[0], 0.0])
        return u

    def jacobian_bound(self) -> Bound:
        """Return sampled bounds on the octaves' gradients, added up; the ramp is not counted."""
        o = np.arange(self.octaves)
        rate = float(np.sum(self.speed * (self.gain * self.lacunarity) ** o) / self.length * _JACOBIAN / _RMS)
        return Bound(real=rate, imaginary=rate)
