"""One render: a scene script, its options, and the folder where frames, film, states and run.json go."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import platform
import shutil
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

from . import __version__, output, schemes
from .backend import Arch, Precision
from .checkpoint import Interval
from .errors import InputError, unknown
from .library import load
from .parameter import description, plain
from .render.appearance import Picture
from .resume import Start, find_start, picture_check, with_last
from .scene import QUALITIES, Scene, frame_numbers, frame_rate
from .shoot import Source, shoot
from .simulation import WHOLE, Frame, Share, Simulation

_BYTES_PER_PIXEL = 70  # film, tone curve and picture at their peak, as measured at 16384x16384
_EVERY = "10s"  # between checkpoints: a shorter render makes none
_POSES = 10_000  # of a moving camera, looked at before the film begins
_LONGEST_SPAN = 60  # characters; file names have 255 at most


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the command line can ask for; None takes the scene's own."""

    out: Path | None = None
    frames: str | None = None
    fps: str | None = None
    size: tuple[int, int] | None = None
    quality: str = "final"
    settings: Mapping[str, Any] = field(default_factory=dict)
    seed: int | None = None
    scheme: str | None = None
    precision: str = "f32"
    arch: str = "auto"
    threads: int | None = None
    png: bool = True
    mp4: bool = True
    states: bool = False
    existing: str = "error"
    resume: bool = False
    checkpoint_every: str | None = None


