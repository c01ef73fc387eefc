"""Frames to files: PNG sequences, films, state logs, and the run.json that says what is finished.

Everything here takes pictures as arrays and knows nothing of scenes, systems or kernels. A file is either whole under
its final name or not there: it is written under a temporary name in the same folder, flushed to the disk and renamed.
"""

from __future__ import annotations

from .base import Null, OutputFrame, Tee, Writer, pixel_hash
from .ffmpeg import check_ffmpeg
from .folder import CHECKPOINTS, EXISTING, SHARDS, claim_folder, held_folder
from .lock import FolderBusyError
from .manifest import Manifest, jsonable, read_manifest
from .mp4 import Mp4, check_film
from .pipeline import FrameRecord, Pipeline
from .png import PngSequence, encode_png, is_whole_png, read_png
from .states import States

__all__ = [
    "CHECKPOINTS",
    "EXISTING",
    "SHARDS",
    "FolderBusyError",
    "FrameRecord",
    "Manifest",
    "Mp4",
    "Null",
    "OutputFrame",
    "Pipeline",
    "PngSequence",
    "States",
    "Tee",
    "Writer",
    "check_ffmpeg",
    "check_film",
    "claim_folder",
    "encode_png",
    "held_folder",
    "is_whole_png",
    "jsonable",
    "pixel_hash",
    "read_manifest",
    "read_png",
]
