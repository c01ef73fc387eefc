"""How two pictures differ, in numbers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .tolerance import LARGE, TILE, Tolerance


@dataclass(frozen=True)
class Metrics:
    """What lies between two pictures of one size. Levels are those of 8 bits, 255 in all.

    `different`: part of the pixels that differ at all; `changed`: by more than 4 levels. `largest` [levels] of any channel.
    `mean` [levels]: signed, new less reference. `tile` [levels]: the largest magnitude of the signed mean over a tile.
    """

    different: float
    changed: float
    largest: int
    mean: float
    tile: float

    def faults(self, limits: Tolerance) -> list[str]:
        """Say in words which limits are exceeded."""
        found = []
        if self.changed > limits.changed:
            found.append(
                f"{self.changed:.3%} of the pixels differ by more than {LARGE}/255 (allowed {limits.changed:.3%})"
            )
        if self.largest > limits.largest:
            found.append(f"one differs by {self.largest}/255 (allowed {limits.largest:g}/255)")
        if abs(self.mean) > limits.mean:
            how = "brighter" if self.mean > 0 else "darker"
            found.append(f"{how} by {abs(self.mean):.4f}/255 on average (allowed {limits.mean:g}/255)")
        if self.tile > limits.tile:
            found.append(
                f"a tile of {TILE}x{TILE} pixels differs by {self.tile:.3f}/255 on average (allowed {limits.tile:g}/255)"
            )
        return found

    def row(self) -> dict[str, float]:
        """Return the numbers by name."""
        return dataclasses.asdict(self)


def difference(reference: np.ndarray, new: np.ndarray) -> np.ndarray:
    """Return new less reference, int16: bytes would wrap around.

    Raises ValueError unless both are uint8 of the same shape (h, w, 3).
    """
    if reference.dtype != np.uint8 or new.dtype != np.uint8 or reference.shape != new.shape:
        raise ValueError(f"{reference.dtype} {reference.shape} and {new.dtype} {new.shape} cannot be compared")
    return new.astype(np.int16) - reference


def measure(reference: np.ndarray, new: np.ndarray) -> Metrics:
    """Return the metrics of two pictures, uint8, shape (h, w, 3)."""
    signed = difference(reference, new)
    size = np.abs(signed).max(axis=2)
    return Metrics(
        different=float((size > 0).mean()),
        changed=float((size > LARGE).mean()),
        largest=int(size.max()),
        mean=float(signed.mean(dtype=np.float64)),
        tile=_largest_tile(signed),
    )


def _largest_tile(signed: np.ndarray) -> float:
    """Return the largest magnitude of a tile's sum over a full tile's size; a tile that is cut counts as filled up with zeros."""
    height, width, channels = signed.shape
    sums = signed.sum(axis=2, dtype=np.int64)
    sums = np.pad(sums, ((0, -height % TILE), (0, -width % TILE)))
    rows, columns = (n // TILE for n in sums.shape)
    tiles = sums.reshape(rows, TILE, columns, TILE).sum(axis=(1, 3))
    return float(np.abs(tiles).max() / (TILE * TILE * channels))
