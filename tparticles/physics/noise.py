"""Curl noise: a turbulent flow that is divergence-free by construction.

u = curl psi of a vector potential made of gradient noise (Bridson, Hourihan, Nordenstam, "Curl-noise for procedural fluid
flow", SIGGRAPH 2007). Each lattice corner hashes to one vector a and adds w(r) a x r to the potential, r from the corner, w
its quintic fade: locally the potential of a uniform flow, so that a lattice point moves with 2 a and the components of
the velocity are uncorrelated. (Three gradients that permute one vector are no cheaper; if they are symmetric, every lattice
point is at rest.) Derivatives are analytic. A distance ramp and the amplitude go inside the potential, so that the flow stays
divergence-free where they vary.
"""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false, reportIndexIssue=false, reportInvalidTypeForm=false

import math
from typing import Annotated

import numpy as np
import taichi as ti
from pydantic import Field

from ..rng import stream_key
from ..spec import Count, Finite, NonNegative, Positive, Seed, Vec3, spec
from .law import Bound, Flow

# One octave of unit lattice and amplitude. Root mean square of |curl psi|: 4.38968 is the exact mean over the cell of the sum
# of squared weights; a component of a has the mean square 1/3, and 8/15 where it swings.
_RMS = math.sqrt(4.38968 / 3)
_RMS_TURNING = math.sqrt(4.38968 * 8 / 15)
# Least upper bounds over the cell and over all |a_i| <= 1 on the spectral norms of what du/dx is made of; samples of the noise
# reach three quarters of the first. p = (-psi_y, psi_x, 0), e the unit vector along z.
_GRADIENT = 21.4  # du/dx
_SLOPE = 8.3  # u e^T + dp/dx
_POTENTIAL = 1.13  # p e^T
_ROOM = 8  # octaves: tables have room for multiples of them, so that fewer or more compile nothing


