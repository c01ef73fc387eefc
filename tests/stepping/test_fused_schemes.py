"""Every scheme of the catalogue in the fused stepper, over several frames, against the plain interpreter."""

import numpy as np
import pytest
from fused_bench import SCHEMES, Particles
from test_fused_accuracy import COUNT, Oscillator, Swelling

import tparticles as tp
from tparticles import schemes

pytestmark = pytest.mark.usefixtures("cpu64")

FRAMES = 5
FRAME = 1 / 24


@pytest.fixture(scope="module")
def swelling(cpu64):
    return Particles(tp.Advected(flow=Swelling()), COUNT)


@pytest.fixture(scope="module")
def oscillator(cpu64):
    return Particles(tp.Newtonian(forces=Oscillator()), COUNT)


@pytest.fixture(scope="module")
def undamped(cpu64):
    return Particles(tp.Newtonian(forces=Oscillator(zeta=0.0)), COUNT)


def check(bench, scheme, rate, names, steps_per_frame):
    z = np.random.default_rng(3).uniform(0.5, 1.0, (3 * len(names), COUNT))
    for k, name in enumerate(names):
        bench.set(name, z[3 * k : 3 * k + 3].T)
    bench.set("birth", 0.0)
    for frame in range(FRAMES):
        bench.run(scheme, frame * FRAME, (frame + 1) * FRAME, FRAME / steps_per_frame)
    # splittings see (x, v) on a leading axis
    shape = (2, 3, COUNT) if len(names) == 2 else (3, COUNT)
    f = lambda t, y: rate(t, y.reshape(-1, COUNT)).reshape(shape)  # noqa: E731
    h = FRAME / steps_per_frame
    expected = schemes.integrate(scheme, f, 0.0, z.reshape(shape), h, FRAMES * steps_per_frame)[-1]
    tolerance = 1e-9 if scheme.implicit else 1e-13
    for k, name in enumerate(names):
        np.testing.assert_allclose(
            bench.get(name).T, expected.reshape(-1, COUNT)[3 * k : 3 * k + 3], rtol=tolerance, atol=tolerance
        )


@pytest.mark.parametrize("scheme", [s for s in SCHEMES if 1 in s.system_orders], ids=lambda s: s.name)
def test_first_order_frames_agree_with_the_interpreter(swelling, scheme):
    check(swelling, scheme, Swelling.rate, ["x"], 3)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_second_order_frames_agree_with_the_interpreter(oscillator, undamped, scheme):
    free = "velocity-free forces" in scheme.needs
    bench, zeta = (undamped, 0.0) if free else (oscillator, 0.2)
    check(bench, scheme, Oscillator(zeta=zeta).rate, ["x", "v"], 3)
