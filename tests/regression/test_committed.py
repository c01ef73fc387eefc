"""The scenes of this project are as their committed references, on any machine: by the tolerant rule."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_scene_is_as_its_reference():
    command = [sys.executable, "-m", "tparticles", "check", "--tolerant", "--json"]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, timeout=600)
    result = json.loads(done.stdout)
    rows = result.get("scenes", [])
    assert done.returncode == 0, "\n".join([*(f"{row['scene']}: {row['message']}" for row in rows), done.stderr])
    assert {row["scene"] for row in rows} >= {path.stem for path in (ROOT / "scenes").glob("[!_]*.py")}
    assert result["unused"] == []


def test_references_stay_small():
    files = [path for path in (ROOT / "renders/reference/check").rglob("*") if path.is_file()]
    assert files and sum(path.stat().st_size for path in files) < 2_000_000
