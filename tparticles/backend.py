"""The only place that starts Taichi: architecture, threads, precision, kernel cache.

`auto` looks for a GPU in a subprocess (a failing driver may crash the process that asks) and falls back to the CPU;
an architecture that the user named never falls back. One process holds one backend; asking again with the same
configuration keeps it and every compiled kernel, asking for another one resets Taichi and drops all fields.
"""

from __future__ import annotations

import contextlib
import functools
import io
import math
import os
import stat
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import taichi as ti
from taichi.lang import impl

from . import tracing  # noqa: F401  # it makes Taichi's tracer quick
from .errors import BackendError, InputError, RunError, unknown

Arch = Literal["auto", "cpu", "cuda", "vulkan"]
Precision = Literal["f32", "f64"]

# A lock is held for milliseconds; one this old belongs to a process that was killed.
_DEAD_LOCK_AGE = 60.0  # [s]
_LAYOUTS = 480  # Taichi has room for 512 trees of fields, and does not look when it is full
_PROBE_TIMEOUT = 60.0  # [s]
_QUICK, _THOROUGH = 0, 1  # levels of Taichi's own optimisation
GRAIN = 512  # iterations that Taichi gives one CPU thread at least
_LANES = 16  # particles in a lane block: one AVX-512 register of f32; wider blocks spill (tests/bench/fused.py)


@dataclass(frozen=True)
class Backend:
    """What Taichi runs on. `lanes` is the number of particles that one block of the fused stepper walks together."""

    arch: str
    threads: int
    precision: str

    @property
    def is_cpu(self) -> bool:
        """True where loops run on CPU threads and lane blocks vectorise."""
        return self.arch == "cpu"

    @property
    def lanes(self) -> int:
        """Particles per block: 16 on a CPU, one per thread on a GPU."""
        return _LANES if self.is_cpu else 1

    def in_one_thread(self, count: int) -> bool:
        """Whether a loop over the blocks of `count` particles has too few iterations for more than one CPU thread.

        It is serialised then: where encoders keep all cores busy, waking another thread takes longer than the work.
        """
        return self.is_cpu and count <= GRAIN * self.lanes

    @property
    def real(self) -> Any:
        """The Taichi type of state and coefficients."""
        return ti.f64 if self.precision == "f64" else ti.f32


_current: Backend | None = None


def current() -> Backend:
    """Return the running backend; a program that forgot to start one gets a clear error."""
    if _current is None:
        raise BackendError("no backend is running: call tparticles.backend.start() or make a Simulation first")
    return _current


def start(*, arch: str = "auto", threads: int | None = None, precision: str = "f32") -> Backend:
    """Start Taichi, or keep the running one if it was started with the same configuration.

    Arguments:
        arch: `auto`, `cpu`, `cuda` or `vulkan`. A named one never falls back.
        threads: CPU threads, 1 or more; all cores by default. Ignored on a GPU.
        precision: `f32` or `f64` for state and coefficients.

    Raises:
        InputError: an unknown name or a thread count below 1.
        BackendError: the named architecture or precision is not to be had here; the message says what is missing.
    """
    global _current
    if arch not in get_args(Arch):
        raise unknown("arch", arch, get_args(Arch))
    if precision not in get_args(Precision):
        raise unknown("precision", precision, get_args(Precision))
    if threads is not None and threads < 1:
        raise InputError(f"threads = {threads}: at least 1 is needed")
    wanted = Backend(_resolve(arch, precision), threads or cores(), precision)
    if wanted != _current:
        _current = None  # a start that fails leaves none
        _initialise(wanted)
        _current = wanted
    return wanted


def stop() -> None:
    """Stop Taichi: fields and kernels of every simulation are dropped and their memory is given back.

    A process that makes many simulations calls this between them: nothing else frees the fields of an old one.
    """
    global _current
    _current = None
    ti.reset()


@contextlib.contextmanager
def thorough() -> Iterator[None]:
    """Let Taichi optimise the kernels that are launched for the first time within.

    LLVM optimises all there is; what Taichi does before takes longer than all the rest, the more so the longer a kernel is,
    and mostly gains a few per cent. But loops that add to a field in place need it: until Taichi has merged the loads of a
    field's address LLVM repeats them after every store, and does not vectorise. The film is drawn twice to three times as
    fast.
    """
    config = impl.current_cfg()
    config.opt_level = _THOROUGH
    try:
        yield
    finally:
        config.opt_level = _QUICK


def lay_out() -> None:
    """Lay out the fields that were declared so far: kernels that use them do not depend on what is declared later.

    Raises:
        RunError: Taichi would have more layouts than it can hold, where it would crash.
    """
    count = len(ti.FieldsBuilder._finalized_roots())
    if count >= _LAYOUTS:
        raise RunError(
            f"Taichi holds the fields of {count} parts of scenes, of earlier simulations too, and bears no more: call "
            "tparticles.backend.stop() between simulations, or take fewer groups"
        )
    ti.sync()


