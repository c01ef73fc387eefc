"""What exists: groups of particles, the laws that move them, a camera, a look. Frozen; allocates nothing."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Sequence
from fractions import Fraction
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, SkipValidation

from . import schemes
from .errors import InputError, unknown
from .mesh_group import MeshGroup
from .physics.cooling import Char, Exponential, Radiative
from .physics.emitters import Emitter, Schedule
from .physics.law import Bound
from .physics.shapes import Region
from .physics.spread import Spread
from .render.appearance import Appearance, Background, Glow, Gradient
from .render.blackbody import BlackbodyTable
from .render.camera import Camera
from .render.look import Look
from .schemes import Scheme
from .spec import Positive, spec
from .stepping.control import Clamp, Controller, ErrorControl, Fixed, PixelTolerance, check_fit
from .systems.motion import System
from .systems.view import Constants

_UNSEEN = Fraction(1, 6)  # [s]
_MOST_FRAMES = 10_000_000
_FINEST_RATE = 1_001_000  # of numerator and denominator: what ffmpeg keeps exact

QUALITIES = {"preview": (480, 270), "draft": (960, 540), "final": (1920, 1080)}


def _one_or_many(value: Any) -> Any:
    return tuple(value) if isinstance(value, Sequence) else (value,)


@spec
class Group:
    """Particles of one kind: the same system, emitters, cooling and appearance.

    Particles die of age (emitter lifetimes), by leaving the `region`, and, where a glow cools, when `too_cold` to show: when the
    brightest pixel of the dot would stay below half a display step under the scene's look.
    `capacity` is derived from the emitters if it is not given.

    Raises:
        InputError: parts that do not fit, or a parameter that nothing would use.
    """

    name: str
    system: System
    emitters: Annotated[tuple[Emitter, ...], BeforeValidator(_one_or_many), Field(min_length=1)]
    appearance: Appearance = Glow()
    cooling: Exponential | Radiative | Char | None = None
    region: Region | None = None
    too_cold: bool = True
    capacity: Annotated[int, Field(ge=1)] | None = None

    def __post_init__(self) -> None:
        for emitter in self.emitters:
            here = f"group '{self.name}', emitter '{emitter.name}'"
            if self.appearance.uses_temperature and emitter.temperature is None:
                raise InputError(f"{here}: a Glow needs a temperature; give emitter.temperature or use a Ramp")
            if not self.appearance.uses_temperature and (emitter.temperature or self.cooling):
                raise InputError(
                    f"{here}: nothing uses temperature or cooling under a Ramp; leave them out or use a Glow"
                )
            if emitter.velocity is not None and self.system.order == 1:
                why = "advected particles move with the flow" if self.system.moves else "still particles do not move"
                raise InputError(
                    f"{here}: {why} and have no velocity of their own; leave emitter.velocity out or use Newtonian"
                )
            if emitter.lifetime is None and (self.appearance.fade_in or self.appearance.fade_out):
                raise InputError(f"{here}: fade_in and fade_out are fractions of a lifetime; give emitter.lifetime")

    @property
    def freezes(self) -> bool:
        """Whether particles can die of cold."""
        return self.too_cold and self.appearance.uses_temperature and self.cooling is not None

    @property
    def ages(self) -> bool:
        """Whether particles can die of age."""
        return any(emitter.lifetime is not None for emitter in self.emitters)

    @property
    def mortal(self) -> bool:
        """Whether particles can die."""
        return self.ages or self.freezes or self.region is not None

    @property
    def heated(self) -> bool:
        """Whether a cooling law integrates the temperature."""
        return self.cooling is not None and self.cooling.integrated

    @property
    def stepped(self) -> bool:
        """Whether there is anything to integrate."""
        return self.system.moves or self.heated

    def _values(self, name: str) -> list[Spread | None]:
        return [getattr(emitter, name) for emitter in self.emitters]

    def _stored(self, name: str) -> bool:
        values = self._values(name)
        return any(v is not None and v.varies for v in values) or len({v.mean if v else None for v in values}) > 1

    def attributes(self, *, streaks: bool) -> tuple[str, ...]:
        """Return the names of the attributes that this group needs, and no more."""
        names = ["x", "id", "birth"]
        if self.system.order == 2 or (streaks and self.system.moves):
            names.append("v")
        if self.heated:
            names.append("T")
        elif self.appearance.uses_temperature and self._stored("temperature"):
            names.append("T0")
        return (*names, *(name for name in ("size", "lifetime") if self._stored(name)))

    def constants(self) -> Constants:
        """Return what all particles share where it is no attribute."""

        def common(name: str, default: float) -> float:
            value = self._values(name)[0]
            return default if value is None else value.mean

        return Constants(T0=common("temperature", 0.0), size=common("size", 0.0), lifetime=common("lifetime", math.inf))

    def longest_life(self, look: Look) -> float:
        """Return a bound on the age at death [s], infinite where there is none."""
        lifetimes = [math.inf if v is None else v.high for v in self._values("lifetime")]
        bounds = [max(lifetimes)]
        if self.freezes and not isinstance(self.cooling, Char):
            # A wide dot's Gaussian is twice as bright in the middle as its disc.
            gain = math.log2(2 * self.appearance.emissivity)  # type: ignore[union-attr]
            seen = dataclasses.replace(look, ev=look.ev - gain)
            coldest = seen.coldest_visible(BlackbodyTable.build(adaptation=look.adaptation()))
            hottest = max(v.high for v in self._values("temperature") if v)
            largest = max(v.high for v in self._values("size") if v)
            size = (largest,) if isinstance(self.cooling, Radiative) else ()
            bounds.append(self.cooling.age_at(coldest, hottest, *size))  # type: ignore[union-attr]
        return min(bounds)

    @property
    def components(self) -> int:
        """How many numbers the state of a particle has: x, v, and T where a cooling law integrates it."""
        return 3 * len(self.system.state) + self.heated

    def most_alive(self, schedules: Sequence[Schedule], *, look: Look, frame: float) -> int:
        """Return how many particles can be alive at once, if the dead wait for so long, a frame [s], to be removed."""
        life = self.longest_life(look)
        return max(1, sum(schedule.most_alive(life, frame) for schedule in schedules))

    def derived_capacity(self, schedules: Sequence[Schedule], *, look: Look, frame: float) -> int:
        """Return the capacity that is given, or else `most_alive`."""
        return self.capacity or self.most_alive(schedules, look=look, frame=frame)

    def jacobian_bound(self) -> Bound:
        """Return the bound on the rates of the whole right-hand side [1/s], integrated cooling included."""
        bound = self.system.jacobian_bound()
        if isinstance(self.cooling, Char):
            hottest = max(v.high for v in self._values("temperature") if v)
            smallest = min(v.low for v in self._values("size") if v)
            bound = bound + self.cooling.jacobian_bound_for(hottest=max(hottest, 1500.0), smallest=smallest)
        return bound


# What a scene is stepped by that says nothing of it; known by identity, as a script may name the same.
_SCHEME, _STEPS = dataclasses.replace(schemes.get("rk4")), Fixed(dt=1 / 96)


@spec
class Scene:
    """A film: groups of particles and spring meshes, a camera, a look, and how time is stepped.

    `duration` [s], `fps` (24, 25, "30000/1001"), `size` (width, height) [px] or None for the size of the quality.
    `scheme`: a name of the catalogue or a `Scheme` made in the scene script. `steps`: the controller. Where both are left out it is
    rk4 in steps of 1/96 s, or what `of_quality` says. `clamp`: how steps are fitted to the frame.
    `shutter`: the part of a frame that it is open (0: no streaks; 0.5: a 180 degree shutter).

    Raises:
        InputError: a wrong value, two groups of one name.
    """

    groups: Annotated[tuple[Group | MeshGroup, ...], BeforeValidator(_one_or_many), Field(min_length=1)]
    camera: Camera
    look: Look = Look()
    background: Background = Gradient()
    duration: Positive = 10.0
    fps: Annotated[Fraction, BeforeValidator(lambda v: frame_rate(v))] = Fraction(24)
    size: tuple[Annotated[int, Field(ge=1, le=16384)], Annotated[int, Field(ge=1, le=16384)]] | None = None
    scheme: Annotated[SkipValidation[Scheme], BeforeValidator(lambda v: schemes.get(v))] = _SCHEME
    steps: Controller = _STEPS
    clamp: Clamp = "equal"
    shutter: Annotated[float, Field(ge=0, le=1)] = 0.5
    seed: Annotated[int, Field(ge=0)] = 0

    def __post_init__(self) -> None:
        names = [group.name for group in self.groups]
        for name in {n for n in names if names.count(n) > 1}:
            raise InputError(f"two groups are named '{name}'")
        for group in self.particles:
            if group.stepped:
                _check_scheme(self.scheme, group)
        for group in self.meshes:
            scheme = group.scheme or self.scheme
            group.check_steps(group.steps or self.steps)
            group.check_scheme(scheme)
            check_fit(group.steps or self.steps, group.clamp or self.clamp, scheme)
        if self.particles:
            check_fit(self.steps, self.clamp, self.scheme)
        if self.frame_count < 1:
            raise InputError(f"duration = {self.duration:g} s is shorter than one frame at {self.fps} fps")
        if self.frame_count > _MOST_FRAMES:
            raise InputError(f"duration = {self.duration:g} s at {self.fps} fps: more than {_MOST_FRAMES} frames")

    @property
    def particles(self) -> tuple[Group, ...]:
        """The groups of particles without neighbours."""
        return tuple(group for group in self.groups if isinstance(group, Group))

    @property
    def meshes(self) -> tuple[MeshGroup, ...]:
        """The spring meshes."""
        return tuple(group for group in self.groups if isinstance(group, MeshGroup))

    @property
    def frame_count(self) -> int:
        """How many frames the film has; frame k, from 1, shows the time k / fps."""
        return math.floor(Fraction(self.duration).limit_denominator(10**6) * self.fps)

    @property
    def first_frame(self) -> int:
        """The frame before which nothing is born, 0 or below."""
        first = min([0.0, *(e.first_time for group in self.particles for e in group.emitters)])
        return min(0, math.floor(Fraction(first).limit_denominator(10**6) * self.fps))

    @property
    def stride(self) -> int:
        """How many frames of the pre-roll are advanced at once, as nobody sees them: those of a sixth of a second.

        One by one where their steps go by frames: those of meshes, and of particles that choose their own.
        """
        return 1 if self.meshes or self.adaptive else max(1, math.floor(_UNSEEN * self.fps))

    @property
    def longest_advance(self) -> float:
        """The longest time [s] that the dead may wait to be removed."""
        return float(min(max(1, -self.first_frame), self.stride) / self.fps)

    @property
    def adaptive(self) -> bool:
        """Whether particles choose their own steps."""
        return isinstance(self.steps, ErrorControl | PixelTolerance)

    @property
    def running_scheme(self) -> Scheme:
        """The scheme that is run: where particles choose their steps, one that estimates its error."""
        return schemes.doubled(self.scheme) if self.adaptive else self.scheme

    @property
    def says_steps(self) -> bool:
        """Whether the script says by which scheme or in which steps."""
        return self.scheme is not _SCHEME or self.steps is not _STEPS

    def of_quality(self, quality: str) -> Scene:
        """Return how the scene is stepped in a quality: where it says neither scheme nor steps, a final one to half a pixel.

        Particles then choose their own steps under `PixelTolerance()`, by abm5-pec. Meshes without a scheme and steps of their own
        go by the scene's, and keep it as it is; so does drag that the usual steps are refused for: no explicit scheme bears it.
        """
        lent = any(mesh.steps is None or mesh.scheme is None for mesh in self.meshes)
        stiff = any(group.system.damping * _STEPS.dt > _SCHEME.real_limit for group in self.particles)
        if quality != "final" or self.says_steps or self.clamp == "slide32" or lent or stiff:
            return self
        return dataclasses.replace(self, scheme=schemes.get("abm5-pec"), steps=PixelTolerance())

    def resolution(self, quality: str = "final") -> tuple[int, int]:
        """Return (width, height) [px].

        Raises:
            InputError: an unknown quality.
        """
        if quality not in QUALITIES:
            raise unknown("quality", quality, QUALITIES)
        return self.size or QUALITIES[quality]


def _check_scheme(scheme: Scheme, group: Group) -> None:
    """Refuse a scheme that cannot run a group's system, before any kernel."""
    here = f"scheme '{scheme.name}' cannot run group '{group.name}'"
    splits = scheme.system_orders == {2}
    if group.system.order not in scheme.system_orders:
        raise InputError(
            f"{here}: it kicks and drifts, which takes velocities, and {type(group.system).__name__} particles of order "
            f"{group.system.order} have none; take a Runge-Kutta scheme (rk4)"
        )
    if "velocity-free forces" in scheme.needs and not group.system.velocity_free:
        forces = getattr(group.system, "forces", ())
        guilty = [type(f).__name__ for f in forces if not getattr(f, "velocity_free", False)]
        raise InputError(
            f"{here}: its order {scheme.order} holds for forces that do not depend on the velocity, and {', '.join(guilty)} may "
            "(a force that does not says `velocity_free = True`); take velocity-verlet or rk4"
        )
    if splits and group.components > 6:
        raise InputError(
            f"{here}: it kicks and drifts, and has no way to integrate the temperature of {type(group.cooling).__name__}; "
            "take a Runge-Kutta scheme (rk4)"
        )


