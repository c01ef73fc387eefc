"""10 000 sparks of response times 1e-4 .. 1e-1 s, 10 000 tracers of the ABC flow: our best against scipy's for the same error.

`python -m tests.bench precision`. Both in one run, on the same ensemble; scipy may solve all particles at once, with the
Jacobian's blocks known to it, or each alone. `tparticles study precision` measures the same with all schemes.
"""

from tests.bench.table import Table
from tparticles import schemes
from tparticles.studies import precision
from tparticles.studies.work_problems import WORKS

SCHEMES = {
    "stiff-drag": ("rk4", "sdirk2", "sdirk3", "tr-bdf2", "bdf3", "bdf4"),
    "abc": ("rk4", "dormand-prince", "dop853", "ab4", "abm4"),
}
WANTED = 50


def main() -> None:
    table = Table(
        f"10 000 particles to the same largest error [ms] (wanted: {WANTED}x)",
        ("problem", "error", "precision", "cheapest", "time", "scipy's best", "time", "ratio"),
    )
    for name, chosen in SCHEMES.items():
        result = precision.study(name, WORKS[name], [schemes.get(scheme) for scheme in chosen])
        for c in result.choices:
            best, peer = c.best, c.peer
            table.add(
                name,
                f"{c.target:g}",
                c.precision,
                f"{best.label} {best.setting:.2g}" if best else "out of reach",
                f"{1e3 * best.seconds:.2f}" if best else "-",
                f"{peer.solver} {peer.setting:.0e}" if peer else "none",
                f"{1e3 * peer.seconds:.0f}" if peer else "-",
                f"{c.ratio:.0f}",
            )
    table.print()
