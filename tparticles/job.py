"""One render: a scene script, its options, and the folder where frames, film, states and run.json go."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__, output, schemes
from .errors import InputError
from .library import Script, load
from .scene import QUALITIES, Scene, frame_numbers, frame_rate
from .simulation import Frame, Simulation

_WORKERS = 2  # PNG threads
_QUEUE = 8  # frames in flight, 6 MB each at 1920x1080


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


class Job:
    """A validated render: everything that can be wrong with the request is found here, before anything is written.

    Raises:
        InputError: the script, a setting, a size, a frame range.
    """

    def __init__(self, scene: str, options: Options):
        self.options = options
        self.script = load(scene)
        if options.quality not in QUALITIES:
            raise InputError(f"quality '{options.quality}' is unknown (known: {', '.join(QUALITIES)})")
        self.settings = dict(options.settings)
        if options.seed is not None and "seed" in self.script.parameters:
            self.settings.setdefault("seed", options.seed)
        self.scene = self._scene(self.script)
        self.size = self.scene.resolution(options.quality)  # type: ignore[arg-type]
        self.frames = frame_numbers(options.frames or "1-", self.scene.frame_count)
        self.out = options.out or Path("renders") / self.script.name
        if not (options.png or options.mp4 or options.states):
            raise InputError("nothing to write: --no-png, --no-mp4 and no --states")

    def _scene(self, script: Script) -> Scene:
        o = self.options
        scene = script.build(quality=o.quality, settings=self.settings)
        changes = {
            "fps": None if o.fps is None else frame_rate(o.fps),
            "size": o.size,
            "seed": o.seed,
            "scheme": None if o.scheme is None else schemes.get(o.scheme),
        }
        return dataclasses.replace(scene, **{k: v for k, v in changes.items() if v is not None})

    @property
    def identity(self) -> str:
        """A hash of all that decides the pixels: script, parameters, size, rate, seed, scheme, precision, version."""
        parts = {
            "version": __version__,
            "script": hashlib.sha256(self.script.path.read_bytes()).hexdigest(),
            "quality": self.options.quality,
            "settings": self.script.settings(self.settings),
            "size": self.size,
            "fps": str(self.scene.fps),
            "seed": self.scene.seed,
            "scheme": self.scene.scheme.name,
            "precision": self.options.precision,
        }
        return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]

    @property
    def film_path(self) -> Path:
        """Where the MP4 goes; a part of the film never takes the name of the whole."""
        whole = len(self.frames) == self.scene.frame_count
        span = "" if whole else f".frames-{(self.options.frames or '').replace(',', '+')}"
        return self.out / f"{self.script.name}{span}.mp4"

    def header(self) -> dict[str, Any]:
        """Return what run.json says of the run as a whole."""
        return {
            "scene": self.script.name,
            "identity": self.identity,
            "parameters": {n: p.default for n, p in self.script.parameters.items()}
            | self.script.settings(self.settings),
            "quality": self.options.quality,
            "size": list(self.size),
            "fps": str(self.scene.fps),
            "seed": self.scene.seed,
            "scheme": schemes.describe(self.scene.scheme),
            "steps": repr(self.scene.steps),
            "clamp": self.scene.clamp,
            "precision": self.options.precision,
            "versions": {
                "tparticles": __version__,
                "python": platform.python_version(),
                **{name: version(name) for name in ("taichi", "numpy", "pillow", "imageio-ffmpeg")},
            },
        }

    def run(self, progress: Callable[[Frame, int], None] = lambda frame, done: None) -> dict[str, Any]:
        """Render; call `progress(frame, frames done)` for each frame; return what run.json holds.

        Raises:
            RunError: something failed on the way; finished frames stay, run.json says "failed".
            KeyboardInterrupt: passed on after what is finished has been kept and run.json says "interrupted".
        """
        identity = self.identity
        output.claim_folder(self.out, scene=self.script.name, identity=identity, existing=self.options.existing)
        kept = self._rows_of_other_frames(identity)
        with contextlib.ExitStack() as undo:
            writers = self._writers(undo)
            simulation = self._simulation()
            manifest = output.Manifest(self.out / "run.json", self.header() | {"arch": simulation.backend.arch})
            for row in kept:
                manifest.add(row)
            undo.pop_all()  # from here on the pipeline owns the writers
            try:
                self._shoot(simulation, writers, manifest, identity, progress)
            except KeyboardInterrupt:
                manifest.finish("interrupted")
                raise
            except BaseException as error:
                manifest.finish("failed", str(error) or type(error).__name__)
                raise
            manifest.finish("done")
        return output.read_manifest(self.out / "run.json")

    def _rows_of_other_frames(self, identity: str) -> list[dict[str, Any]]:
        """Return what an earlier run of the same film says of frames that this one leaves alone."""
        path = self.out / "run.json"
        if not path.exists() or (old := output.read_manifest(path)).get("identity") != identity:
            return []
        chosen = set(self.frames)
        return [row for row in old.get("frames", []) if row.get("frame") not in chosen]

    def _writers(self, undo: contextlib.ExitStack) -> list[output.Writer]:
        writers: list[output.Writer] = []

        def add(writer: output.Writer) -> None:
            writers.append(writer)
            undo.callback(writer.abort)

        if self.options.mp4:  # first: it refuses odd sizes and a missing ffmpeg
            add(output.Mp4(self.film_path, fps=self.scene.fps, size=self.size))
        if self.options.png:
            add(output.PngSequence(self.out / "frames"))
        if self.options.states:
            add(output.States(self.out / "states"))
        return writers

    def _simulation(self) -> Simulation:
        o = self.options
        return Simulation(self.scene, quality=o.quality, arch=o.arch, threads=o.threads, precision=o.precision)

    def _shoot(
        self,
        simulation: Simulation,
        writers: list[output.Writer],
        manifest: output.Manifest,
        identity: str,
        progress: Callable[[Frame, int], None],
    ) -> None:
        rows: dict[int, dict[str, Any]] = {}

        def finished(record: output.FrameRecord) -> None:
            row = rows.pop(record.number)
            row["ms"]["encode"] = record.encode_ms
            manifest.add(row | {"sha256": record.sha256})

        with output.Pipeline(writers, workers=_WORKERS, queue_size=_QUEUE, on_frame=finished) as pipeline:
            for done, frame in enumerate(simulation.frames(self.frames), start=1):
                rows[frame.number] = frame.report.row()
                provenance = {
                    "Software": f"tparticles {__version__}",
                    "Scene": f"{self.script.name} {identity}",
                    "Frame": str(frame.number),
                    "Seed": str(self.scene.seed),
                    "Scheme": self.scene.scheme.name,
                }
                states = merged(frame.state()) if self.options.states else None
                pipeline.submit(output.OutputFrame(frame.number, frame.image, provenance, states))
                progress(frame, done)


def merged(groups: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the states of all groups as one set of arrays: `group` is the index into `groups`, NaN what one does not have."""
    result: dict[str, np.ndarray] = {"groups": np.array(list(groups))}
    counts = [len(state["id"]) for state in groups.values()]
    result["group"] = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    for name in dict.fromkeys(name for state in groups.values() for name in state):
        have = next(state[name] for state in groups.values() if name in state)
        parts = [
            state[name] if name in state else np.full((count, *have.shape[1:]), np.nan, have.dtype)
            for count, state in zip(counts, groups.values(), strict=True)
        ]
        result[name] = np.concatenate(parts)
    return result
