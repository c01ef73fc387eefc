"""How film becomes display values: exposure, white balance, tone curve, sRGB, and what is too dim to show.

The film is linear in cd/m^2 until a `Look` reads it. The look also answers the question that decides how long a cooling
particle lives: at which temperature can it no longer change a pixel?
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from tparticles.errors import InputError
from tparticles.render.blackbody import WHITE_RANGE, BlackbodyTable, chromatic_adaptation
from tparticles.spec import spec

Array = NDArray[np.float64]
Tone = Literal["linear", "reinhard", "filmic"]

# Linear sRGB at which IEC 61966-2-1 changes from the straight piece to the power.
_KNEE = 0.0031308
_POINTS = 257  # that a search looks at in one go: NumPy takes longer for its calls than for the numbers
# The table ends where the code value does: 255, less what no rounding or dither can show.
_NEARLY_FULL = 254.999


def srgb_encode(x: ArrayLike) -> Array:
    """Return display-linear `x` as sRGB code values, both 0..1 (IEC 61966-2-1); shape kept.

    Below 0 the straight piece goes on and above 1 the power does; nothing is clipped. The standard's rounded constants
    make it step down by 3e-8 at 0.0031308; here it is held level there, so that it is monotonic.
    """
    x = np.asarray(x, dtype=np.float64)
    power = 1.055 * np.maximum(x, _KNEE) ** (1.0 / 2.4) - 0.055
    return np.where(x <= _KNEE, 12.92 * x, np.maximum(power, 12.92 * _KNEE))


def srgb_decode(code: ArrayLike) -> Array:
    """Return sRGB `code` values as display-linear, both 0..1 (IEC 61966-2-1); shape kept, nothing clipped."""
    code = np.asarray(code, dtype=np.float64)
    power = ((np.maximum(code, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(code <= 0.04045, code / 12.92, power)


def bayer(order: int = 3) -> Array:
    """Return the ordered-dither matrix of shape (2^order, 2^order) in steps of the display, inside (-0.5, 0.5).

    Entries are (k + 0.5) / 4^order - 0.5, each k of 0..4^order - 1 once; the mean is 0. Source: Bayer 1973, "An optimum
    method for two-level rendition of continuous-tone pictures".

    Raises `InputError` unless 1 <= order <= 8.
    """
    if not 1 <= order <= 8:
        raise InputError(f"order = {order} is not allowed (1 to 8)")
    k = np.zeros((1, 1))
    for _ in range(order):
        # M_2n = [[4 M_n, 4 M_n + 2], [4 M_n + 3, 4 M_n + 1]]
        k = np.block([[4 * k, 4 * k + 2], [4 * k + 3, 4 * k + 1]])
    return (k + 0.5) / 4**order - 0.5


def _linear(film: Array, white: float) -> Array:
    """Identity: the clip is the whole curve."""
    return film


def _reinhard(film: Array, white: float) -> Array:
    """Extended Reinhard, L (1 + L / L_white^2) / (1 + L) (Reinhard et al. 2002, eq. 4): slope 1 at 0."""
    return film * (1.0 + film / white**2) / (1.0 + film)


def _hable(x: ArrayLike) -> Array:
    """Hable 2010 ("Uncharted 2"): (x (A x + C B) + D E) / (x (A x + B) + D F) - E / F, over one denominator.

    Written as one fraction it is exactly 0 at 0 and does not cancel, so it stays monotonic for the smallest film.
    """
    A, B, C, D, E, F = 0.15, 0.50, 0.10, 0.20, 0.02, 0.30
    x = np.asarray(x, dtype=np.float64)
    return x * (A * (1.0 - E / F) * x + B * (C - E / F)) / (x * (A * x + B) + D * F)


def _filmic(film: Array, white: float) -> Array:
    """Hable's curve with his exposure bias of 2, scaled so that `white` reaches 1."""
    return _hable(2.0 * film) / _hable(2.0 * white)


_CURVES: dict[str, Callable[[Array, float], Array]] = {"linear": _linear, "reinhard": _reinhard, "filmic": _filmic}


def _smallest(reached: Callable[[Array], NDArray[np.bool_]], low: float, high: float) -> float:
    """Return the smallest float in (low, high] for which the monotonic `reached` is true; it must be true at `high`."""
    while low < 0.5 * (low + high) < high:
        points = np.linspace(low, high, _POINTS)
        first = int(np.argmax(np.append(reached(points[1:-1]), True))) + 1
        low, high = float(points[first - 1]), float(points[first])
    return high


