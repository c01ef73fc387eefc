"""The film: H.264 in MP4, encoded by ffmpeg while the frames come, verified before it gets its name."""

from __future__ import annotations

import re
import threading
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import numpy as np

from ..errors import InputError, RunError, unknown
from .base import OutputFrame
from .ffmpeg import Encoder, count_frames, encode_command, find_ffmpeg
from .files import open_folder, publish, reason, temporary_path

PRESETS = ("ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo")
_LONGEST_SIDE = 16384  # [pixels] that x264 takes
# ffmpeg counts 8 bytes for each pixel of a picture with a margin of 128, whatever the format, and that must fit 31 bits.
_MARGIN, _LARGEST = 128, 2**28
_OTHERWISE = "--no-mp4"
_PATIENCE = 30.0  # [s] that an aborted ffmpeg gets to finish what it has
_STUCK = 10.0  # [s] after which an aborted write is taken to wait for ever


class Mp4:
    """Writes one film: H.264, yuv420p, bt709, exact frame rate, index in front. Frames come in order, one at a time.

    The film grows under a temporary name and gets its own when ffmpeg ended well and every frame is found in it.

    path: of the film; its folder is created if need be, leftovers of a killed run are removed.
    fps: frames per second, exact: Fraction(24), Fraction(30000, 1001).
    size: (width, height) [pixels], both even: yuv420p stores colour for blocks of 2x2. What is too large for ffmpeg is refused.
    crf: quality of x264, 0 (lossless luma) to 51; preset: its speed; threads: as many as the machine has if None.
    Raises InputError for a bad option, BackendError if ffmpeg cannot be started, RunError if the folder cannot be used.
    """

    ordered: bool = True

    def __init__(
        self,
        path: str | Path,
        *,
        fps: Fraction,
        size: tuple[int, int],
        crf: int = 18,
        preset: str = "medium",
        threads: int | None = None,
    ) -> None:
        _check(fps, size, crf, preset, threads)
        self.path = Path(path)
        self.partial_path = self.path.with_name(f"{self.path.stem}.partial{self.path.suffix}")
        self._size = size
        self._frames = 0
        self._ended = False
        self._writing = threading.Lock()
        self._exe = find_ffmpeg()
        open_folder(self.path.parent, re.escape(self.path.name))
        self._temporary = temporary_path(self.path)
        try:
            self._temporary.touch(exist_ok=False)
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        command = encode_command(
            self._exe, self._temporary, fps=Fraction(fps), size=size, crf=crf, preset=preset, threads=threads
        )
        try:
            self._encoder = Encoder(command)
        except BaseException:
            self._remove()
            raise

    @property
    def frames(self) -> int:
        """How many frames ffmpeg has taken."""
        return self._frames

    def write(self, frame: OutputFrame) -> None:
        """Hand one frame to ffmpeg; blocks while it is busy.

        Raises RunError with ffmpeg's last words if it is gone, ValueError for a frame of another size.
        """
        height, width, _ = frame.image.shape
        if (width, height) != self._size:
            raise ValueError(f"frame {frame.number} is {width}x{height}: the film is {self._size[0]}x{self._size[1]}")
        with self._writing:
            if self._ended:
                raise RunError(f"cannot write {self.path}: the film is closed")
            try:
                self._encoder.feed(np.ascontiguousarray(frame.image).data.cast("B"))
            except OSError as error:
                self._encoder.finish(_PATIENCE)
                raise self._failure() from error
            self._frames += 1

    def close(self) -> None:
        """Finish the film, count its frames and give it its name.

        Raises RunError, and removes what there is, if ffmpeg failed, if frames are missing or if there were none.
        """
        if self._ended:
            return
        code = self._encoder.finish()
        try:
            self._verify(code)
            publish(self._temporary, self.path)
        except OSError as error:
            raise RunError(f"cannot write {self.path}: {reason(error)}") from error
        finally:
            self._ended = True
            self._remove()
        with suppress(OSError):
            self.partial_path.unlink(missing_ok=True)

    def abort(self) -> None:
        """Stop early and keep what is encoded as `NAME.partial.mp4`, if it holds at least one frame."""
        if self._ended:
            return
        # A write may still be waiting for an ffmpeg that does not read any more: only its end wakes it up.
        if not self._writing.acquire(timeout=_STUCK):
            self._encoder.kill()
            self._writing.acquire()
        try:
            self._ended = True
            code = self._encoder.finish(_PATIENCE)
            with suppress(OSError):
                # Killed by a signal, it wrote no index: there is nothing to be found.
                if code >= 0 and count_frames(self._exe, self._temporary) > 0:
                    publish(self._temporary, self.partial_path)
        finally:
            self._writing.release()
            self._remove()

    def _verify(self, code: int) -> None:
        if self._frames == 0:
            raise RunError(f"cannot write {self.path}: there was no frame to put into it")
        if code != 0:
            raise self._failure()
        held = count_frames(self._exe, self._temporary)
        if held != self._frames:
            raise RunError(f"{self.path} is damaged: it holds {held} of the {self._frames} frames that were written")

    def _failure(self) -> RunError:
        taken = f"after {self._frames} frame{'' if self._frames == 1 else 's'}"
        return RunError(f"cannot write {self.path}: {self._encoder.last_words()} ({taken})")

    def _remove(self) -> None:
        with suppress(OSError):
            self._temporary.unlink(missing_ok=True)


def check_film(*, fps: Fraction, size: tuple[int, int], otherwise: str = _OTHERWISE) -> None:
    """Raise InputError where `Mp4` would, before a film is begun; `otherwise` is what it says can be done without one."""
    _check(fps, size, 18, "medium", None, otherwise)


def _check(
    fps: Fraction, size: tuple[int, int], crf: int, preset: str, threads: int | None, otherwise: str = _OTHERWISE
) -> None:
    if fps <= 0:
        raise InputError(f"fps is {fps}: must be above 0")
    if min(size) < 1:
        raise InputError(f"size is {size[0]}x{size[1]}: must be at least 2x2")
    if size[0] % 2 or size[1] % 2:
        raise InputError(f"size is {size[0]}x{size[1]}: an MP4 needs even sizes, {_even_sizes(size)} (or {otherwise})")
    if max(size) > _LONGEST_SIDE or (size[0] + _MARGIN) * (size[1] + _MARGIN) >= _LARGEST:
        width, height = _largest(size)
        raise InputError(
            f"size is {size[0]}x{size[1]}: too large for an MP4, take {width}x{height} or less (or {otherwise})"
        )
    if not 0 <= crf <= 51:
        raise InputError(f"crf is {crf}: must be 0 to 51")
    if preset not in PRESETS:
        raise unknown("preset", preset, PRESETS)
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: must be at least 1")


def _largest(size: tuple[int, int]) -> tuple[int, int]:
    """Return the largest size for an MP4 that is as wide, or as wide as can be."""
    width = min(size[0], _LONGEST_SIDE)
    height = (_LARGEST - 1) // (width + _MARGIN) - _MARGIN
    return width, min(height - height % 2, _LONGEST_SIDE)


def _even_sizes(size: tuple[int, int]) -> str:
    """Return the two nearest even sizes, such as `1918x1080 or 1920x1082`; one if below is nothing."""
    below = "x".join(str(max(2, n - n % 2)) for n in size)
    above = "x".join(str(n + n % 2) for n in size)
    return below if below == above else f"{below} or {above}"