def frame_rate(value: Any) -> Fraction:
    """Return a frame rate as an exact fraction; accepts 24, 29.97 (as written), "30000/1001".

    Raises:
        InputError: no number, not above 0, above 1000, or a fraction too fine for a film; the nearest usual one is named.
    """
    text = str(value).strip()
    try:
        if re.search(r"[eE][+-]?\d{4}", text):  # 1e999999999 would be worked out to the last digit
            raise ValueError
        rate = Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise InputError(f"fps = {value}: a number or a fraction such as 30000/1001 is needed") from None
    if not Fraction(1, _FINEST_RATE) <= rate <= 1000:
        raise InputError(f"fps = {value}: must be above 0 and at most 1000")
    if max(rate.numerator, rate.denominator) > _FINEST_RATE:
        near = Fraction(round(rate * 1001), 1001) if rate > 1 else rate.limit_denominator(_FINEST_RATE)
        raise InputError(f"fps = {value}: too fine a fraction for a film; did you mean {near}?")
    return rate


def frame_numbers(text: str, count: int) -> tuple[int, ...]:
    """Return the frames of a range such as `1-240`, `1-240x2` (every second), `7`, `100-`, or several with commas.

    Raises:
        InputError: it cannot be read, is reversed, or leaves 1..`count`.
    """
    chosen: set[int] = set()
    for part in text.split(","):
        found = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9})?(?:x([0-9]{1,9}))?)?", part.strip())
        if not found:
            raise InputError(f"frames '{text}': '{part.strip()}' is no range such as 1-240, 1-240x2 or 7")
        first, stride = int(found[1]), int(found[3] or 1)
        last = int(found[2]) if found[2] else (count if "-" in part else first)
        if first < 1 or first > count or last > count:
            raise InputError(f"frames '{text}': '{part.strip()}' leaves the film, which has frames 1-{count}")
        if last < first:
            raise InputError(f"frames '{text}': '{part.strip()}' is empty, {last} comes before {first}")
        if stride < 1:
            raise InputError(f"frames '{text}': '{part.strip()}' has step 0; it must be at least 1")
        chosen.update(range(first, last + 1, stride))
    return tuple(sorted(chosen))