@spec
class Look:
    """Exposure, white balance and tone curve: everything between a linear film and 8-bit sRGB.

    `ev` is the exposure value at ISO 100, EV100: the luminance 1.2 * 2^ev cd/m^2 gives film value 1. It is the
    saturation-based speed of ISO 12232 (H_sat = 78 / S) with the lens constant q = 0.65 and EV as ISO 2720 has it:
    L_max = 78 / (100 q) * 2^ev. The default, 7, is for the dark: L_max = 154 cd/m^2, an ember of 1200 K has 139.

    `white_balance` [K], 1000..25000, is the temperature of the black body that looks white, see
    `blackbody.chromatic_adaptation`; low values turn embers white, 6504 leaves them as a daylight camera has them.

    `tone` is the curve: "linear" clips at 1; "reinhard" is Reinhard et al. 2002 extended; "filmic" is Hable 2010. The
    filmic default keeps the dark end: its gain there is 0.77 and within 1 % of that up to film value 0.05, whereas the
    toe of the usual ACES fit (Narkowicz 2015) shows dim embers 4 to 6 times too dark against the middle tones.

    `white` is the film value that reaches display 1 under "reinhard" and "filmic", 0.01..100; "linear" ignores it.
    The default 5.6 is Hable's 11.2 with his exposure bias of 2 taken into account.

    `dither` adds `bayer()` steps before rounding. Raises `InputError` for a wrong name, type or value.
    """

    ev: Annotated[float, Field(ge=-40.0, le=40.0)] = 7.0
    white_balance: Annotated[float, Field(ge=WHITE_RANGE[0], le=WHITE_RANGE[1])] = 6504.0
    tone: Tone = "filmic"
    white: Annotated[float, Field(ge=0.01, le=100.0)] = 5.6
    dither: bool = True

    @property
    def exposure(self) -> float:
        """Film value per luminance [m^2/cd], 1 / (1.2 * 2^ev)."""
        return 1.0 / (1.2 * 2.0**self.ev)

    @property
    def clip(self) -> float:
        """Smallest film value that reaches display 1; everything brighter looks the same."""
        return 1.0 if self.tone == "linear" else self.white

    def adaptation(self) -> Array:
        """Return the white balance as a matrix on linear sRGB, shape (3, 3), for `BlackbodyTable.build`."""
        return chromatic_adaptation(self.white_balance)

    def tone_curve(self, film: ArrayLike) -> Array:
        """Return display-linear values 0..1 for film values, shape kept; monotonic, negative film gives 0."""
        clipped = np.clip(np.asarray(film, dtype=np.float64), 0.0, self.clip)
        return np.minimum(_CURVES[self.tone](clipped, self.white), 1.0)

    def encode(self, film: ArrayLike) -> Array:
        """Return sRGB code values 0..1 for film values, shape kept: the tone curve, then IEC 61966-2-1."""
        return srgb_encode(self.tone_curve(film))

    def display_table(self, n: int = 4096) -> tuple[Array, float]:
        """Return `(table, film_max)`: 255 * `encode` at n film values uniform in sqrt(film / film_max).

        A kernel does s = sqrt(min(max(v, 0), film_max) / film_max) * (n-1) and interpolates table[int(s)] and the next
        linearly; sqrt puts the samples where the code value is steep. At n = 4096 that is off by less than 0.005 of a
        display step for every look. film_max is the smallest film value that gives 254.999.

        Raises `InputError` if n < 2.
        """
        if n < 2:
            raise InputError(f"n = {n} is not allowed (at least 2 table entries)")
        film_max = _smallest(lambda film: 255.0 * self.encode(film) >= _NEARLY_FULL, 0.0, self.clip)
        return 255.0 * self.encode(film_max * np.linspace(0.0, 1.0, n) ** 2), film_max

    def threshold(self, *, steps: float = 0.5) -> float:
        """Return the smallest film value that encodes to `steps` display steps of 1/255: less is too dim to show.

        Half a step is where plain rounding begins to show. Bayer dither begins earlier: with it, some pixels of a large
        area light up from 0.5 - bayer().max() = 1/128 of a step.

        Raises `InputError` unless 0 < steps < 255.
        """
        if not 0.0 < steps < 255.0:
            raise InputError(f"steps = {steps:g} is not allowed (above 0 and below 255)")
        return _smallest(lambda film: 255.0 * self.encode(film) >= steps, 0.0, self.clip)

    def coldest_visible(self, table: BlackbodyTable, *, steps: float = 0.5) -> float:
        """Return the temperature [K] below which a black body that fills a pixel stays below `threshold(steps=steps)`.

        That is, in all three channels after exposure. `table` holds the white balance, see `adaptation`. The answer is
        clamped: `BlackbodyTable.T_MIN` = 500 K if even that shows, `T_MAX` = 12000 K if nothing in the table does.

        Raises `InputError` unless 0 < steps < 255.
        """
        needed = self.threshold(steps=steps) / self.exposure

        def shows(T: ArrayLike) -> NDArray[np.bool_]:
            return np.max(table.lookup(T), axis=-1) >= needed

        if shows(table.T_MIN):
            return table.T_MIN
        return _smallest(shows, table.T_MIN, table.T_MAX) if shows(table.T_MAX) else table.T_MAX
