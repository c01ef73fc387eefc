"""Random numbers: fixed vectors on every machine, uniformity, independence."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
import taichi as ti

from tparticles import rng
from tparticles.errors import InputError

# (seed, stream, particle, draw) -> 32 bits. Films change if these do.
VECTORS = {
    (0, "emitter", 0, 0): 0x43E33EF9,
    (0, "emitter", 1, 0): 0xB4462A20,
    (0, "emitter", 0, 1): 0xCEDCCFC1,
    (1, "emitter", 0, 0): 0x73E598AB,
    (1, "sparks/fire", 123456789, 12): 0x528046D5,
    (2**40 + 7, "flamme é", 2**31 - 1, 4): 0xE21B227A,
}
COUNT = 1_000_000
N = np.arange(COUNT)


def python_mix(h: int) -> int:
    h = (h ^ (h >> 17)) * 0xED5AD4BB & 0xFFFFFFFF
    h = (h ^ (h >> 11)) * 0xAC4C1B51 & 0xFFFFFFFF
    h = (h ^ (h >> 15)) * 0x31848BAB & 0xFFFFFFFF
    return h ^ (h >> 14)


def python_crc32(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def python_bits(seed: int, name: str, particle: int, draw: int) -> int:
    key = python_crc32(name.encode())
    while True:
        key = python_mix(key ^ python_mix((seed % 2**32 + 0x9E3779B9) % 2**32))
        seed //= 2**32
        if not seed:
            break
    return python_mix((python_mix(python_mix(particle) ^ key) + draw * 0x9E3779B9) % 2**32)


@ti.kernel
def fill(
    keys: ti.types.ndarray(dtype=ti.u32, ndim=1),
    particles: ti.types.ndarray(dtype=ti.i32, ndim=1),
    draws: ti.types.ndarray(dtype=ti.i32, ndim=1),
    out: ti.types.ndarray(dtype=ti.u32, ndim=1),
    real: ti.types.ndarray(dtype=ti.f32, ndim=1),
):
    for i in range(keys.shape[0]):
        stream = rng.device_stream(keys[i], particles[i])
        out[i], real[i] = rng.device_bits(stream, draws[i]), rng.device_uniform(stream, draws[i])


def on_device() -> tuple[np.ndarray, np.ndarray]:
    """Return the bits and the uniform numbers of the vectors from a kernel of the running backend."""
    keys = np.array([rng.stream_key(seed, name) for seed, name, _, _ in VECTORS], np.uint32)
    particles, draws = (np.array([v[k] for v in VECTORS], np.int32) for k in (2, 3))
    out, real = np.zeros(len(VECTORS), np.uint32), np.zeros(len(VECTORS), np.float32)
    fill(keys, particles, draws, out, real)
    return out, real


@pytest.mark.parametrize("case", VECTORS)
def test_vectors_on_the_host(case):
    seed, name, particle, draw = case
    assert python_bits(*case) == VECTORS[case]
    assert int(rng.bits(rng.stream_key(seed, name), particle, draw)) == VECTORS[case]


def test_vectors_on_the_cpu(cpu):
    bits, real = on_device()
    assert [hex(b) for b in bits] == [hex(b) for b in VECTORS.values()]
    assert (real == [rng.uniform(rng.stream_key(s, n), p, d) for s, n, p, d in VECTORS]).all()


def test_many_bits_are_equal_on_cpu_and_host(cpu):
    particles = np.random.default_rng(0).integers(0, 2**31, 10_000).astype(np.int32)
    key, draws = rng.stream_key(5, "x"), (np.arange(10_000) % 16).astype(np.int32)
    out, real = np.zeros(10_000, np.uint32), np.zeros(10_000, np.float32)
    fill(np.full(10_000, key, np.uint32), particles, draws, out, real)
    assert (out == rng.bits(key, particles, draws)).all()
    assert (real == rng.uniform(key, particles, draws)).all()


VULKAN = """
import json, sys
sys.path.insert(0, {folder!r})
from tparticles import backend
from tparticles.errors import BackendError
try:
    backend.start(arch="vulkan")
except BackendError as error:
    print(json.dumps({{"skip": str(error)}}))
else:
    import test_rng
    bits, real = test_rng.on_device()
    print(json.dumps({{"bits": bits.tolist(), "real": [float(r).hex() for r in real]}}))
