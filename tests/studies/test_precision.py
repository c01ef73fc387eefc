"""The work-precision study: errors fall as they should, the recommendation is the cheapest that meets the error, files agree."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
import small_scenes

import tparticles as tp
from tparticles import schemes
from tparticles.cli import main
from tparticles.studies import peers, pixels, precision
from tparticles.studies.precision import Point, choices, until_useless
from tparticles.studies.work_problems import WORKS


@pytest.fixture(scope="module")
def orbits():
    """A small study in f64: two schemes of orders 2 and 4."""
    chosen = [schemes.get(name) for name in ("rk4", "velocity-verlet")]
    work = WORKS["kepler"]
    return precision.study(
        "kepler", work, chosen, precisions=["f64"], count=32, steps=[64, 128, 256, 512], tolerances=[1e-4, 1e-6, 1e-8],
        peer_tolerances=[1e-4, 1e-6],
    )  # fmt: skip


def line(result, solver, control):
    return [p for p in result.points if (p.solver, p.control) == (solver, control)]


@pytest.mark.parametrize(("name", "order"), [("rk4", 4), ("velocity-verlet", 2)])
def test_errors_fall_with_the_step_at_the_order_of_the_scheme(orbits, name, order):
    points = line(orbits, name, "fixed")
    assert [round(p.steps) for p in points] == [64, 128, 256, 512]
    assert [p.evaluations for p in points] == [p.steps * schemes.get(name).evaluations for p in points]
    slope = math.log2(points[-2].largest / points[-1].largest)
    assert slope == pytest.approx(order, abs=0.35)
    assert all(0 < p.median <= p.largest for p in points)


@pytest.mark.parametrize("name", ["rk4", "velocity-verlet"])
def test_a_tighter_tolerance_costs_more_and_errs_less(orbits, name):
    loose, middle, tight = line(orbits, name, "error")
    assert loose.largest > middle.largest > tight.largest
    assert loose.evaluations < middle.evaluations < tight.evaluations


@pytest.mark.skipif(not peers.has_scipy(), reason="scipy is an extra")
def test_scipy_solves_the_same_ensemble(orbits):
    found = [p for p in orbits.points if p.peer]
    assert {p.solver.split()[1] for p in found} == set(peers.METHODS)
    assert {p.solver.split()[2] for p in found} == {"stacked", "each"}
    assert min(p.largest for p in found) < 1e-3


@pytest.mark.skipif(not peers.has_scipy(), reason="scipy is an extra")
@pytest.mark.parametrize("name", ["stiff-drag", "kepler"])
def test_closed_forms_are_what_an_independent_solver_finds(name):
    work = WORKS[name]
    start = work.problem.start(6)
    method = "Radau" if work.stiff else "DOP853"
    found = peers.each(work, start, method, 1e-11, limit=60.0)
    assert found is not None
    exact = work.problem.solution(work.span, start)
    np.testing.assert_allclose(found.states, exact[:, found.particles], atol=3e-8)


def test_the_engine_solves_stiff_sparks_with_few_steps(orbits):
    work = WORKS["stiff-drag"]
    result = precision.study(
        "stiff-drag", work, [schemes.get("sdirk3"), schemes.get("rk4")], precisions=["f64"], count=16, steps=[256, 32768],
        tolerances=[], with_peers=False,
    )  # fmt: skip
    stiff, explicit = line(result, "sdirk3", "fixed"), line(result, "rk4", "fixed")
    assert stiff[0].largest < 1e-3 and stiff[0].steps == 256
    assert [p.steps for p in explicit] == [32768]  # 256 steps are unstable: no point of the diagram
    assert peers.INSTALL in result.notes


@pytest.mark.skipif(not peers.has_scipy(), reason="scipy is an extra")
def test_a_stiff_cloth_is_solved_as_one_mesh_beside_scipy():
    work = WORKS["cloth-1e4"]
    chosen = [schemes.get(name) for name in ("rk4", "tr-bdf2")]
    result = precision.study(
        "cloth-1e4", work, chosen, precisions=["f64"], steps=[48, 96, 192], peer_tolerances=[1e-4], peer_limit=3.0
    )
    assert result.particles == 256 and {p.control for p in result.points if not p.peer} == {"fixed"}
    for scheme in chosen:
        coarse, fine = (p.largest for p in line(result, scheme.name, "fixed")[-2:])  # 96 and 192 steps
        assert math.log2(coarse / fine) == pytest.approx(scheme.order, abs=0.5)
    assert any(p.peer and p.solver == "scipy DOP853 whole" and p.largest < 1e-3 for p in result.points)
    problem, z = work.problem, work.problem.start(0) + 1e-3 * np.random.default_rng(0).standard_normal((6, 256))
    change = np.random.default_rng(1).standard_normal(z.shape) * ~problem.mesh.pinned
    slope = (problem.rate(0.0, z + 1e-6 * change) - problem.rate(0.0, z - 1e-6 * change)) / 2e-6
    found = problem.jacobian(0.0, z) @ change.ravel()
    np.testing.assert_allclose(found, slope.ravel(), atol=1e-7 * np.abs(slope).max())


def point(solver="rk4", seconds=1.0, largest=1e-3, **more):
    values = {"control": "fixed", "precision": "f64", "setting": 0.1, "evaluations": 1.0, "steps": 1.0, "median": 0.0}
    return Point(solver=solver, seconds=seconds, largest=largest, **values | more)


def test_the_recommendation_is_the_cheapest_that_meets_the_error():
    points = [
        point("euler", 1.0, 2e-3, evaluations=1.0),
        point("rk3", 4.0, 1e-3, evaluations=9.0),
        point("rk4", 2.0, 5e-4, evaluations=12.0),
        point("sdirk3", 3.0, 1e-7, evaluations=2.0),
        point("rk4", 0.5, 1e-4, precision="f32"),
        point("scipy LSODA stacked", 100.0, 1e-4, peer=True),
        point("scipy BDF each", 90.0, 1e-2, peer=True),
    ]
    f32, f64, tight32, tight64 = choices(points, [1e-3, 1e-6], ["f32", "f64"])
    assert (f64.best, f64.fewest, f64.peer, f64.ratio) == (points[2], points[1], points[5], 50.0)
    assert (f32.best, f32.ratio) == (points[4], 200.0)
    assert (tight64.best, tight64.fewest, tight64.peer) == (points[3], None, None)
    assert math.isnan(tight64.ratio) and tight32.best is None


def test_a_sweep_ends_where_rounding_rules_or_time_runs_out():
    fall = [point(largest=e) for e in (1e-2, 1e-4, 1e-5, 2e-5, 3e-5, 4e-5, 5e-5)]
    assert list(until_useless([None, *fall], 1e-9, longest=9)) == fall[:6]
    assert list(until_useless(fall, 2e-4, longest=9)) == fall[:2]
    slow = [point(seconds=s, largest=1 / s) for s in (0.1, 0.9, 2.0, 3.0)]
    assert list(until_useless(slow, 1e-9, longest=1.0)) == slow[:3]
    blown = [point(seconds=s, largest=math.inf) for s in (0.1, 2.0)]
    assert list(until_useless([*blown, *slow], 1e-9, longest=1.0)) == []
    assert list(until_useless([blown[0], *slow], 1e-9, longest=1.0)) == slow[:3]


@pytest.fixture(scope="module")
def film():
    particles = small_scenes.group(
        system=tp.Advected(flow=tp.Vortex(axis=(0.0, 1.0, 0.0), circulation=20.0)),
        emitters=tp.Emitter(births=tp.Rate(rate=40.0), shape=tp.Box(low=(-1.0, 0.0, -1.0), high=(1.0, 0.1, 1.0))),
    )
    return small_scenes.scene(particles)


def test_a_scene_is_measured_in_pixels(film):
    chosen = [schemes.get("midpoint"), schemes.get("velocity-verlet")]
    result = pixels.study(
        "film", film, chosen, size=(640, 360), frame=12, precisions=["f64"], steps=[1, 2, 4], tolerances=[1e-5], pixels=[0.5],
        targets=[0.5], finest=16,
    )  # fmt: skip
    first, second, third = (p.largest for p in line(result, "midpoint", "fixed"))
    assert math.log2(second / third) == pytest.approx(2, abs=0.4)
    assert first > second > third
    assert line(result, "midpoint", "pixels")[0].largest < 0.5
    assert result.choices[0].best is not None and result.choices[0].best.largest <= 0.5
    assert result.unit == "px" and any("velocity-verlet" in note for note in result.notes)


def test_dots_outside_the_picture_do_not_count(film):
    ids = np.arange(3)
    x = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, -9.0, 0.0]])
    off, missing = pixels.distances(
        {"dots": (np.append(ids, 9), np.append(x + 0.01, x[:1], axis=0))}, {"dots": (ids, x)}, film, 1, (640, 360)
    )
    assert len(off) == 1 and off[0] > 0 and missing == 1


@pytest.fixture
def run(capfd, tmp_path, monkeypatch):
    """Run the command in this process, in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        capfd.readouterr()
        with pytest.raises(SystemExit) as left:
            main(["study", "precision", *map(str, arguments)])
        captured = capfd.readouterr()
        return left.value.code, captured.out, captured.err

    return run


