"""Fixtures for all tests."""

import pytest

from tparticles import backend


@pytest.fixture(scope="session")
def cpu() -> backend.Backend:
    """The CPU backend with two threads. Tests that need another one run it in a subprocess: a restart drops all fields."""
    return backend.start(arch="cpu", threads=2)
