"""The catalogue of colliders with their exact distances, and what asks them on the device."""

import numpy as np
import taichi as ti
from law_probe import Probe

import tparticles as tp


class Bowl:
    """A collider of a user's own: the inside of a sphere around the origin."""

    def __init__(self, radius):
        self.radius = float(radius)

    @ti.func
    def signed_distance(self, x):
        return self.radius - x.norm()

    @ti.func
    def normal(self, x):
        return -x / x.norm()


def box_outside(x, low, high):
    q = np.maximum(low - x, x - high)
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


def to_segment(x, a, b):
    s = np.clip((x - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return np.linalg.norm(x - a - s[:, None] * (b - a), axis=1)


def tilted(x, slope):
    return (x[:, 2] - 0.2 - x[:, :2] @ slope) / np.sqrt(1 + slope @ slope)


LOW, HIGH = np.array([-1.5, -0.5, 0.0]), np.array([1.0, 1.5, 2.0])
A, B = np.array([-1.0, 0.5, 0.0]), np.array([1.0, 0.0, 1.5])
SLOPE = np.array([0.5, -0.25])
_X, _Y = np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 5), indexing="ij")
_GRID = np.stack(np.meshgrid(*[np.linspace(-2, 2, n) for n in (5, 6, 7)], indexing="ij"), axis=-1)
_N = np.array([1.0, 2.0, -2.0]) / 3

# the exact distance for points within [-2, 2]^3
CASES = {
    "plane": (tp.Plane(point=(0.0, 0.5, 0.0), facing=(1, 2, -2)), lambda x: (x - [0, 0.5, 0]) @ _N),
    "room": (tp.Room(low=tuple(LOW), high=tuple(HIGH)), lambda x: -box_outside(x, LOW, HIGH)),
    "ball": (
        tp.Ball(center=(0.3, -0.2, 0.1), radius=0.8),
        lambda x: np.linalg.norm(x - [0.3, -0.2, 0.1], axis=1) - 0.8,
    ),
    "capsule": (tp.Capsule(start=tuple(A), end=tuple(B), radius=0.4), lambda x: to_segment(x, A, B) - 0.4),
    "round capsule": (tp.Capsule(start=tuple(A), end=tuple(A), radius=0.4), lambda x: to_segment(x, A, A) - 0.4),
    # both are exact where what they sample is linear
    "heightfield": (
        tp.Heightfield(heights=0.2 + SLOPE[0] * _X + SLOPE[1] * _Y, low=(-2, -2), high=(2, 2)),
        lambda x: tilted(x, SLOPE),
    ),
    "distance grid": (
        tp.DistanceGrid(distances=_GRID @ _N - 0.1, low=(-2, -2, -2), high=(2, 2, 2)),
        lambda x: x @ _N - 0.1,
    ),
    "own class": (Bowl(1.7), lambda x: 1.7 - np.linalg.norm(x, axis=1)),
}
POINTS = np.random.default_rng(4).uniform(-1.99, 1.99, (400, 3))


@ti.func
def _distance(law: ti.template(), row):
    return ti.Vector([law.signed_distance(ti.Vector([row[0], row[1], row[2]]))])


@ti.func
def _normal(law: ti.template(), row):
    return law.normal(ti.Vector([row[0], row[1], row[2]]))


class Ask:
    """Distance [m], shape (n,), and normal, shape (n, 3), of a collider at points."""

    def __init__(self, collider):
        self._distance = Probe(collider, _distance, arguments=3)
        self._normal = Probe(collider, _normal, arguments=3, width=3)

    def distance(self, x):
        return self._distance(*np.asarray(x).T)

    def normal(self, x):
        return self._normal(*np.asarray(x).T)
