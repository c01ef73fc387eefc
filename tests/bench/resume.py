"""Fifty kills of one film, resumed each time, against the film in one go; and what checkpoints cost the campfire.

`python -m tests.bench resume`

The cost is counted in processor time, by the threads that make checkpoints, so that others on the machine do not show.
"""

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.table import Table

KILLS = 50
EVERY = "24f"  # a second of film

FILM = '''"""Sparks with a past."""
import tparticles as tp


def scene(quality):
    sparks = tp.Group(
        name="sparks",
        system=tp.Newtonian(forces=(tp.Gravity(), tp.Drag(time=0.3))),
        emitters=tp.Emitter(
            births=tp.Rate(rate=4000.0), velocity=tp.Cone(angle=20.0, speed=(6.0, 1.5)), size=0.02,
            temperature=(1700.0, 150.0), lifetime=tp.Spread(mean=0.8, variance=0.4),
        ),
        cooling=tp.Exponential(time=1.6),
    )
    camera = tp.Camera(position=(0, -6, 1.2), target=(0, 0, 1.2))
    return tp.Scene(groups=sparks, camera=camera, duration=25, size=(192, 108), scheme="bdf3")
'''

# Counts the processor time of what `Checkpoints` does, and says it with that of the whole process and of ffmpeg.
COUNTED = """
import json, resource, sys, time
from tparticles import checkpoint
from tparticles.cli import main
spent, made = [], []
def counted(work):
    def run(*arguments):
        start = time.thread_time()
        try:
            return work(*arguments)
        finally:
            spent.append(time.thread_time() - start)
    return run
for name in ("after", "finished", "begun", "_write"):
    setattr(checkpoint.Checkpoints, name, counted(getattr(checkpoint.Checkpoints, name)))
write = checkpoint.write_checkpoint
checkpoint.write_checkpoint = lambda *a, **k: (made.append(1), write(*a, **k))
try:
    main(sys.argv[1:])
finally:
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    total = sum(usage.ru_utime + usage.ru_stime for usage in usages)
    print(json.dumps({"spent": sum(spent), "total": total, "made": len(made)}))
"""


def command(out: Path, *options: str) -> list[str]:
    return [sys.executable, "-m", "tparticles", "render", str(out.parent / "film.py"), "--out", str(out), *options]


def hashes(out: Path) -> list[str]:
    return [row["sha256"] for row in json.loads((out / "run.json").read_text())["frames"]]


def kill_often(out: Path) -> tuple[int, int]:
    """Render with many kills; return how many runs came to draw frames, and how many frames were drawn again."""
    chance, useful, again, environment = random.Random(0), 0, 0, dict(os.environ)
    for _ in range(KILLS):
        before = len(list(out.glob("frames/0*.png")))
        process = subprocess.Popen(
            command(out, "--resume", "--checkpoint-every", "5f", "--quiet"), env=environment, stderr=subprocess.PIPE
        )
        # anywhere: while it starts, while it looks at what is there, while it draws and writes
        wanted, until = before + chance.randint(0, 12), time.monotonic() + 120
        if chance.random() < 0.3:
            until = time.monotonic() + chance.uniform(0.0, 4.0)
        while process.poll() is None and time.monotonic() < until and len(list(out.glob("frames/0*.png"))) < wanted:
            time.sleep(0.001)
        time.sleep(chance.uniform(0.0, 0.03))
        process.kill()
        said = process.communicate()[1].decode()
        if "resumed at frame" in said:
            useful += 1
            again += before - int(said.split("resumed at frame ")[1].split(":")[0]) + 1
    subprocess.run(command(out, "--resume", "--quiet"), check=True, env=environment)
    return useful, again


def cost(out: Path) -> dict[str, float]:
    """Return the processor time of a campfire's checkpoints and of the whole render [s], and how many there were."""
    arguments = ("render", "scenes/campfire.py", "--quiet", "--checkpoint-every", EVERY, "--out", str(out))
    done = subprocess.run([sys.executable, "-c", COUNTED, *arguments], check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    table = Table("resume", ("what", ""))
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        (base / "film.py").write_text(FILM)
        subprocess.run(command(base / "whole", "--quiet"), check=True)
        useful, again = kill_often(base / "killed")
        same = hashes(base / "killed") == hashes(base / "whole")
        film = (base / "killed/film.mp4").read_bytes() == (base / "whole/film.mp4").read_bytes()
        table.add(f"{KILLS} kills of one film of {len(hashes(base / 'whole'))} frames: pixels the same", same)
        table.add("the film's file the same", film)
        table.add("of them resumed from a checkpoint, frames drawn again in all", f"{useful}, {again}")
        found = cost(base / "campfire")
        share = found["spent"] / found["total"]
        table.add(
            f"campfire, {found['made']} checkpoints, one a second of film: part of its processor time", f"{share:.2%}"
        )
        table.add("wanted: less than", "3 %")
    table.print()
