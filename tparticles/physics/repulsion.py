"""What keeps the vertices of a mesh apart."""

from __future__ import annotations

from ..spec import NonNegative, Positive, spec


@spec
class Repulsion:
    """Vertices nearer than `distance` [m] push each other off: by `stiffness` [N/m] for each metre nearer, `damping` [N s/m] along.

    So that a cloth does not fall through itself. Vertices meet vertices: take a distance not far below their spacing, and at most
    the shortest spring, or the mesh would push itself apart at rest.
    """

    distance: Positive
    stiffness: Positive
    damping: NonNegative = 0.0