def memory() -> float:
    """Return how much memory this process may use [bytes]: the machine's or its container's; infinite if unknown."""
    try:
        found = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        found = math.inf
    for limit in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        with contextlib.suppress(OSError, ValueError):  # "max": no limit
            found = min(found, float(int(Path(limit).read_text())))
    return found


def cores() -> int:
    """Return how many CPU cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _resolve(arch: str, precision: str) -> str:
    if arch == "auto":
        return next((name for name in ("cuda", "vulkan") if _has_device(name) and not missing(name, precision)), "cpu")
    if arch != "cpu" and (reason := missing(arch, precision)):
        raise BackendError(f"arch '{arch}' is not available: {reason}; use --arch cpu or --arch auto")
    return arch


def _has_device(arch: str) -> bool:
    """Whether hardware is there at all; `auto` never picks a software rasteriser, which is slower than the CPU path."""
    if not sys.platform.startswith("linux"):
        return True
    nodes = {"cuda": ["/dev/nvidiactl", "/dev/dxg"], "vulkan": ["/dev/nvidiactl", "/dev/dri/renderD128"]}
    return any(Path(node).exists() for node in nodes[arch])


@functools.cache
def missing(arch: str, precision: str = "f32") -> str:
    """Try the architecture in a subprocess; return what is missing, or an empty string where it works."""
    if arch == "vulkan" and precision == "f64":
        return "Vulkan has no f64 exp, sin or pow"
    code = f"import taichi as ti; ti.init(arch=ti.{arch}, enable_fallback=False, offline_cache=False, verbose=False)"
    try:
        probe = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=_PROBE_TIMEOUT, env=_environment()
        )
    except subprocess.TimeoutExpired:
        return f"its driver did not answer within {_PROBE_TIMEOUT:.0f} s"
    if probe.returncode == 0:
        return ""
    library = {"cuda": "an NVIDIA driver (libcuda)", "vulkan": "a Vulkan driver (libvulkan and an ICD)"}[arch]
    lines = [line for line in (probe.stderr or probe.stdout).splitlines() if line.strip()]
    return f"{library} is needed ({lines[-1].strip()[:200] if lines else f'the probe died with {probe.returncode}'})"


def _environment() -> dict[str, str]:
    """Return the environment without what would override the architecture that was asked for."""
    return {name: value for name, value in os.environ.items() if name != "TI_ARCH"}


def _initialise(backend: Backend) -> None:
    # Taichi folds constants with NumPy: what a law makes of sqrt(-1.0) is found, and told, when it is run.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module=r"taichi\.lang\.")
    os.environ.pop("TI_ARCH", None)
    with contextlib.redirect_stdout(io.StringIO()):  # Taichi prints the architecture; stdout is for --json
        ti.init(
            arch=getattr(ti, backend.arch),
            default_fp=backend.real,
            default_ip=ti.i32,
            cpu_max_num_threads=backend.threads,
            # Part of the cache key: a changing value would compile every kernel again.
            random_seed=0,
            opt_level=_QUICK,
            offline_cache=True,
            offline_cache_file_path=str(cache_folder()),
            enable_fallback=False,
            # Static loops go over attributes, of which a scheme with a long past has more than the 32 that Taichi warns of.
            unrolling_limit=0,
            verbose=False,
            log_level=ti.ERROR,
        )


def cache_folder() -> Path:
    """Return the private kernel cache, made with mode 0700 (cached kernels are code) and freed of dead locks.

    `TPARTICLES_CACHE` overrides the place; the default is `$XDG_CACHE_HOME/tparticles` or `~/.cache/tparticles`.
    """
    base = os.environ.get("TPARTICLES_CACHE") or os.path.join(
        os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "tparticles"
    )
    folder = Path(base) / f"kernels-{'.'.join(map(str, ti.__version__))}"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = folder.stat()
    except OSError as error:
        raise BackendError(
            f"the kernel cache {folder} cannot be made: {error.strerror}; set TPARTICLES_CACHE to a folder of yours"
        ) from None
    if hasattr(os, "getuid") and owner.st_uid != os.getuid():
        raise BackendError(f"the kernel cache {folder} belongs to another user; set TPARTICLES_CACHE to one of yours")
    if stat.S_IMODE(owner.st_mode) != 0o700:
        folder.chmod(0o700)
    for lock in folder.rglob("*.lock"):
        try:
            if time.time() - lock.stat().st_mtime > _DEAD_LOCK_AGE:
                lock.unlink()
        except FileNotFoundError:
            continue  # its owner finished meanwhile
    return folder
