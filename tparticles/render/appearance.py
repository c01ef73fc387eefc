"""What a particle looks like: a blackbody glow by temperature, or a colour ramp by age."""

from typing import Annotated

import numpy as np
import taichi as ti
from pydantic import Field

from ..errors import InputError
from ..spec import Finite, NonNegative, Positive, spec
from .blackbody import BlackbodyTable
from .look import Look, srgb_decode

Fraction01 = Annotated[float, Field(ge=0, le=1)]
Color = tuple[Fraction01, Fraction01, Fraction01]


@spec
class Glow:
    """Blackbody radiation: the dot is a disc of the particle's diameter with the luminance of its temperature.

    `emissivity` scales it (an optically thin flame has a few per cent). `fade_in` and `fade_out`, fractions of the lifetime,
    let a soft particle appear and vanish smoothly. `growth` [m/s] adds to the diameter with age.
    """

    emissivity: Positive = 1.0
    fade_in: Fraction01 = 0.0
    fade_out: Fraction01 = 0.0
    growth: NonNegative = 0.0

    uses_temperature = True

    def prepare(self, look: Look) -> "GlowShader":
        """Return the shader under `look`: exposure and white balance go into its table."""
        return GlowShader(self, look)


@spec
class Ramp:
    """A colour by age instead of a temperature: `colors` (sRGB, 0..1), evenly spaced over `span` [s], the last one for ever.

    `brightness` is the film value of a dot that covers a pixel, 1 being film white; the rest as in `Glow`.
    """

    colors: Annotated[tuple[Color, ...], Field(min_length=1)]
    span: Positive
    brightness: Positive = 1.0
    fade_in: Fraction01 = 0.0
    fade_out: Fraction01 = 0.0
    growth: NonNegative = 0.0

    uses_temperature = False

    def prepare(self, look: Look) -> "RampShader":
        """Return the shader."""
        return RampShader(self)


Appearance = Glow | Ramp


class GlowShader:
    """Colour of a temperature [K] by table lookup, linear in 1/T; the NumPy twin is `BlackbodyTable.lookup`."""

    def __init__(self, glow: Glow, look: Look):
        table = BlackbodyTable.build(adaptation=look.adaptation())
        self.entries, self.rows = table.n, table.values.ravel()
        self.u_min, self.steps_per_u = float(table.u_min), float(table.steps_per_u)
        self.scale = look.exposure * glow.emissivity

    @ti.func
    def color(self, T, age):
        """Return linear sRGB film values of a dot that covers the whole pixel; may be negative out of gamut."""
        s = ti.max((1.0 / ti.math.clamp(T, 1.0, 12000.0) - self.u_min) * self.steps_per_u, 0.0)
        i = ti.min(ti.cast(s, ti.i32), self.entries - 2)
        w = s - ti.cast(i, float)
        row = ti.Vector([self.rows[4 * i + c] * (1.0 - w) + self.rows[4 * i + 4 + c] * w for c in ti.static(range(4))])
        rgb = ti.exp(row[0]) * self.scale * ti.Vector([row[1], row[2], row[3]])
        return ti.select(T < 500.0, 0.0, 1.0) * rgb


class RampShader:
    """Colour of an age [s] by linear interpolation between the stops, in linear light."""

    def __init__(self, ramp: Ramp):
        stops = srgb_decode(np.array(ramp.colors, float)) * ramp.brightness
        stops = np.concatenate([stops, stops[-1:]])  # so that the last stop has a next one
        self.last = len(ramp.colors) - 1
        self.stops = stops.ravel()
        self.pace = max(self.last, 1) / ramp.span

    @ti.func
    def color(self, T, age):
        """Return linear sRGB film values of a dot that covers the whole pixel."""
        s = ti.math.clamp(age * self.pace, 0.0, ti.cast(self.last, float))
        i = ti.cast(s, ti.i32)
        w = s - ti.cast(i, float)
        return ti.Vector(
            [self.stops[3 * i + c] * (1.0 - w) + self.stops[3 * i + 3 + c] * w for c in ti.static(range(3))]
        )


@spec
class Gradient:
    """A vertical background gradient between two sRGB colours (0..1): what the finished picture shows where no light falls."""

    top: Color = (0.0, 0.0, 0.0)
    bottom: Color = (0.0, 0.0, 0.0)
    power: Finite = 1.0

    def __post_init__(self) -> None:
        if self.power <= 0:
            raise InputError(f"Gradient.power = {self.power:g}: must be > 0")

    def picture(self, width: int, height: int) -> np.ndarray:
        """Return sRGB values 0..1, shape (height, 1, 3): all columns are alike."""
        s = ((np.arange(height) + 0.5) / height) ** self.power
        return (np.outer(1 - s, self.top) + np.outer(s, self.bottom))[:, None, :]


@spec
class Picture:
    """A background image file, scaled to cover the frame."""

    path: str

    def picture(self, width: int, height: int) -> np.ndarray:
        """Return sRGB values 0..1, shape (height, width, 3).

        Raises:
            InputError: the file is missing or no image.
        """
        from PIL import Image, ImageOps, UnidentifiedImageError

        try:
            with Image.open(self.path) as image:
                fitted = ImageOps.fit(image.convert("RGB"), (width, height))
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
            raise InputError(f"background '{self.path}' cannot be read: {error}") from None
        return np.asarray(fitted, float) / 255


Background = Gradient | Picture


def film_background(background: Background, look: Look, width: int, height: int) -> np.ndarray:
    """Return the film values that develop to the background's own colours, float32, shape (height, width or 1, 3)."""
    table, film_max = look.display_table()
    film = film_max * np.linspace(0.0, 1.0, len(table)) ** 2
    return np.interp(background.picture(width, height) * 255, table, film).astype(np.float32)
