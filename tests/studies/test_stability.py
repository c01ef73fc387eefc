"""The stability study: its data are the schemes' limits, and what a region shows is what one step does."""

import math

import numpy as np
import pytest

from tparticles import schemes
from tparticles.schemes import oscillator_limit
from tparticles.studies import stability

SCHEMES = tuple(schemes.CATALOGUE.values())


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_limits_and_border_agree_with_the_scheme(scheme):
    zetas = (0.0, 0.3, 0.7)
    (region,) = stability.study([scheme], zetas=zetas, rays=(90, 135, 180)).regions
    assert (region.real_limit, region.imaginary_limit) == (scheme.real_limit, scheme.imaginary_limit)
    for zeta, limit in zip(zetas, region.oscillator, strict=True):
        assert limit == pytest.approx(oscillator_limit(scheme, zeta), rel=1e-5), zeta
    for angle, limit in ((90, scheme.imaginary_limit), (180, scheme.real_limit)):
        border = [size for at, size in region.border if at == angle]
        if angle == 180 and scheme.system_orders == {2}:
            assert border == []  # its plane is that of oscillators
        elif limit == math.inf:
            assert border == []
        elif limit > 0:
            # Where a limit is followed by growth like a high power, rounding hides its beginning.
            assert border[0] == pytest.approx(limit, rel=1e-5)


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_the_array_version_of_the_amplification_is_the_scheme_s(scheme):
    z = np.array([-0.5 + 0.2j, -1.7 + 1.1j, 0.3 + 2j, 3j])
    expected = [scheme.stability.amplification(complex(at)) for at in z]
    np.testing.assert_allclose(stability.amplification(scheme, z), expected, rtol=1e-7)


@pytest.mark.parametrize(
    ("name", "zeta", "limit"),
    [
        # |1 + z|^2 = 1 at omega dt = 2 zeta; p + 2 q = 4 of symplectic Euler at critical damping
        ("euler", 0.005, 0.01),
        ("euler", 1.0, 2.0),
        ("symplectic-euler", 1.0, 2 * math.sqrt(2) - 2),
        # BDF4 is A(73.35 degrees)-stable (Hairer and Wanner II, table V.2.1)
        ("bdf4", 0.3, math.inf),
    ],
)
def test_limits_of_damped_oscillators_in_closed_form(name, zeta, limit):
    (region,) = stability.study([schemes.get(name)], zetas=[zeta], rays=()).regions
    assert region.oscillator[0] == pytest.approx(limit, rel=1e-4)


def test_bdf4_has_a_limit_inside_the_wedge_that_its_angle_leaves_out():
    (region,) = stability.study([schemes.get("bdf4")], zetas=[0.1], rays=()).regions
    limit, root = region.oscillator[0], complex(-0.1, math.sqrt(0.99))
    assert 0 < limit < 1
    assert schemes.get("bdf4").stability.amplification(0.99 * limit * root) < 1
    assert schemes.get("bdf4").stability.amplification(1.05 * limit * root) > 1


def test_milne_is_stable_on_its_island_only():
    # Chase, J. ACM 9 (1962)
    (region,) = stability.study([schemes.get("milne")], zetas=[0.0], rays=[180]).regions
    assert [size for _, size in region.border] == pytest.approx([0.3, 0.844], abs=1e-3)


def test_rows_hold_limits_and_border():
    rows = stability.study([schemes.get("rk4")], zetas=[0.0, 1.0], rays=[90, 180]).rows()
    assert [row["what"] for row in rows] == [
        "real limit",
        "imaginary limit",
        "omega dt",
        "omega dt",
        "border |z|",
        "border |z|",
    ]
    assert all(row["scheme"] == "rk4" for row in rows)
