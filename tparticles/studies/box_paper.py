"""The experiment of R. Scott, "Visually illustrating stability in numerical integration techniques" (MAA Pacific Northwest Section,
2002): its figures, and what is known of its box.
"""

from __future__ import annotations

from dataclasses import dataclass

DT = 0.01  # [s]
# Of J. Lander's source (Game Developer, March 1999): 1 kg a vertex, a room of 15 m. The size of Scott's box is not known.
ROOM_SIZE = 15.0  # [m]
SIZE = 3.0  # of the box [m]
DAMPING = 0.1  # along the springs [N s/m]
DRAG = 0.04  # of a vertex [N s/m]
GRAVITY = 0.2  # [m/s^2]
RESTITUTION = 0.1


@dataclass(frozen=True)
class PaperRow:
    """A line of Table 1: time [us] and stable spring coefficient [N/m] from..to, and the paper's index."""

    scheme: str
    microseconds: tuple[float, float]
    stiffness: tuple[float, float]
    index: float


TABLE = (
    PaperRow("milne", (24, 26), (14, 15), 0.58),
    PaperRow("euler", (5, 7), (12, 14), 2.17),
    PaperRow("midpoint", (21, 23), (330, 350), 15.45),
    PaperRow("abm4", (26, 28), (450, 600), 19.44),
    PaperRow("crenshaw", (6, 8), (377, 378), 53.9),
    PaperRow("abm2", (20, 23), (1700, 2500), 97.7),
    PaperRow("beeman", (22, 25), (2450, 2500), 105.0),
    PaperRow("velocity-verlet", (21, 24), (3200, 4200), 164.0),
    PaperRow("rk4", (53, 58), (8700, 9300), 162.0),
)
BY_SCHEME = {row.scheme: row for row in TABLE}
PER_CALL, PER_EVALUATION = 7.0, 16.3  # [us]: what fits its times, the first evaluation of a call not being timed

DIFFERENCES = """\
Why ours differ from Table 1. The paper gives neither box size, start, damping nor what counts as growth. Here they are Lander's
published defaults (1 kg a vertex, damping 0.1 N s/m along the springs, drag 0.04 N s/m, restitution 0.1), and both limits are
defined. Damping decides what Euler, midpoint, Milne and Crenshaw reach: without it none of them has a stable k, so the paper's
figures for them are about how fast growth is seen. Collisions decide what Verlet and Beeman reach: in the air they hold up to
k = 1 / (2 dt^2) less damping, but where a stiff box rests on the floor its contacts feed the jitter that the paper saw in the upper
half of Verlet's range. Here a step goes back to the moment of contact, is taken there by the same method, and a multistep
history starts anew; Lander bisects with Euler steps. Scott's Crenshaw may carry the two slips of Lander's code, his RK4 the
halved weights of 1999; ours are the formulas. His times are of a 2002 processor, around a call whose first force evaluation was
not timed; ours are wall time per step over whole launches, with every evaluation and the collision test counted."""
