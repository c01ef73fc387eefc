"""Every scheme, in fixed and in chosen steps: one thread and two give the same bits."""

import numpy as np
import pytest
from fused_bench import SCHEMES, Particles
from test_fused_accuracy import Oscillator, Swelling

import tparticles as tp
from tparticles import backend, schemes
from tparticles.stepping.control import ErrorControl

COUNT = 500
ADAPTIVE = ("bogacki-shampine", "dormand-prince", "rk4", "tr-bdf2", "abm5-pec")


def advance(bench, scheme, **options):
    rng = np.random.default_rng(11)
    for name in bench.system.state:
        bench.set(name, rng.uniform(0.5, 1.5, (COUNT, 3)))
    bench.set("birth", rng.uniform(0.5, 1.2, COUNT))
    reports = [bench.run(scheme, 0.5 + 0.4 * k, 0.9 + 0.4 * k, 0.1, lanes=1, **options) for k in range(2)]
    return [reports, *(bench.get(name) for name in bench.system.state)]


def everything(threads):
    """Return what every scheme makes of a crowd."""
    backend.stop()
    backend.start(arch="cpu", threads=threads, precision="f32")
    swelling = Particles(tp.Advected(flow=Swelling()), COUNT)
    oscillator = Particles(tp.Newtonian(forces=Oscillator()), COUNT)
    found = {s.name: advance(swelling if 1 in s.system_orders else oscillator, s) for s in SCHEMES}
    tolerance = ErrorControl(rtol=1e-5, atol=1e-5)
    return found | {f"{n}, adaptive": advance(swelling, schemes.get(n), tolerance=tolerance) for n in ADAPTIVE}


@pytest.fixture(scope="module")
def one_and_two():
    return everything(1), everything(2)


@pytest.mark.parametrize("name", [*(s.name for s in SCHEMES), *(f"{n}, adaptive" for n in ADAPTIVE)])
def test_one_thread_and_two_give_the_same_bits(one_and_two, name):
    (reports, *first), (others, *second) = (found[name] for found in one_and_two)
    assert reports == others and sum(r.steps for r in reports) > 2 * COUNT
    for a, b in zip(first, second, strict=True):
        assert np.isfinite(a).all() and np.array_equal(a, b)
