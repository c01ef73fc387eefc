"""Starting Taichi: named architectures never fall back, the cache is private and free of dead locks, stdout is clean."""

import os
import stat
import subprocess
import sys
import time

import pytest
import taichi as ti

from tparticles import backend
from tparticles.errors import BackendError, InputError, RunError


@pytest.fixture(autouse=True)
def _afterwards():
    yield
    backend.stop()


@pytest.fixture
def fake_probe(monkeypatch):
    """Make the probe find only what it is told to; returns the set of architectures that work."""
    works: set[str] = set()
    monkeypatch.setattr(backend, "missing", lambda arch, precision="f32": "" if arch in works else f"no {arch} here")
    monkeypatch.setattr(backend, "_has_device", lambda arch: True)
    return works


def test_a_named_architecture_never_falls_back(fake_probe):
    for arch in ("cuda", "vulkan"):
        with pytest.raises(
            BackendError, match=f"arch '{arch}' is not available: no {arch} here; use --arch cpu"
        ) as caught:
            backend.start(arch=arch)
        assert caught.value.exit_code == 3


def test_auto_falls_back_to_the_cpu(fake_probe):
    assert backend.start(arch="auto").arch == "cpu"


def test_auto_takes_no_software_rasteriser(monkeypatch):
    monkeypatch.setattr(backend, "missing", lambda *_: "")
    monkeypatch.setattr(backend, "_has_device", lambda arch: False)
    assert backend.start(arch="auto").arch == "cpu"


def test_what_is_missing_is_found_in_a_subprocess(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "x64")  # it would make every probe succeed
    backend.missing.cache_clear()
    if reason := backend.missing("cuda"):
        assert reason.startswith("an NVIDIA driver (libcuda) is needed (")
    assert backend.missing("vulkan", "f64") == "Vulkan has no f64 exp, sin or pow"
    with pytest.raises(BackendError, match="Vulkan has no f64"):
        backend.start(arch="vulkan", precision="f64")


def test_a_probe_that_dies_or_hangs_is_a_reason(monkeypatch):
    backend.missing.cache_clear()
    died = subprocess.CompletedProcess([], -11, stdout="", stderr="")
    monkeypatch.setattr(backend.subprocess, "run", lambda *_, **__: died)
    assert backend.missing("cuda") == "an NVIDIA driver (libcuda) is needed (the probe died with -11)"

    def hang(*_, **__):
        raise subprocess.TimeoutExpired("probe", 60)

    monkeypatch.setattr(backend.subprocess, "run", hang)
    assert backend.missing("vulkan") == "its driver did not answer within 60 s"
    backend.missing.cache_clear()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"arch": "vulcan"}, "unknown arch 'vulcan'; did you mean 'vulkan'"),
        ({"precision": "f46"}, r"unknown precision 'f46'; did you mean 'f\d+'"),
        ({"threads": 0}, "threads = 0: at least 1 is needed"),
    ],
)
def test_bad_options(options, message):
    with pytest.raises(InputError, match=message):
        backend.start(**options)


def test_the_same_configuration_is_kept():
    import taichi as ti

    with pytest.raises(BackendError, match="no backend is running"):
        backend.current()
    first = backend.start(arch="cpu", threads=2)
    runtime = ti.lang.impl.get_runtime().prog
    assert backend.start(arch="cpu", threads=2) == first == backend.current()
    assert ti.lang.impl.get_runtime().prog is runtime
    assert backend.start(arch="cpu", threads=1).threads == 1
    assert ti.lang.impl.get_runtime().prog is not runtime
    assert backend.start(arch="cpu", precision="f64").real == ti.f64
    backend.stop()
    with pytest.raises(BackendError, match="no backend is running"):
        backend.current()


def test_a_start_that_fails_leaves_none(monkeypatch):
    backend.start(arch="cpu", threads=2)
    monkeypatch.setenv("TPARTICLES_CACHE", os.devnull)
    with pytest.raises(BackendError, match="cannot be made"):
        backend.start(arch="cpu", threads=1)
    with pytest.raises(BackendError, match="no backend is running"):
        backend.current()


