"""Points all over the surface of a model, which a cage must hold."""

from cageik_cli.cages import surface_points
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

SPACING = 0.015
"""Points on faces that are larger lie no further apart than this, in diagonals."""

MAX_SAMPLES = 60_000
"""They lie further apart when there would be more, the vertices aside."""


def sample_surface(model: TriMesh) -> Floats:
    """Return the vertices of a model, and points on its large faces, (s, 3)."""
    return surface_points.sample_surface(model, SPACING * model.diagonal, MAX_SAMPLES)
