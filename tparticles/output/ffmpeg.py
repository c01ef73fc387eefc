"""The ffmpeg program: where it is, how it is started, what it said, how many frames a film holds."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
from fractions import Fraction
from pathlib import Path
from typing import IO

from ..errors import BackendError

_TAIL_BYTES = 8192
_PROBE_TIMEOUT = 10.0  # [s]
_HOW_TO_GET_IT = 'install it with pip install "imageio[ffmpeg]", name one in IMAGEIO_FFMPEG_EXE, or use --no-mp4'


def find_ffmpeg() -> str:
    """Return the path of ffmpeg: IMAGEIO_FFMPEG_EXE, the one that comes with imageio-ffmpeg, or the system's.

    Raises BackendError if there is none. What IMAGEIO_FFMPEG_EXE names is not looked at before it is started.
    """
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError) as error:
        raise BackendError(f"ffmpeg was not found, and the film needs it: {_HOW_TO_GET_IT}") from error


def check_ffmpeg() -> str:
    """Return the path of an ffmpeg that starts. Raises BackendError if there is none."""
    exe = find_ffmpeg()
    probe = Encoder([exe, "-version"])
    if probe.finish(_PROBE_TIMEOUT):
        raise BackendError(f"{exe} does not work ({probe.last_words()}), and the film needs it: {_HOW_TO_GET_IT}")
    return exe


def encode_command(
    exe: str, path: Path, *, fps: Fraction, size: tuple[int, int], crf: int, preset: str, threads: int | None
) -> list[str]:
    """Return the command that reads raw RGB frames from its input and writes an H.264 film to `path`.

    RGB must be turned to YUV by the bt709 matrix *and* be tagged as such, or players shift the colours; the frame rate
    goes in as a fraction, so that it is exact; `file:` keeps odd names from being read as options or protocols.
    """
    to_yuv = "scale=in_range=pc:out_range=tv:out_color_matrix=bt709:flags=bicubic+accurate_rnd+full_chroma_int"
    tags = "setparams=range=tv:color_primaries=bt709:color_trc=bt709:colorspace=bt709"
    return [
        *(exe, "-hide_banner", "-nostats", "-loglevel", "error", "-y"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}"),
        *("-framerate", f"{fps.numerator}/{fps.denominator}", "-i", "pipe:0"),
        *("-vf", f"{to_yuv},format=yuv420p,{tags}", "-c:v", "libx264", "-crf", str(crf), "-preset", preset),
        *(() if threads is None else ("-threads", str(threads))),
        *("-map_metadata", "-1", "-movflags", "+faststart", "-f", "mp4", f"file:{path.absolute()}"),
    ]


class Encoder:
    """A running ffmpeg that is fed through its standard input.

    It has a session of its own, so a Ctrl-C in the terminal reaches only us and we decide how it ends. What it says
    is drained by a thread, so it cannot block on a full pipe, and only the tail is kept.
    Raises BackendError if it cannot be started.
    """

    def __init__(self, command: list[str]) -> None:
        try:
            self._process = subprocess.Popen(
                command,
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            failed = f"{command[0]}: {error.strerror}"
            raise BackendError(
                f"ffmpeg cannot be started ({failed}), and the film needs it: {_HOW_TO_GET_IT}"
            ) from error
        assert self._process.stdin is not None and self._process.stderr is not None
        self._stdin: IO[bytes] = self._process.stdin
        self._stderr: IO[bytes] = self._process.stderr
        self._tail = b""
        self._listener = threading.Thread(target=self._listen, name="ffmpeg-stderr", daemon=True)
        self._listener.start()

    @property
    def pid(self) -> int:
        """The process id."""
        return self._process.pid

    def feed(self, data: memoryview) -> None:
        """Send all of `data` (bytes). Blocks while ffmpeg is busy. Raises OSError if it is gone."""
        while data:
            data = data[self._stdin.write(data) :]

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def finish(self, timeout: float | None = None) -> int:
        """Say that no more frames come, wait for the end and return the exit code; kill it after `timeout` [s].

        May be called again, also after an interruption.
        """
        self._stdin.close()
        try:
            code = self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.kill()
            code = self._process.wait()
        self._listener.join()
        self._stderr.close()
        return code

    def last_words(self) -> str:
        """Return how it ended and the last line it said that is more than "Conversion failed!", without addresses."""
        code = self._process.returncode
        said = re.sub(r" @ 0x[0-9a-f]+", "", self._tail.decode(errors="replace"))
        lines = [line.strip() for line in said.splitlines()]
        lines = [line for line in lines if line and line != "Conversion failed!"]
        ended = f"was killed by {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
        return f"ffmpeg {ended}" + (f": {lines[-1]}" if lines else "")

    def _listen(self) -> None:
        while chunk := self._stderr.read(4096):
            self._tail = (self._tail + chunk)[-_TAIL_BYTES:]


def count_frames(exe: str, path: Path) -> int:
    """Return how many frames the film at `path` holds, as ffmpeg finds them when it copies the stream; 0 if unreadable.

    Nothing is decoded, so this takes milliseconds. `imageio_ffmpeg.count_frames_and_secs` decodes the whole film.
    A frame whose bytes are cut would be counted as well, without `discardcorrupt`.
    """
    command = [exe, "-hide_banner", "-nostats", "-loglevel", "error", "-fflags", "+discardcorrupt"]
    command += ["-i", f"file:{path.absolute()}"]
    command += ["-map", "0:v:0", "-c", "copy", "-f", "null", "-progress", "pipe:1", os.devnull]
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
    )
    counts = [line[6:] for line in done.stdout.decode(errors="replace").splitlines() if line.startswith("frame=")]
    return int(counts[-1]) if counts and done.returncode == 0 else 0


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
