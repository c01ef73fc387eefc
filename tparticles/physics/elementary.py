"""Elementary functions that vectorise: sine and cosine; exponential and cube root in f32.

On a CPU, `ti.sin`, `ti.exp` and `**` are calls of the C library, one lane after another: in a lane loop they cost more than all
the rest of a flow. Here they are a few products and sums, exact to some units in the last place, with no branch. In f64 the
exponential and the cube root are Taichi's own: there the digits matter more than the speed.
"""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportInvalidTypeForm=false

import taichi as ti

from .. import backend

# Minimax (relative) polynomials: sin(2 pi t) / t in t^2 for |t| <= 1/4, and 2^f for |f| <= 1/2; found by
# iteratively reweighted least squares, errors 2.1e-11 and 1.9e-9.
_SINE = (6.28318531, -41.3417021, 81.6052237, -76.7041703, 42.0077971, -14.3813906)
_EXP2 = (1.0, 0.693147206, 0.240226469, 0.0555032878, 0.00961848897, 0.00133999312, 0.000153458075)
# sin(2 pi t) / t and cos(2 pi t) in t^2 for |t| <= 1/8: Taylor's series, economised; errors 3.5e-18 and 4.3e-20.
_SINE_64 = (
    6.283185307179586,
    -41.341702240399634,
    81.60524927594807,
    -76.70585970428509,
    42.05868502146087,
    -15.093804283937654,
    3.780870536854511,
)
_COSINE_64 = (
    1.0,
    -19.739208802178716,
    64.93939402266795,
    -85.45681720652276,
    60.24464132887419,
    -26.42625090926917,
    7.90309171786731,
    -1.696850020961397,
)
_LOG2_E = 1.4426950408889634


def _is_f64() -> bool:
    return backend.current().precision == "f64"


@ti.func
def _polynomial(coefficients: ti.template(), x):
    value = x * 0.0 + coefficients[-1]
    for i in ti.static(range(len(coefficients) - 2, -1, -1)):
        value = value * x + coefficients[i]
    return value


@ti.func
def _sine_of_quarter(t):
    return t * _polynomial(ti.static(_SINE), t * t)


@ti.func
def sin_cos(q):
    """Return (sin, cos) of `q` turns, a number or a vector; in f32 within 4 units in the last place.

    In turns the reduction to one period is exact, however far out, and no compiler can spoil it by reassociating.
    """
    r = q - ti.floor(q + 0.5)
    far = ti.abs(r)
    # sin(pi - a) = sin(a) folds the half turn to a quarter, cos(a) = sin(pi/2 - a); both differences are exact
    near = ti.min(far, 0.5 - far)
    sign = ti.select(r < 0.0, -1.0, 1.0)
    if ti.static(_is_f64()):
        # an eighth, where half as many terms do: the sine of the rest of the quarter is the cosine, and the other way round
        rest = 0.25 - near
        t = ti.min(near, rest)
        s, c = t * _polynomial(ti.static(_SINE_64), t * t), _polynomial(ti.static(_COSINE_64), t * t)
        small = near < rest
        return sign * ti.select(small, s, c), ti.select(far > 0.25, -1.0, 1.0) * ti.select(small, c, s)
    else:
        return sign * _sine_of_quarter(near), _sine_of_quarter(0.25 - far)


@ti.func
def exp(x):
    """Return e^x of a number; 0 below -87 in f32, and no more than 2e38 above 88; its relative error is 1e-7 (1 + |x|)."""
    if ti.static(_is_f64()):
        return ti.exp(x)
    y = ti.math.clamp(x * _LOG2_E, -126.0, 127.0)
    n = ti.floor(y + 0.5)
    scale = ti.bit_cast((ti.cast(n, ti.i32) + 127) << 23, ti.f32)
    return ti.select(x < -87.0, 0.0, _polynomial(_EXP2, y - n) * scale)


@ti.func
def fading(s):
    """Return (e^-s, (1 - e^-s) / s) for s >= 0, the second by its series where the difference would cancel."""
    e = exp(-s)
    terms = ti.static(15 if _is_f64() else 8)
    # 1 - s/2 (1 - s/3 (1 - s/4 ...))
    small = s * 0.0 + 1.0
    for k in ti.static(range(terms, 1, -1)):
        small = 1.0 - s * (1.0 / k) * small
    return e, ti.select(s < 0.5, small, (1.0 - e) / ti.max(s, 0.5))


@ti.func
def cube_root(x):
    """Return x^(1/3) for x > 0; in f32 for 1e-25 < x < 1e25."""
    if ti.static(_is_f64()):
        return x ** ti.static(1 / 3)
    # a third of the exponent (Kahan's magic constant, within 6 %), then twice Halley's rule: cubic convergence
    y = ti.bit_cast(ti.bit_cast(x, ti.i32) // 3 + 709921077, ti.f32)
    for _ in ti.static(range(2)):
        y3 = y * y * y
        y *= (y3 + 2.0 * x) / (2.0 * y3 + x)
    return y