def test_the_cache_is_private(monkeypatch, tmp_path):
    monkeypatch.setenv("TPARTICLES_CACHE", str(tmp_path / "deep" / "cache"))
    folder = backend.cache_folder()
    assert folder.is_relative_to(tmp_path) and stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o755)
    assert stat.S_IMODE(backend.cache_folder().stat().st_mode) == 0o700


def test_the_cache_has_a_usual_place(monkeypatch, tmp_path):
    monkeypatch.delenv("TPARTICLES_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert backend.cache_folder().parent == tmp_path / "tparticles"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert backend.cache_folder().parent == tmp_path / ".cache" / "tparticles"


def test_dead_locks_are_removed_and_young_ones_are_not(monkeypatch, tmp_path):
    monkeypatch.setenv("TPARTICLES_CACHE", str(tmp_path))
    folder = backend.cache_folder()
    (folder / "inner").mkdir()
    old, young, other = folder / "inner" / "ticache.lock", folder / "ticache.lock", folder / "kernel.tic"
    for path in (old, young, other):
        path.touch()
    long_ago = time.time() - 61
    for path in (old, other):
        os.utime(path, (long_ago, long_ago))
    backend.cache_folder()
    assert (old.exists(), young.exists(), other.exists()) == (False, True, True)


def test_a_cache_of_another_user_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("TPARTICLES_CACHE", str(tmp_path))
    monkeypatch.setattr(backend.os, "getuid", lambda: os.stat(tmp_path).st_uid + 1)
    with pytest.raises(BackendError, match="belongs to another user"):
        backend.cache_folder()


def test_memory_is_bounded_by_the_machine():
    assert 2**28 < backend.memory() < 2**50


def test_the_environment_does_not_override_and_stdout_is_clean():
    code = (
        "import tparticles as tp; from tparticles import backend; import taichi as ti\n"
        "b = backend.start(arch='cpu', threads=1, precision='f64')\n"
        "cfg = ti.lang.impl.current_cfg()\n"
        "assert cfg.arch == ti.x64 or cfg.arch == ti.arm64, cfg.arch\n"
        "assert (cfg.default_fp, cfg.default_ip) == (ti.f64, ti.i32)\n"
        "assert cfg.cpu_max_num_threads == 1 and cfg.offline_cache and cfg.random_seed == 0\n"
        "try:\n    backend.start(arch='cuda')\nexcept tp.BackendError as error:\n    raise SystemExit(error.exit_code)\n"
    )
    loud = {"TI_ARCH": "vulkan", "TI_DEFAULT_FP": "32", "TI_DEFAULT_IP": "64", "TI_CPU_MAX_NUM_THREADS": "7"}
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **loud}, check=False
    )
    assert run.returncode in (0, 3), run.stderr  # 0 on a machine with CUDA
    assert run.stdout == ""


def test_taichi_starts_without_a_home():
    environment = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    code = "import tparticles, taichi, os; assert os.path.isdir(os.environ['HOME'])"
    subprocess.run([sys.executable, "-c", code], env=environment, check=True)


def test_only_groups_of_few_blocks_on_a_cpu_stay_in_one_thread():
    """A CPU thread gets 512 blocks of 16 at least: more particles are worth a second one. A GPU wants a thread for each."""
    cpu, gpu = backend.Backend("cpu", 2, "f32"), backend.Backend("vulkan", 2, "f32")
    assert cpu.in_one_thread(8192)
    assert not cpu.in_one_thread(8193)
    assert not gpu.in_one_thread(16)


def test_more_fields_than_taichi_has_room_for_are_refused_before_it_crashes():
    backend.stop()
    backend.start(arch="cpu", threads=1)
    with pytest.raises(RunError, match=r"call tparticles\.backend\.stop\(\) between simulations"):
        for _ in range(512):
            ti.field(ti.i32, 1)
            backend.lay_out()
