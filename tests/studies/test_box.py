"""Scott's spring box: limits against linear theory, verdicts, what the command prints, the film."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tparticles import schemes
from tparticles.cli import main
from tparticles.errors import BackendError
from tparticles.output.mp4 import find_ffmpeg
from tparticles.studies import box, report
from tparticles.studies.box_paper import DAMPING, DRAG, DT, TABLE

KEYS = ["scheme", "grows_at", "blows_up_at", "spread", "evaluations", "microseconds", "index"]


@pytest.mark.parametrize(
    "name, stiffness",
    [("euler", DAMPING / DT + DRAG / (8 * DT)), ("midpoint", 239), ("velocity-verlet", 4979), ("rk4", 10022)],
)
def test_theory_of_the_stiffest_mode(name, stiffness):
    assert box.theory(schemes.get(name), dt=DT) == pytest.approx(stiffness, rel=5e-3)


def test_theory_of_what_always_or_never_grows():
    assert box.theory(schemes.get("milne"), dt=DT) == 0
    assert box.theory(schemes.get("backward-euler"), dt=DT) is None


def test_the_first_stiffness_that_grows_is_bracketed():
    assert box.first(lambda k: k > 300, fine=12) == pytest.approx(300, rel=1e-3)
    assert box.first(lambda k: True) == 0
    assert box.first(lambda k: False) is None


def test_verdicts_on_energies():
    from tparticles.studies.box_run import judged

    t = np.arange(61.0)
    decaying, rising, exploding = 20 * np.exp(-t / 30), 20 * np.exp(t / 60), 20 * np.exp(t / 5)
    assert [(v.grew, v.blew) for v in map(judged, (decaying, rising, exploding))] == [
        (False, False),
        (True, False),
        (True, True),
    ]
    kicked = decaying.copy()
    kicked[45:] += 3  # from nowhere, long after it came to rest
    assert judged(kicked).grew
    assert judged(np.array([20.0, np.nan])).blew


def test_a_drop_is_the_same_again_and_squeezed_by_its_energy():
    from tparticles.studies.box_run import SIZE, Drop

    x, v = Drop.of(3).state(50.0)
    again = Drop.of(3).state(50.0)
    assert np.array_equal(x, again[0]) and np.array_equal(v, again[1])
    assert not np.array_equal(x, Drop.of(4).state(50.0)[0])
    assert (np.abs(x[:, :2]) < 7.5).all() and (x[:, 2] > 0).all() and (x[:, 2] < 15).all()
    # every pair of vertices is joined, and all springs are shortened alike
    lengths = np.linalg.norm(x[:, None] - x, axis=-1)[np.triu_indices(8, 1)]
    shortened = 1 - lengths.max() / (SIZE * 3**0.5)
    energy = 0.5 * 50 * ((lengths * shortened / (1 - shortened)) ** 2).sum()
    assert energy == pytest.approx(Drop.of(3).squeeze, rel=1e-9)


@pytest.fixture(scope="module")
def found():
    """The study of two schemes, one drop each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(box, "VARIED", ())
        return {b.scheme: b for b in box.study([schemes.get(n) for n in ("velocity-verlet", "rk4")], drops=1).boxes}


@pytest.mark.parametrize("name", ["velocity-verlet", "rk4"])
def test_limits_in_the_air_are_those_of_theory_and_the_room_only_lowers_them(found, name):
    b = found[name]
    assert b.air == pytest.approx(b.theory, rel=5e-3)
    assert 0.6 * b.theory < b.grows_at <= b.blows_up_at < 1.03 * b.theory
    assert b.microseconds > 0
    assert b.index == pytest.approx((b.grows_at + b.blows_up_at) / 2 / b.microseconds)


def test_rk4_grows_in_the_room_as_in_the_air(found):
    b = found["rk4"]
    assert abs(b.grows_at - b.theory) <= b.spread


def test_every_evaluation_counts(found):
    # drag makes the force depend on the velocity: the one at the end of a Verlet step is not that of the next one's beginning
    assert [found[n].evaluations for n in ("velocity-verlet", "rk4")] == [2, 4]


