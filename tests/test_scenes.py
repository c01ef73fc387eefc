"""Every scene of scenes/: builds in each quality, makes a picture, the same one twice, and on Vulkan too."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tparticles as tp
from tparticles import backend
from tparticles.library import load
from tparticles.scene import QUALITIES

ROOT = Path(__file__).parents[1]
PATHS = sorted((ROOT / "scenes").glob("*.py"))
CAMPFIRE = ROOT / "scenes" / "campfire.py"
SIZE = (160, 90)
FRAMES = (1, 2, 3)
FEW = {"swirl": {"count": 20_000}}  # what keeps a scene short

EACH = pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)


def render(path, **options):
    """Return images, states and reports of the frames."""
    scene = load(str(path)).build(quality="preview", settings=FEW.get(path.stem, {}))
    sim = tp.Simulation(scene, size=SIZE, **options)
    return [(frame.image, frame.state(), frame.report) for frame in sim.frames(FRAMES)]


@pytest.fixture(scope="module")
def films():
    """Each scene, rendered once."""
    cache = {}

    def film(path):
        if path not in cache:
            backend.stop()
            cache[path] = render(path, arch="cpu", threads=2)
        return cache[path]

    return film


@EACH
@pytest.mark.parametrize("quality", QUALITIES)
def test_builds_in_each_quality(path, quality):
    scene = load(str(path)).build(quality=quality, settings={})
    assert isinstance(scene, tp.Scene)
    assert scene.resolution(quality) == (scene.size or QUALITIES[quality])
    assert scene == load(str(path)).build(quality=quality, settings={}), "the same script describes the same scene"


@EACH
def test_makes_a_picture(path, films):
    for image, states, report in films(path):
        assert image.shape == (SIZE[1], SIZE[0], 3)
        peak = image.max(axis=2)
        assert peak.max() > 60, "black"
        assert (peak == 255).mean() < 0.05 and 2 < image.mean() < 128, "saturated, or nearly black"
        assert len(np.unique(image)) > 30
        assert report.alive == sum(len(s["id"]) for s in states.values()) > 10
        assert all(np.all(np.isfinite(v)) for s in states.values() for v in s.values())


@EACH
def test_is_deterministic(path, films):
    before = films(path)
    backend.stop()
    for (image, states, report), (again, states_again, report_again) in zip(
        before, render(path, arch="cpu", threads=2), strict=True
    ):
        assert np.array_equal(image, again)
        assert all(np.array_equal(states[g][k], states_again[g][k]) for g in states for k in states[g])
        assert [report.born, report.died, report.steps] == [report_again.born, report_again.died, report_again.steps]


ELSEWHERE = """
import sys
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[1])
from test_scenes import CAMPFIRE, render
films = render(CAMPFIRE, arch="vulkan")
np.savez(
    sys.argv[2],
    images=np.stack([image for image, _, _ in films]),
    alive=[report.alive for _, _, report in films],
    **{f"{g}.{k}": states[g][k] for _, states, _ in films[-1:] for g in states for k in states[g]},
)
"""


@pytest.fixture(scope="module", autouse=True)
def vulkan(tmp_path_factory):
    """Render the campfire on Vulkan while the other tests run: a software driver takes its time. None where there is none."""
    if backend.missing("vulkan"):
        yield None
        return
    out = tmp_path_factory.mktemp("vulkan") / "film.npz"
    command = [sys.executable, "-c", ELSEWHERE, str(ROOT / "tests"), str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            yield process, out
        finally:
            process.kill()


def test_vulkan_shows_the_same(films, vulkan):
    if vulkan is None:
        pytest.skip(f"arch 'vulkan' is not available: {backend.missing('vulkan')}")
    process, out = vulkan
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors[-2000:]
    images = films(CAMPFIRE)
    found = np.load(out)
    assert found["alive"].tolist() == [report.alive for _, _, report in images]
    states = images[-1][1]
    for group, state in states.items():
        assert np.array_equal(found[f"{group}.id"], state["id"])
        assert np.array_equal(found[f"{group}.birth"], state["birth"])
        np.testing.assert_allclose(found[f"{group}.x"], state["x"], atol=2e-3)
    off = np.abs(found["images"].astype(int) - np.stack([image for image, _, _ in images]))
    assert (off > 4).mean() < 2e-4, f"{(off > 0).mean():.2%} of the values differ, by up to {off.max()}"
