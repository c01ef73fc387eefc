"""The same jobs on a real Dask cluster: a scheduler and two workers, one of which is killed while it works."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from batch_commands import FAST, ROOT, Commands, hashes, kill, states, until

from tparticles.batch.cluster import threads_by_host

pytest.importorskip("distributed", reason="needs Dask: pip install 'tparticles[cluster]'")
FRAMES = ("--arch", "cpu", "--no-mp4", "--frames", "1-250")


class Dask:
    """A scheduler and its workers, each a process of its own."""

    def __init__(self, folder: Path):
        self.folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        port = self.address.rpartition(":")[2]
        self.start("scheduler", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port)

    def start(self, name: str, module: str, *arguments: str) -> None:
        with open(self.folder / f"{name}.log", "wb") as log:
            self.processes[name] = subprocess.Popen(
                [sys.executable, "-m", module, *arguments, "--no-dashboard"],
                cwd=self.folder,
                env=os.environ | {"PYTHONPATH": str(ROOT)},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def worker(self, name: str, *more: str) -> None:
        options = ("--nthreads", "1", "--no-nanny", "--name", name, "--host", "127.0.0.1")
        self.start(name, "distributed.cli.dask_worker", self.address, *options, *more)

    def of(self, where: str) -> str:
        """Return the name of the worker at an address."""
        names = [name for name in self.processes if name != "scheduler"]
        return next(name for name in names if where in (self.folder / f"{name}.log").read_text())

    def close(self) -> None:
        for process in reversed(self.processes.values()):
            process.send_signal(signal.SIGKILL)
            process.wait()


@pytest.fixture(scope="module")
def dask(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dask]:
    cluster = Dask(tmp_path_factory.mktemp("dask"))
    cluster.worker("left")
    cluster.worker("right")
    yield cluster
    cluster.close()


def test_a_killed_worker_s_film_is_rendered_elsewhere_with_the_same_pixels(
    dask: Dask, run: Commands, tmp_path: Path
) -> None:
    sweep = run.start("sweep", "dots", "--seeds", "1-2", *FRAMES, "--out", "o", "--dask", dask.address, "--json")
    jobs = [tmp_path / "o/jobs" / name for name in ("seed=1", "seed=2")]
    # of the other nothing is asked: its worker may begin much later on a busy machine
    until(lambda: len(list(jobs[0].glob("frames/*.png"))) > 10, sweep)
    owner = (jobs[0] / ".tparticles.lock").read_text().split()[0]
    parent = int((Path("/proc") / owner / "stat").read_text().rpartition(")")[2].split()[1])
    kill(parent)
    assert parent in [process.pid for process in dask.processes.values()]
    assert sweep.end().code == 0, sweep
    assert states(tmp_path / "o") == {"seed=1": "done", "seed=2": "done"}
    running = [e for e in sweep.events if e.get("event") == "job" and e["state"] == "running"]
    first, second = [e["where"] for e in running if e["job"] == "seed=1"]
    assert first != second and len(running) == 3
    rows = {row["name"]: row for row in json.loads((tmp_path / "o/batch.json").read_text())["jobs"]}
    assert (rows["seed=1"]["attempts"], rows["seed=2"]["attempts"]) == (2, 1)
    alone = run("render", "dots", *FRAMES, "--seed", 1, "--out", "alone", "--quiet")
    assert alone.code == 0, alone
    assert hashes(jobs[0]) == hashes(tmp_path / "alone") and len(hashes(jobs[0])) == 250


def test_films_that_need_a_gpu_wait_for_a_worker_that_offers_one_and_then_the_scheduler_is_gone(
    dask: Dask, run: Commands, tmp_path: Path
) -> None:
    arguments = (
        "sweep",
        "dots",
        "--seeds",
        "1-2",
        "--arch",
        "cpu",
        "--no-mp4",
        "--out",
        "o",
        "--dask",
        dask.address,
        "--gpu",
    )
    sweep = run.start(*arguments, "--json", "--frames", "1-2500")
    until(lambda: (tmp_path / "o/batch.json").exists(), sweep)
    dask.worker("gpu", "--resources", "GPU=1")
    until(lambda: list(tmp_path.glob("o/jobs/*/frames/*.png")), sweep)
    assert "running" in states(tmp_path / "o").values() or sweep.process.poll() is None
    dask.processes["scheduler"].send_signal(signal.SIGKILL)
    sweep.end().refused(1, f"the Dask scheduler {dask.address} is gone", "tparticles retry")
    assert "distributed." not in sweep.err, sweep.err  # Dask's own log of the loss
    running = [e for e in sweep.events if e.get("event") == "job" and e["state"] == "running"]
    assert {dask.of(e["where"]) for e in running} == {"gpu"} and len(running) == 1
    assert set(states(tmp_path / "o").values()) == {"waiting"}


def test_a_scheduler_that_is_not_there_is_one_line(run: Commands, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        done = run("sweep", "dots", *FAST, "--out", "o", "--dask", address)
    line = done.refused(3, f"no Dask scheduler answers at {address}")
    assert len(done.err.splitlines()) == 1 and not re.search("Traceback|<", line)


def test_films_on_one_machine_share_its_cores() -> None:
    workers = {"tcp://10.0.0.1:1": 1, "tcp://10.0.0.1:2": 2, "tls://[::1]:1": 4}
    assert threads_by_host(workers) == {"10.0.0.1": 3, "::1": 4}


def test_without_dask_it_says_what_to_install(run: Commands) -> None:
    code = "import sys; sys.modules['distributed'] = None; from tparticles.cli import main; main()"
    done = run.python(code, "sweep", "dots", *FAST, "--out", "o", "--dask", "tcp://127.0.0.1:1").end()
    done.refused(2, "--dask needs Dask: pip install 'tparticles[cluster]'")