class Job:
    """A validated render: what can be wrong with the request is found here, before anything is written.

    Raises:
        InputError: the script, a setting, a size, a frame range.
    """

    def __init__(self, scene: str, options: Options):
        self.options = options
        _check(options)
        self.script = load(scene)
        self.settings = dict(options.settings)
        if options.seed is not None and "seed" in self.script.parameters:
            if "seed" in self.settings:
                raise InputError("the seed is given twice: leave out --seed or --set seed")
            self.settings["seed"] = options.seed
        self.scene = self._scene()
        self.size = self.scene.resolution(options.quality)  # type: ignore[arg-type]
        self.frames = frame_numbers("1-" if options.frames is None else options.frames, self.scene.frame_count)
        self.out = Path("renders") / self.script.name if options.out is None else options.out
        if options.mp4:
            output.check_film(fps=self.scene.fps, size=self.size)
        _check_memory(self.size)
        self._check_camera()
        self.identity = self._identity()
        # A film alone keeps no frames to go on from, and is not slowed down to keep some unless that is asked for.
        keeps = options.png or options.resume or not options.mp4
        self.interval = Interval.read(options.checkpoint_every or (_EVERY if keeps else "off"))
        self.checkpoints = self.out / output.CHECKPOINTS
        self.pictures = self._pictures()
        if options.resume and options.mp4 and self.pictures is None:
            raise InputError(
                "--resume: a film is made anew of its pictures; leave out --no-png or --checkpoint-every off"
            )

    def _pictures(self) -> Path | None:
        """Return where frames go: the film is made anew of them when a run is resumed."""
        if self.options.png:
            return self.out / "frames"
        return self.checkpoints / "frames" if self.options.mp4 and not self.interval.never else None

    def _scene(self) -> Scene:
        o = self.options
        scene = self.script.build(quality=o.quality, settings=self.settings)
        if o.scheme is None:
            scene = scene.of_quality(o.quality)
        changes = {
            "fps": None if o.fps is None else frame_rate(o.fps),
            "size": o.size,
            "seed": o.seed,
            "scheme": None if o.scheme is None else schemes.get(o.scheme),
        }
        return dataclasses.replace(scene, **{k: v for k, v in changes.items() if v is not None})

    def _check_camera(self) -> None:
        """Find a moving camera that looks at itself before the first frame is drawn, not at the hundredth."""
        camera, last = self.scene.camera, self.frames[-1]
        if camera.moves:
            for frame in range(0, last + 1, 1 + last // _POSES):
                camera.pose(float(frame / self.scene.fps))

    def _identity(self) -> str:
        """A hash of all that decides the pictures, whatever machine draws them and whichever frames are asked for.

        The script's text, its parameters, what it described (a script may read other files), and what draws it.
        """
        parts = {
            "versions": {"tparticles": __version__, "taichi": version("taichi")},
            "script": hashlib.sha256(self.script.source.encode()).hexdigest(),
            "settings": self.script.values(self.settings),
            "scene": description(self.scene),
            "background": _picture_hash(self.scene.background),
            "quality": self.options.quality,
            "size": self.size,
            "precision": self.options.precision,
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=description).encode()).hexdigest()[:16]

    @property
    def _own_schemes(self) -> dict[str, str]:
        """The schemes of the meshes that have one of their own, by name."""
        return {mesh.name: mesh.scheme.name for mesh in self.scene.meshes if mesh.scheme is not None}

    @property
    def film_path(self) -> Path:
        """Where the MP4 goes; a part of the film never takes the name of the whole."""
        whole = len(self.frames) == self.scene.frame_count
        return self.out / f"{self.script.name}{'' if whole else '.frames-' + _span(self.frames)}.mp4"

    def header(self) -> dict[str, Any]:
        """Return what run.json says of the run as a whole."""
        return {
            "scene": self.script.name,
            "scene_hash": self.identity,
            "script": str(self.script.path),
            "parameters": {name: plain(value) for name, value in self.script.values(self.settings).items()},
            "quality": self.options.quality,
            "size": list(self.size),
            "fps": str(self.scene.fps),
            "frame_count": self.scene.frame_count,
            "seed": self.scene.seed,
            "scheme": schemes.describe(self.scene.scheme),
            "steps": repr(self.scene.steps),
            "clamp": self.scene.clamp,
            "meshes": {
                mesh.name: {
                    "scheme": (mesh.scheme or self.scene.scheme).name,
                    "steps": repr(mesh.steps or self.scene.steps),
                }
                for mesh in self.scene.meshes
            },
            "precision": self.options.precision,
            "versions": {
                "tparticles": __version__,
                "python": platform.python_version(),
                **{name: version(name) for name in ("taichi", "numpy", "pillow", "imageio-ffmpeg")},
            },
        }

    def run(
        self,
        progress: Callable[[Frame, int], None] = lambda frame, done: None,
        *,
        tell: Callable[[str], None] = lambda text: None,
        source: Callable[[], Source] | None = None,
        anywhere: bool = False,
        last: Path | None = None,
    ) -> dict[str, Any]:
        """Render; call `progress(frame, frames done)` for each frame; return what run.json holds.

        `tell` hears what is worth a line: a checkpoint that is refused, or where a resumed run goes on. `source` makes what the
        frames come from, the scene's own simulation by default; `anywhere`: it makes a frame without those before it. `last`: a
        file that is there when all is done.

        Raises:
            InputError, BackendError: found before anything is written, but for what only a running kernel can tell.
            RunError: something failed on the way; finished frames stay, run.json says "failed".
            KeyboardInterrupt: passed on after what is finished has been kept and run.json says "interrupted".
        """
        others = {m: own for m, own in self._own_schemes.items() if self.options.scheme not in (None, own)}
        for mesh, own in others.items():
            tell(f"--scheme {self.options.scheme} is not for group '{mesh}', which has a scheme of its own: {own}")
        frames = self._prepare(source or self.simulation)
        arch = frames.backend.arch
        owner = self.owner(arch)
        with output.held_folder(self.out):
            output.claim_folder(self.out, scene=self.script.name, identity=owner, existing=self._existing())
            rows = self._finished_rows(owner)
            start = self._start(rows, owner, tell, anywhere=anywhere, last=last)
            manifest = output.Manifest(self.out / "run.json", self.header() | {"identity": owner, "arch": arch})
            try:
                for row in rows:
                    manifest.add(row)
                if start.others or (self.options.mp4 and not self.film_path.is_file()):
                    with self.script.blamed():
                        shoot(self, frames, manifest, start, progress=progress, tell=tell)
            except KeyboardInterrupt:
                manifest.finish("interrupted")
                raise
            except BaseException as error:
                manifest.finish("failed", str(error) or type(error).__name__)
                raise
            manifest.finish("done")
            shutil.rmtree(self.checkpoints, ignore_errors=True)
        return output.read_manifest(self.out / "run.json")

    def owner(self, arch: str) -> str:
        """Return what makes two renders the same film: two architectures round differently, so it is part of it."""
        return f"{self.identity}-{arch}"

    def _start(
        self, rows: list[dict[str, Any]], owner: str, tell: Callable[[str], None], *, anywhere: bool, last: Path | None
    ) -> Start:
        """Return where to set out, and what of the film is there."""
        if not self.options.resume:
            shutil.rmtree(self.checkpoints, ignore_errors=True)
            return Start(self.frames)
        check = picture_check(self.pictures, self.out / "states" if self.options.states else None, self.size)
        check = check if last is None else with_last(check, self.frames[-1], last)
        start = find_start(
            self.frames, rows, check=check, folder=self.checkpoints, identity=owner, tell=tell, anywhere=anywhere
        )
        if start.others and (start.kept or start.checkpoint):
            tell(f"resumed at frame {start.others[0]}: {len(start.kept)} of {len(self.frames)} frames are there")
        elif start.others and rows:
            tell("no checkpoint to resume from: rendering from the beginning")
        return start

    def _existing(self) -> str:
        """Return what to do with what is there: the remains of a run without one finished frame are nobody's loss."""
        path = self.out / "run.json"
        with contextlib.suppress(InputError):  # claim_folder will say it
            if path.is_file() and output.read_manifest(path).get("frames") == []:
                return "overwrite"
        return self.options.existing

    def _finished_rows(self, owner: str) -> list[dict[str, Any]]:
        """Return what an earlier run of the same film says of its frames; a frame drawn anew replaces its row."""
        path = self.out / "run.json"
        if not path.exists() or (old := output.read_manifest(path)).get("identity") != owner:
            return []
        rows = old.get("frames")
        found = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
        return [row for row in found if type(row.get("frame")) is int]

    def _prepare(self, source: Callable[[], Source]) -> Source:
        """Return what the frames come from; meanwhile ffmpeg shows that it starts, where it is needed."""
        if not self.options.mp4:
            return source()
        with ThreadPoolExecutor(1) as pool:
            check = pool.submit(output.check_ffmpeg)
            try:
                return source()
            finally:
                check.result()  # of two errors this one is told

    def simulation(self, share: Share = WHOLE, *, records: Mapping[str, Any] | None = None) -> Simulation:
        """Return the simulation of all particles, or of a share of them; `records`: what to record of the meshes."""
        o = self.options
        with self.script.blamed():
            return Simulation(
                self.scene,
                quality=o.quality,
                arch=o.arch,
                threads=o.threads,
                precision=o.precision,
                share=share,
                records=records,
            )

    def provenance(self, frame: Frame) -> dict[str, str]:
        """Return what a PNG says of itself; nothing that differs between two runs of the same film."""
        return {
            "Software": f"tparticles {__version__}",
            "Scene": f"{self.script.name} {self.identity}",
            "Frame": str(frame.number),
            "Seed": str(self.scene.seed),
            "Scheme": ", ".join(
                [self.scene.scheme.name, *(f"{mesh}: {own}" for mesh, own in self._own_schemes.items())]
            ),
        }


