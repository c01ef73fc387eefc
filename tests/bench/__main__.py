"""`python -m tests.bench [NAME ...]`: run the benches (all by default), each in a process of its own."""

import subprocess
import sys

BENCHES = (
    "fused",
    "film",
    "campfire",
    "memory",
    "scaling",
    "precision",
    "pixels",
    "compile",
    "check",
    "sweep",
    "resume",
    "shards",
    "log",
    "implicit",
    "mesh",
)

if __name__ == "__main__":
    for name in sys.argv[1:] or BENCHES:
        if name not in BENCHES:
            sys.exit(f"unknown bench '{name}' (known: {', '.join(BENCHES)})")
        subprocess.run([sys.executable, "-c", f"from tests.bench import {name}; {name}.main()"], check=True)