"""


def test_vectors_on_vulkan():
    code = VULKAN.format(folder=str(__file__).rsplit("/", 1)[0])
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    answer = json.loads(run.stdout.splitlines()[-1])
    if "skip" in answer:
        pytest.skip(answer["skip"])
    assert answer["bits"] == list(VECTORS.values())
    assert answer["real"] == [float(rng.uniform(rng.stream_key(s, n), p, d)).hex() for s, n, p, d in VECTORS]


def test_uniform_stays_inside_the_open_interval_in_f32():
    lowest, highest = np.float32(0.5 * 2.0**-23), np.float32((2**23 - 0.5) * 2.0**-23)
    assert lowest > 0 and highest < 1
    u = rng.uniform(rng.stream_key(0, "u"), N, 0)
    assert (u.astype(np.float32) == u).all()  # every value is exact in f32
    assert lowest <= u.min() and u.max() <= highest


# 256 bins: chi-square with 255 degrees of freedom has p-values of 1e-4 and 1 - 1e-4 at 347.7 and 178.5.
LOW, HIGH = 178.5, 347.7


def chi_square(bins: np.ndarray, kinds: int) -> float:
    counts = np.bincount(bins, minlength=kinds)
    expected = len(bins) / kinds
    return float(((counts - expected) ** 2).sum() / expected)


@pytest.mark.parametrize("shift", [0, 8, 16, 24])
@pytest.mark.parametrize("stream", ["a", "group/emitter", "octave 1"])
def test_every_byte_is_uniform_over_ids(stream, shift):
    bits = rng.bits(rng.stream_key(3, stream), N, 0)
    assert LOW < chi_square((bits >> np.uint32(shift)) & np.uint32(255), 256) < HIGH


def test_uniform_over_draws_of_one_particle():
    assert LOW < chi_square(rng.bits(rng.stream_key(3, "a"), 17, N) >> np.uint32(24), 256) < HIGH


@pytest.mark.parametrize("steps", [(1, 0), (0, 1), (2, 0), (1024, 0), (1, 1)])
def test_pairs_fill_the_square_evenly(steps):
    """16 x 16 cells of (u_i, u_j), j a neighbour in id, in draw or in both."""
    key = rng.stream_key(9, "pairs")
    first, second = (rng.bits(key, N + a, b) >> np.uint32(28) for a, b in ((0, 0), steps))
    assert LOW < chi_square(first * 16 + second, 256) < HIGH


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


def streams() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    key = rng.stream_key(0, "fire")
    u = rng.uniform(key, N, 0)
    return {
        "ids": (u[:-1], u[1:]),
        "ids, 2 apart": (u[:-2], u[2:]),
        "draws": (u, rng.uniform(key, N, 1)),
        "draw of the next id": (u[1:], rng.uniform(key, N[:-1], 1)),
        "emitters": (u, rng.uniform(rng.stream_key(0, "fire2"), N, 0)),
        "seeds": (u, rng.uniform(rng.stream_key(1, "fire"), N, 0)),
        "distant seeds": (u, rng.uniform(rng.stream_key(2**32, "fire"), N, 0)),
        "low and high bits": (rng.bits(key, N, 0) & np.uint32(0xFFFF), rng.bits(key, N, 0) >> np.uint32(16)),
    }


@pytest.mark.parametrize("name", streams())
def test_no_serial_correlation(name):
    a, b = streams()[name]
    assert abs(correlation(a, b)) < 4 / math.sqrt(len(a))


def test_streams_of_neighbouring_seeds_are_not_shifted_copies():
    keys = [rng.stream_key(seed, "fire") for seed in range(50)] + [rng.stream_key(0, f"e{i}") for i in range(50)]
    assert len(set(keys)) == 100
    first = rng.bits(keys[0], N[:10_000], 0)
    for key in keys[1:]:
        # two random sets of 10^4 out of 2^32 share 0.02 values on average
        assert len(np.intersect1d(first, rng.bits(key, N[:10_000], 0))) <= 2


def test_ids_of_a_stream_never_collide():
    assert len(np.unique(rng.bits(rng.stream_key(4, "unique"), N, 7))) == COUNT


def test_half_of_the_bits_flip_with_one_bit_of_the_id():
    key = rng.stream_key(8, "avalanche")
    ids = N[:20_000]
    for bit in range(31):
        flipped = rng.bits(key, ids, 0) ^ rng.bits(key, ids ^ (1 << bit), 0)
        share = np.unpackbits(flipped.view(np.uint8).reshape(-1, 4), axis=1).mean(axis=0)
        # a standard error of 0.0035; 32 x 31 shares stay within 5 of them
        assert np.abs(share - 0.5).max() < 5 * 0.5 / math.sqrt(len(ids))


def test_broadcasts_and_types():
    out = rng.bits(rng.stream_key(0, "b"), np.arange(3)[:, None], np.arange(4))
    assert out.shape == (3, 4) and out.dtype == np.uint32
    assert rng.uniform(1, 2, 3).dtype == np.float64


def test_a_negative_seed_is_refused():
    with pytest.raises(InputError, match=r"seed = -1"):
        rng.stream_key(-1, "x")
