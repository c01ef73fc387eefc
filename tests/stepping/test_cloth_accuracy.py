"""A taut 16 x 16 cloth at stiffness ratios 1e4, 1e5 and 1e6 under explicit and implicit schemes, against scipy in float64."""

import math

import numpy as np
import pytest

from tparticles import schemes
from tparticles.studies.cloth import Cloth, MeshEnsemble

pytestmark = pytest.mark.usefixtures("cpu64")

RATIOS = (1e4, 1e5, 1e6)
# Steps for a third of a swing, 51 mm deep, and the largest error of a position that they may leave [m]. 128 steps are half of
# velocity Verlet's limit; implicit schemes take steps beyond it.
SCHEMES = {
    "velocity-verlet": (128, 3e-6),
    "rk4": (128, 5e-8),
    "abm4": (512, 1e-8),
    "backward-euler": (24, 1e-2),
    "bdf2": (24, 6e-4),
    "sdirk3": (24, 3e-5),
}


def span(ratio):
    """Return [s]: frequencies go with the root of the stiffness."""
    return 0.05 * math.sqrt(1e4 / ratio)


@pytest.fixture(scope="module")
def exact():
    """The cloth at the end by DOP853 to 1e-10, an integrator and a right-hand side that are not the engine's."""
    solve_ivp = pytest.importorskip("scipy.integrate", reason="scipy is an extra").solve_ivp
    found = {}
    for ratio in RATIOS:
        cloth = Cloth(ratio)

        def rate(t, y, cloth=cloth):
            return cloth.rate(t, y.reshape(6, -1)).ravel()

        end = solve_ivp(rate, (0.0, span(ratio)), cloth.start(0).ravel(), "DOP853", rtol=1e-10, atol=1e-12)
        found[ratio] = end.y[:, -1].reshape(6, -1)
    return found


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("name", SCHEMES)
def test_a_stiff_cloth_moves_as_an_independent_solver_says(exact, ratio, name):
    t, (steps, allowed) = span(ratio), SCHEMES[name]
    (found,) = MeshEnsemble(Cloth(ratio)).run(schemes.get(name), [t], t / steps).states
    wrong = np.abs(found - exact[ratio])
    assert wrong[:3].max() < allowed
    assert np.abs(found[:3] - Cloth(ratio).start(0)[:3]).max() > 1e-2  # it did move