def test_json_and_csv_agree(run, monkeypatch, orbits):
    monkeypatch.setattr(precision, "study", lambda *_, **__: orbits)
    code, out, err = run("kepler", "--out", "found", "--json", "--quiet")
    assert (code, err) == (0, "")
    found = json.loads(out, parse_constant=lambda word: pytest.fail(word))
    assert {p.name for p in Path("found").iterdir()} >= {"precision-kepler.json", "precision-kepler.csv"}
    rows = list(csv.DictReader(Path("found/precision-kepler.csv").read_text().splitlines()))
    assert len(rows) == len(found["points"]) == len(orbits.points)
    for row, p in zip(rows, found["points"], strict=True):
        assert (row["solver"], float(row["largest_error"])) == (p["solver"], pytest.approx(p["largest"]))
    assert json.loads(Path("found/precision-kepler.json").read_text()) == found
    code, out, _ = run("kepler")
    assert code == 0 and "cheapest" in out and "0.001" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["keplre"], "unknown problem or scene 'keplre'; did you mean 'kepler'"),
        (["kepler", "--scheme", "rk5"], "unknown scheme 'rk5'"),
        (["abc", "--scheme", "velocity-verlet"], "velocity-verlet cannot run it"),
        (["kepler", "--precision", "f16"], "unknown precision 'f16'"),
        (["kepler", "--frame", "3"], "--frame belongs to scenes"),
        (["kepler", "--count", "0"], "--count"),
        (["cloth-1e5", "--count", "9"], "'cloth-1e5' is one mesh"),
        (["kepler", "--out", " "], "--out is empty"),
        (["none.py"], "scene file 'none.py' does not exist"),
        ([], "Missing argument"),
    ],
)
def test_bad_input_is_refused_in_one_line(run, arguments, message):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    (refusal,) = err.splitlines()
    assert refusal.startswith("error: ") and message in refusal
