"""Fixtures for all tests.

A backend lasts for a module: another one drops all fields and kernels, so a module uses one of these fixtures only. Tests
that compare backends run them in subprocesses.
"""

import pytest

from tparticles import backend


@pytest.fixture(scope="module")
def cpu() -> backend.Backend:
    """The CPU backend with two threads, in the usual precision."""
    return backend.start(arch="cpu", threads=2)


@pytest.fixture(scope="module")
def cpu32() -> backend.Backend:
    """A CPU backend with two threads in f32, with no fields of earlier modules."""
    backend.stop()
    return backend.start(arch="cpu", threads=2, precision="f32")


@pytest.fixture(scope="module")
def cpu64() -> backend.Backend:
    """A CPU backend with two threads in f64, with no fields of earlier modules."""
    backend.stop()
    return backend.start(arch="cpu", threads=2, precision="f64")
