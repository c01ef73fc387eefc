"""Counter-based random numbers: a hash of (seed, stream, particle id, draw), the same on every machine.

No state and no order: any thread, shard or resumed run that asks for draw `d` of particle `i` gets the same bits. The mixer
is `triple32` (C. Wellons, "Prospecting for hash functions", 2018), a bijection of 32 bits with a bias of 0.021 bits.
The key of a stream (one per emitter) is folded in between two rounds, so that two streams are never shifted copies of
each other, and ids of one stream never collide. Each function on the device has a NumPy twin with equal bits.
"""

import zlib

import numpy as np
import taichi as ti

from .errors import InputError

_GOLDEN = 0x9E3779B9  # separates draws: 2^32 / golden ratio


def _mix(h: int | np.ndarray) -> np.ndarray:
    """Scramble 32 bits (triple32); the NumPy twin of `mix`."""
    h = np.asarray(h, np.uint32)
    h = (h ^ (h >> np.uint32(17))) * np.uint32(0xED5AD4BB)
    h = (h ^ (h >> np.uint32(11))) * np.uint32(0xAC4C1B51)
    h = (h ^ (h >> np.uint32(15))) * np.uint32(0x31848BAB)
    return h ^ (h >> np.uint32(14))


@ti.func
def mix(h):
    """Scramble 32 bits (triple32)."""
    h = (h ^ (h >> 17)) * ti.u32(0xED5AD4BB)
    h = (h ^ (h >> 11)) * ti.u32(0xAC4C1B51)
    h = (h ^ (h >> 15)) * ti.u32(0x31848BAB)
    return h ^ (h >> 14)


def stream_key(seed: int, name: str) -> int:
    """Return the 32-bit key of the stream `name` (an emitter, a noise) under `seed` (any non-negative integer)."""
    if seed < 0:
        raise InputError(f"seed = {seed}: must not be negative")
    key = np.asarray(zlib.crc32(name.encode()), np.uint32)
    while True:  # fold the seed in, 32 bits at a time
        with np.errstate(over="ignore"):
            key = _mix(key ^ _mix(((seed & 0xFFFFFFFF) + _GOLDEN) & 0xFFFFFFFF))
        seed >>= 32
        if not seed:
            return int(key)


def bits(key: int, particle: np.ndarray | int, draw: np.ndarray | int) -> np.ndarray:
    """Return 32 random bits for each (particle id, draw) of the stream `key`; broadcasts; dtype uint32."""
    particle = np.asarray(particle).astype(np.uint32)
    with np.errstate(over="ignore"):
        step = np.asarray(draw).astype(np.uint32) * np.uint32(_GOLDEN)
        return _mix(_mix(_mix(particle) ^ np.uint32(key)) + step)


def uniform(key: int, particle: np.ndarray | int, draw: np.ndarray | int) -> np.ndarray:
    """Return float64 in the open interval (0, 1): 23 bits at the centres of 2^23 equal cells, exact in f32 too."""
    return ((bits(key, particle, draw) >> np.uint32(9)) + 0.5) * 2.0**-23


@ti.func
def device_stream(key, particle):
    """Return what `device_bits` and `device_uniform` need of the particle `particle` of the stream `key` (u32)."""
    return mix(mix(ti.cast(particle, ti.u32)) ^ ti.cast(key, ti.u32))


@ti.func
def device_bits(stream, draw):
    """Return 32 random bits for draw `draw` of a particle (see `device_stream`); equal to `bits`."""
    return mix(stream + ti.cast(draw, ti.u32) * ti.u32(_GOLDEN))


@ti.func
def device_uniform(stream, draw):
    """Return a real in the open interval (0, 1); equal to `uniform`."""
    return (ti.cast(device_bits(stream, draw) >> 9, float) + 0.5) * ti.static(2.0**-23)