def _check(options: Options) -> None:
    for kind, value, allowed in (
        ("quality", options.quality, QUALITIES),
        ("arch", options.arch, get_args(Arch)),
        ("precision", options.precision, get_args(Precision)),
        ("value of --existing", options.existing, output.EXISTING),
    ):
        if value not in allowed:
            raise unknown(kind, value, allowed)
    if options.threads is not None and options.threads < 1:
        raise InputError(f"threads = {options.threads}: at least 1 is needed")
    if not (options.png or options.mp4 or options.states):
        raise InputError("nothing to write: --no-png, --no-mp4 and no --states")


def _check_memory(size: tuple[int, int]) -> None:
    """Refuse a picture that cannot fit, before the system kills us for it."""
    try:
        available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return
    needed = _BYTES_PER_PIXEL * size[0] * size[1]
    if needed > available:
        raise InputError(
            f"size is {size[0]}x{size[1]}: that takes {needed / 2**30:.1f} GiB, this machine has {available / 2**30:.1f} GiB"
        )


def _span(frames: Sequence[int]) -> str:
    """Return a name for a part of a film, the same for the same frames: `1-240x2`, `7`, `1-5+9`."""
    parts, rest = [], list(frames)
    while rest:
        stride = rest[1] - rest[0] if len(rest) > 1 else 1
        n = next((i for i in range(1, len(rest)) if rest[i] - rest[i - 1] != stride), len(rest))
        if n == 2 and stride > 1:
            n = 1  # two frames far apart are no range
        parts.append(str(rest[0]) if n == 1 else f"{rest[0]}-{rest[n - 1]}" + (f"x{stride}" if stride > 1 else ""))
        rest = rest[n:]
    text = "+".join(parts)
    return text if len(text) <= _LONGEST_SPAN else f"{frames[0]}-{frames[-1]}+{zlib.crc32(text.encode())}"


def _picture_hash(background: Any) -> str:
    if not isinstance(background, Picture):
        return ""
    try:
        return hashlib.sha256(Path(background.path).read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"background '{background.path}' cannot be read: {error.strerror}") from None
