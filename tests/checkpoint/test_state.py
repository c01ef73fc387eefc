"""A simulation that goes on from its snapshot makes the frames that it would have made, to the bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tparticles as tp
from tests.small_scenes import WHITE, group, scene, simulate
from tparticles.checkpoint import read_checkpoint, write_checkpoint
from tparticles.errors import RunError

# Sparks that are born and die all the time, so that slots are used again and again.
SPARKS: dict[str, Any] = {
    "births": tp.Rate(rate=300.0),
    "shape": tp.Sphere(radius=1.0),
    "lifetime": tp.Spread(mean=0.3, variance=0.2),
    "size": tp.Spread(mean=0.1, variance=0.05),
}
SWIRL = tp.Advected(flow=tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=20.0, core=0.4))
FALL = tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=0.2)))


def burning() -> tp.Group:
    glow = {**SPARKS, "lifetime": None, "temperature": tp.Spread(mean=1500.0, variance=200.0)}
    return group("embers", system=SWIRL, appearance=tp.Glow(), cooling=tp.Char(), **glow)


FILMS = {
    "one step": lambda: scene(group(system=SWIRL, **SPARKS), burning()),
    "history": lambda: scene(group(system=FALL, **SPARKS), scheme="bdf4", shutter=0.5),
    "own steps": lambda: scene(
        group(system=SWIRL, **SPARKS), scheme="dormand-prince", steps=tp.ErrorControl(rtol=1e-4, atol=1e-5)
    ),
    "own steps and a past": lambda: scene(group(system=FALL, **SPARKS), scheme="abm5-pec", steps=tp.PixelTolerance()),
}


def frames(simulation: tp.Simulation, numbers: list[int]) -> tuple[list[np.ndarray], list[dict[str, Any]]]:
    images, rows = [], []
    for frame in simulation.frames(numbers):
        images.append(frame.image)
        rows.append({name: value for name, value in frame.report.row().items() if name != "ms"})
    return images, rows


@pytest.mark.parametrize("kind", FILMS)
def test_a_restored_simulation_makes_the_same_frames(tmp_path: Path, kind: str) -> None:
    film, later = FILMS[kind](), [13, 14, 20]
    simulation, kept = simulate(film), tmp_path / "0.checkpoint"

    def keep(number: int) -> None:
        if number == 11:  # on the way from one frame that is drawn to the next: its counts are half made
            write_checkpoint(kept, simulation.snapshot(), identity="film", frame=number)

    images, rows = [], []
    for frame in simulation.frames([5, *later], after=keep):
        images.append(frame.image)
        rows.append({name: value for name, value in frame.report.row().items() if name != "ms"})
    again = simulate(film)
    again.restore(read_checkpoint(kept, identity="film").sections)
    new_images, new_rows = frames(again, later)
    assert all(np.array_equal(a, b) for a, b in zip(images[1:], new_images, strict=True))
    assert len({image.tobytes() for image in images}) == 4  # the picture moves
    assert new_rows == rows[1:]
    assert 0 < rows[1]["died"] < rows[1]["born"]


def test_nobody_alive_is_a_state_too() -> None:
    film = scene(group(births=tp.Burst(count=5, time=0.5)))
    state = simulate(film).snapshot()
    again = simulate(film)
    again.restore(state)
    assert again.advance_to(24).alive == 5


def test_a_state_of_another_scene_is_refused() -> None:
    state = simulate(scene(group(births=tp.Burst(count=5)))).snapshot()
    with pytest.raises(RunError, match="another scene"):
        simulate(scene(group("others"))).restore(state)
    with pytest.raises(RunError, match="attribute 'v' is not f32"):
        simulate(scene(group(system=FALL))).restore(state)


def test_more_than_there_is_room_for_is_refused() -> None:
    def few(capacity: int) -> tp.Scene:
        return scene(group(births=tp.Burst(count=10), capacity=capacity, appearance=WHITE))

    simulation = simulate(few(10))
    simulation.advance_to(1)
    state = simulation.snapshot()
    with pytest.raises(RunError, match="10 particles need more room than there is"):
        simulate(few(5)).restore(state)