@ti.func
def _gradient(key, whole, rest, turning: ti.template()):
    """Return the vector of the corner `key`, ten bits of its hash for each component.

    They stand for the centres of 1024 equal cells of (-1, 1), or, `turning`, for waves of the phase `whole` + `rest` [1/1024 of
    their period] that are so far ahead: with s the distance from the middle of the period, in half periods, 4 s (1 - |s|), the
    C1 stand-in for sin(pi s). The whole part is added to the bits before they are masked, which wraps the phase for nothing.
    """
    h = (key ^ (key >> 16)) * ti.u32(0x7FEB352D)
    h = (h ^ (h >> 15)) * ti.u32(0x846CA68B)
    h ^= h >> 16
    a = ti.Vector([h, h >> 10, h >> 20])
    if ti.static(turning):
        s = (ti.cast((a + whole) & 1023, ti.i32) + rest) * (1 / 512) - 1.0
        return 4.0 * s * (1.0 - ti.abs(s))
    else:
        return ti.cast(a & 1023, ti.i32) * (1 / 512) - ti.static(1 - 1 / 1024)


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
    levels = 512.0 * (phase - 2.0 * ti.floor(0.5 * phase))
    rest = levels - ti.floor(levels)
    whole = ti.cast(ti.cast(levels, ti.i32), ti.u32)
    # at the lower and the upper corners: weight, its derivative, distance, and what the hash takes of the coordinate
    weight, slope, offset = [1.0 - u, u], [-du, du], [r, r - 1.0]
    primes = ti.Vector([ti.u32(0x8DA6B343), ti.u32(0xD8163841), ti.u32(0xCB1AB31F)], ti.u32)
    lower = ti.cast(c, ti.u32) * primes
    key = [lower, lower + primes]
    psi, curl = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
    for ox, oy in ti.static(((0, 0), (1, 0), (0, 1), (1, 1))):
        dx, wx, gx = offset[ox][0], weight[ox][0], slope[ox][0]
        dy, wy, gy = offset[oy][1], weight[oy][1], slope[oy][1]
        # what the two corners of an edge along z share
        w2, gx2, gy2 = wx * wy, gx * wy, wx * gy
        s2 = gx2 * dx + gy2 * dy + 2.0 * w2
        edge = key[ox][0] ^ key[oy][1]
        for oz in ti.static(range(2)):
            a = _gradient(edge ^ (key[oz][2] ^ seed), whole, rest, turning)
            d = ti.Vector([dx, dy, offset[oz][2]])
            wz, gz = weight[oz][2], slope[oz][2]
            # curl(w a x d) = grad w x (a x d) + 2 w a = a (grad w . d + 2 w) - d (grad w . a), d from the corner
            along = s2 * wz + w2 * gz * d[2]
            across = (gx2 * a[0] + gy2 * a[1]) * wz + w2 * gz * a[2]
            curl += a * along - d * across
            if ti.static(with_value):
                psi += (w2 * wz) * (a.yzx * d.zxy - a.zxy * d.yzx)  # a x d
    return psi, curl


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

    def derived(self) -> dict[str, np.ndarray | float | bool]:
        """Return what each octave needs: lattice frequency [1/m], potential [m^2/s], half periods per second, seed, drift, ramp.

        `passes` is their number: the stepper loops over them outside its lane loop, and the code is compiled once.
        """
        return _with_room(self.tables())

    def tables(self) -> dict[str, np.ndarray | bool]:
        """Return `derived` without room for others."""
        o = np.arange(self.octaves)
        frequency = self.lacunarity**o / self.length
        shared = {"drift_x": self.drift[0], "drift_y": self.drift[1], "drift_z": self.drift[2]}
        shared |= {"height": self.ramp, "floor": self.ground}
        return {
            "frequency": frequency,
            "strength": self.speed * self.gain**o / frequency / self._rms(),
            "rate": self.lacunarity ** (o * 2 / 3) * (2 / self.period if self.period else 0.0),
            # 24 bits: exact as a real of either precision
            "octave_seed": np.array([stream_key(self.seed, f"octave {i}") >> 8 for i in o], float),
            "turning": self.period > 0,
            "ramped": self.ramp > 0,
            **{name: np.full(self.octaves, value, float) for name, value in shared.items()},
        }

    def as_octaves(self) -> "Octaves":
        """Return the law that kernels have of this noise: the same for all that swing, or have a ramp, alike."""
        return Octaves(self.tables())

    @ti.func
    def velocity_pass(self, o, t, x):
        """Return the velocity [m/s] of octave `o`."""
        f = self.frequency[o]
        p = (x - t * ti.Vector([self.drift_x[o], self.drift_y[o], self.drift_z[o]])) * f
        psi, curl = potential(p, ti.cast(self.octave_seed[o], ti.u32), t * self.rate[o], self.turning, self.ramped)
        u = (self.strength[o] * f) * curl
        if ti.static(self.ramped):
            # curl(s psi) = s curl psi + grad s x psi, s = smoothstep((z - ground) / ramp)
            s = ti.math.clamp((x[2] - self.floor[o]) / self.height[o], 0.0, 1.0)
            ds = 30.0 * s * s * (s * (s - 2.0) + 1.0) / self.height[o] * self.strength[o]
            s = s * s * s * (s * (s * 6.0 - 15.0) + 10.0)
            u = s * u + ds * ti.Vector([-psi[1], psi[0], 0.0])
        return u

    def jacobian_bound(self) -> Bound:
        """Return the octaves' bounds on the spectral norm of du/dx, added up.

        On the ramp s(z): d(s u + s' p) = s du/dx + s' (u e^T + dp/dx) + s'' p e^T, at the worst height.
        """
        o = np.arange(self.octaves)
        frequency = self.lacunarity**o / self.length
        rates = _GRADIENT * frequency
        if self.ramp:
            h = np.linspace(0.0, 1.0, 101)[:, None]
            s, slope = h**3 * (h * (h * 6 - 15) + 10), 30 * (h * (h - 1)) ** 2 / self.ramp
            curvature = np.abs(60 * h * (h * (2 * h - 3) + 1)) / self.ramp**2
            rates = np.max(s * rates + slope * _SLOPE + curvature * _POTENTIAL / frequency, axis=0)
        rate = float(np.sum(self.speed * self.gain**o / self._rms() * rates))
        return Bound(real=rate, imaginary=rate)

    def _rms(self) -> float:
        return _RMS_TURNING if self.period else _RMS


class Octaves:
    """The octaves of a noise or of several: a kernel has the code of an octave once."""

    velocity_pass = CurlNoise.velocity_pass

    def __init__(self, tables: dict[str, np.ndarray | bool]):
        vars(self).update(tables)

    def derived(self) -> dict[str, np.ndarray | float | bool]:
        """Return what `CurlNoise.derived` does."""
        return _with_room(vars(self))

    def joined(self, other: object) -> "Octaves | None":
        """Return one law for these octaves and others, None if it has none or if but one of them swings or has a ramp."""
        if not isinstance(other, Octaves):
            return None
        ours, theirs = vars(self), vars(other)
        if any(ours[flag] != theirs[flag] for flag in ("turning", "ramped")):
            return None
        return Octaves(
            {name: np.append(v, theirs[name]) if isinstance(v, np.ndarray) else v for name, v in ours.items()}
        )


def _with_room(tables: dict[str, np.ndarray | bool]) -> dict[str, np.ndarray | float | bool]:
    octaves = len(np.atleast_1d(tables["frequency"]))
    padding = (0, -octaves % _ROOM)
    found = {name: np.pad(v, padding) if isinstance(v, np.ndarray) else v for name, v in tables.items()}
    return {"passes": float(octaves), **found}
