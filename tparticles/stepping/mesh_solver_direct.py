"""Sparse Cholesky for Newton steps of a mesh: MKL Pardiso, or scipy's SuperLU where it is missing.

The pattern of the matrix is that of the springs and never changes: ordering and symbolic analysis are done once. Pardiso factors
the 48 000 unknowns of a 128^2 cloth in a tenth of a second on two cores, SuperLU in some seconds.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import re
import weakref
from typing import Protocol

import numpy as np

from ..errors import InputError

Array = np.ndarray
INSTALL = "pip install 'tparticles[implicit]'"


class Factors(Protocol):
    """Solves A y = b for matrices of one pattern, given as compressed rows of the upper triangle."""

    name: str

    def factor(self, values: Array) -> bool:
        """Take in the numbers of A; False where A is not positive definite."""
        ...

    def solve(self, b: Array) -> Array:
        """Return y of the matrix taken in last."""
        ...


def available() -> str | None:
    """Return the direct solver that is installed: `"pardiso"`, `"superlu"` or None."""
    if _mkl() is not None:
        return "pardiso"
    try:
        import scipy.sparse.linalg  # noqa: F401
    except ImportError:
        return None
    return "superlu"


def factors(starts: Array, columns: Array) -> Factors:
    """Return the best direct solver there is, for a pattern.

    Raises
    ------
    InputError
        Neither MKL nor scipy is installed.
    """
    name = available()
    if name is None:
        raise InputError(f"the direct solver of spring meshes needs MKL or scipy: {INSTALL}")
    return Pardiso(starts, columns) if name == "pardiso" else SuperLU(starts, columns)


@functools.cache
def _mkl() -> ctypes.CDLL | None:
    """Load MKL's library from the files of its package."""
    try:
        files = importlib.metadata.files("mkl") or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        if re.fullmatch(r"(lib)?mkl_rt(\.\d+)?\.(so|dll|dylib)(\.\d+)?", file.name):
            try:
                return ctypes.CDLL(str(file.locate()))
            except OSError:
                continue
    return None


class Pardiso:
    """MKL Pardiso, symmetric positive definite. The same bits for any number of threads."""

    name = "pardiso"
    _DEFINITE = 2  # mtype: real, symmetric, positive definite
    _ANALYSE, _FACTOR, _SOLVE, _RELEASE = 11, 22, 33, -1
    # MKL's iparm(34): sums are split as for so many threads, however many there are.
    _REPRODUCIBLE_THREADS = 2
    # MKL's iparm(2) and iparm(19), what a factorisation takes [Mflop]. Minimum degree suits sheets (a third less time), nested
    # dissection solids (two thirds).
    _ORDERING, _DISSECTION, _MINIMUM_DEGREE = 1, 3, 0
    _WORK = 18

    def __init__(self, starts: Array, columns: Array):
        library = _mkl()
        assert library is not None
        self._call, self._starts, self._columns = library.pardiso, starts, columns
        self._handle = np.zeros(64, np.int64)
        self._options = np.zeros(64, np.int32)
        self._options[0] = 1  # the options below, not the default ones
        self._options[33] = self._REPRODUCIBLE_THREADS
        self._options[34] = 1  # indices count from 0
        self._values: Array | None = None
        weakref.finalize(self, _release, self._call, self._handle, self._options, len(starts) - 1)

    def factor(self, values: Array) -> bool:
        """Take in the numbers of A; False where A is not positive definite."""
        analysed, self._values = self._values is not None, values
        if not analysed and not self._analyse():
            return False
        return self._run(self._FACTOR, None, None) == 0

    def _analyse(self) -> bool:
        """Order the unknowns, the way that makes the factorisation cheaper."""
        work = {how: self._ordered(how) for how in (self._DISSECTION, self._MINIMUM_DEGREE)}
        if work[self._DISSECTION] < work[self._MINIMUM_DEGREE]:
            self._ordered(self._DISSECTION)
        return min(work.values()) < np.inf

    def _ordered(self, how: int) -> float:
        """Order the unknowns; return the work that a factorisation then takes [Mflop], infinite where it fails."""
        self._options[self._ORDERING], self._options[self._WORK] = how, -1  # -1: to be told
        _release(self._call, self._handle, self._options, len(self._starts) - 1)
        return float(self._options[self._WORK]) if self._run(self._ANALYSE, None, None) == 0 else np.inf

    def solve(self, b: Array) -> Array:
        """Return y of the matrix taken in last, not a number where it fails."""
        y = np.empty_like(b)
        return y if self._run(self._SOLVE, b, y) == 0 else np.full_like(b, np.nan)

    def _run(self, phase: int, b: Array | None, y: Array | None) -> int:
        arrays = (self._values, self._starts, self._columns)
        return _pardiso(self._call, self._handle, self._options, phase, len(self._starts) - 1, arrays, b, y)


def _pardiso(call, handle: Array, options: Array, phase: int, n: int, arrays, b: Array | None, y: Array | None) -> int:
    """Call `pardiso(pt, maxfct, mnum, mtype, phase, n, a, ia, ja, perm, nrhs, iparm, msglvl, b, x, error)`."""

    def number(value: int):
        return ctypes.byref(ctypes.c_int32(value))

    def data(array: Array | None):
        return None if array is None else array.ctypes.data_as(ctypes.c_void_p)

    error = ctypes.c_int32(0)
    a, ia, ja = (data(array) for array in arrays)
    mtype = number(Pardiso._DEFINITE)
    head = (data(handle), number(1), number(1), mtype, number(phase), number(n), a, ia, ja, None, number(1))
    call(*head, data(options), number(0), data(b), data(y), ctypes.byref(error))
    return error.value


def _release(call, handle: Array, options: Array, n: int) -> None:
    _pardiso(call, handle, options, Pardiso._RELEASE, n, (None, None, None), None, None)


class SuperLU:
    """scipy's SuperLU with minimum degree ordering and no pivoting, which a positive definite matrix does not need."""

    name = "superlu"

    def __init__(self, starts: Array, columns: Array):
        from scipy.sparse import csr_matrix

        size = len(starts) - 1
        # Number the entries, mirror them, and read off where each number of the full matrix comes from.
        upper = csr_matrix((np.arange(1, len(columns) + 1), columns, starts), (size, size))
        rows = np.repeat(np.arange(size), np.diff(starts))
        below = upper.copy()
        below.data = np.where(columns > rows, upper.data, 0)
        self._full = (upper + below.T).tocsc()
        self._take = np.asarray(self._full.data, np.int64) - 1
        self._solver = None

    def factor(self, values: Array) -> bool:
        """Take in the numbers of A; False where A is singular."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        if not np.isfinite(values).all():
            return False
        a = csc_matrix((values[self._take], self._full.indices, self._full.indptr), self._full.shape)
        try:
            self._solver = splu(a, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:
            return False
        return True

    def solve(self, b: Array) -> Array:
        """Return y of the matrix taken in last."""
        assert self._solver is not None
        return self._solver.solve(b)