def test_the_command_prints_the_contract_and_keeps_files(capfd, tmp_path):
    with pytest.raises(SystemExit) as left:
        main(
            [
                "study",
                "box",
                "--json",
                "--seeds",
                "2",
                "--scheme",
                "euler",
                "--scheme",
                "yoshida4",
                "--out",
                str(tmp_path),
            ]
        )
    printed = json.loads(capfd.readouterr().out)
    assert left.value.code == 0
    assert [list(row) for row in printed] == [KEYS]
    (euler,) = printed
    assert euler["scheme"] == "euler" and euler["evaluations"] == 1
    # growth has to be seen against drag, within a minute
    assert 10.5 < euler["grows_at"] < euler["blows_up_at"] < 23
    kept = json.loads((tmp_path / "box.json").read_text())
    assert kept["refused"] == ["yoshida4"]
    assert kept["boxes"][0]["air"] == pytest.approx(10.5, rel=0.03)
    grows = kept["boxes"][0]["grows"]
    assert np.ptp(grows) < euler["spread"] < np.ptp(grows) + 0.01 * max(grows)
    pictures = {"box-time.png", "box-index.png"} if report.has_matplotlib() else set()
    assert {p.name for p in tmp_path.iterdir()} == {"box.json", "box.csv", *pictures}


def test_an_implicit_scheme_never_grows(monkeypatch):
    monkeypatch.setattr(box, "_IMPLICIT_HORIZON", 1)
    (b,) = box.study([schemes.get("backward-euler")], drops=1).boxes
    assert (b.grows_at, b.blows_up_at, b.spread, b.index) == (None, None, None, None)


@pytest.mark.skipif(not report.has_matplotlib(), reason="matplotlib is missing")
def test_no_index_is_drawn_where_no_scheme_has_one(capfd, tmp_path, monkeypatch):
    monkeypatch.setattr(box, "_IMPLICIT_HORIZON", 1)
    (tmp_path / "box.json").write_text("{}")
    (tmp_path / "box-index.png").write_bytes(b"of another run")
    with pytest.raises(SystemExit) as left:
        main(["study", "box", "--seeds", "1", "--scheme", "backward-euler", "--out", str(tmp_path)])
    assert left.value.code == 0 and "no box-index.png" in capfd.readouterr().err
    assert {p.name for p in tmp_path.iterdir()} == {"box.json", "box.csv", "box-time.png"}


@pytest.mark.skipif(not report.has_matplotlib(), reason="matplotlib is missing")
def test_labels_keep_apart():
    from tparticles.studies.box_pictures import spread

    assert spread([], 1.0).tolist() == []
    assert spread([0.0, 5.0], 1.0).tolist() == [0.0, 5.0]
    assert spread([0.0, 3.0, 3.0, 3.0, 9.0], 1.0).tolist() == [0.0, 2.0, 3.0, 4.0, 9.0]


def test_what_is_said_of_it(found):
    from tparticles.studies.box_text import summary

    text = summary(box.BoxStudy(DT, 1, 60, tuple(found.values()), (), ()))
    assert "3200-4200" in text and "8700-9300" in text and "per force evaluation" in text
    assert {row.scheme for row in TABLE} <= set(schemes.CATALOGUE)


def test_the_film_shows_every_scheme(tmp_path, monkeypatch):
    from tparticles.studies import box_film

    try:
        find_ffmpeg()
    except BackendError as error:
        pytest.skip(f"no film: {error}")
    monkeypatch.setattr(box_film, "CELL", 64)
    written = box_film.film([schemes.get("euler")], 100.0, tmp_path, seconds=0.8, tell=lambda _: None)
    assert [path.name for path in written] == ["box-film.mp4", "box-film.png"]
    assert all(path.stat().st_size > 500 for path in written)


@pytest.mark.parametrize(
    "options, message",
    [
        (["--film", "10", "--scheme", "yoshida4"], "yoshida4"),
        (["--scheme", "yoshida4"], "yoshida4"),
        (["--film", "10", "--json"], "--film"),
        (["--seeds", "0"], "--seeds"),
    ],
)
def test_bad_input_is_one_line(capfd, tmp_path, options, message):
    with pytest.raises(SystemExit) as left:
        main(["study", "box", *options, "--out", str(tmp_path)])
    out, err = capfd.readouterr()
    assert left.value.code == 2
    assert message in out + err and "Traceback" not in err
