"""Random values: Reeves' mean + rand() * variance, with the distribution named."""

# Pyright cannot follow the code of kernels: attributes from derived(), vectors made of tuples.
# pyright: reportAttributeAccessIssue=false

import math
from typing import Annotated, Any, Literal

import taichi as ti
from pydantic import BeforeValidator

from ..errors import InputError
from ..rng import device_uniform
from ..spec import Finite, NonNegative, spec

# erfinv(y) / y as a polynomial in -ln(1 - y^2) - 2.5 (M. Giles, "Approximating the erfinv function", GPU Computing Gems, 2010);
# within 5e-6 over the range needed here.
_ERFINV = (
    2.81022636e-08,
    3.43273939e-07,
    -3.5233877e-06,
    -4.39150654e-06,
    0.00021858087,
    -0.00125372503,
    -0.00417768164,
    0.246640727,
    1.50140941,
)
_TRUNCATION = 3.0  # standard deviations; a finite support lets capacities and bounds be derived


@spec
class Spread:
    """A random value: `mean` plus `variance` times a random number.

    `uniform`: rand in (-1, 1), Reeves' own rule (ACM Trans. Graphics 2, 1983), where "variance" is the half width.
    `normal`: a standard normal, truncated at 3; "variance" is the standard deviation.
    A number stands for a constant and a pair for (mean, variance).
    """

    mean: Finite
    variance: NonNegative = 0.0
    distribution: Literal["uniform", "normal"] = "uniform"

    @property
    def varies(self) -> bool:
        """Whether two particles can differ; a value that does not vary is not stored per particle."""
        return self.variance > 0

    @property
    def half_width(self) -> float:
        """Half the width of the support."""
        return self.variance * (_TRUNCATION if self.distribution == "normal" else 1.0)

    @property
    def low(self) -> float:
        """The smallest possible value."""
        return self.mean - self.half_width

    @property
    def high(self) -> float:
        """The largest possible value."""
        return self.mean + self.half_width

    def derived(self) -> dict[str, bool]:
        """Return what decides at compile time which code a sample needs."""
        return {"is_normal": self.distribution == "normal"}

    @ti.func
    def sample(self, stream, draw):
        """Return the value of `particle`; takes one draw."""
        value = 2.0 * device_uniform(stream, draw) - 1.0
        if ti.static(self.is_normal):
            # the inverse of the distribution between -3 and 3: z = sqrt(2) erfinv(y)
            y = value * ti.static(math.erf(_TRUNCATION / math.sqrt(2)))
            w = -ti.log((1.0 - y) * (1.0 + y)) - 2.5
            p = _ERFINV[0] + 0.0 * w
            for i in ti.static(range(1, len(_ERFINV))):
                p = p * w + _ERFINV[i]
            value = ti.math.clamp(ti.static(math.sqrt(2)) * p * y, -_TRUNCATION, _TRUNCATION)
        return self.mean + self.variance * value


def _to_spread(value: Any) -> Any:
    if isinstance(value, bool):
        return value
    if isinstance(value, int | float):
        return Spread(mean=value)
    if isinstance(value, tuple | list) and len(value) == 2:
        return Spread(mean=value[0], variance=value[1])
    return value


SpreadLike = Annotated[Spread, BeforeValidator(_to_spread)]


def positive(owner: str, name: str, value: Spread) -> None:
    """Refuse a spread that can be zero or negative.

    Raises:
        InputError: names owner, parameter and the smallest possible value.
    """
    if value.low <= 0:
        raise InputError(
            f"{owner}.{name} can be {value.low:g} (mean {value.mean:g}, variance {value.variance:g}): must be > 0"
        )
