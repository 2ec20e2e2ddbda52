"""Weights of vertices by their area: how densely a part is cut does not matter."""

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.solver.dual_laplacian import normalize_weights
from cageik_cli.solver.settings import AREA
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError

MIN_SHARE = 1e-9
"""Vertices of faces without area count as this share of the mean: they are data, not missing."""


def weigh_by_area(mesh: TriMesh) -> Floats:
    """Return weights of mean one, (m,), by the area around each vertex; 0 for those in no face.

    Raises
    ------
    FormatError
        When the model has no area.
    """
    areas = lumped_areas(mesh)
    largest = areas.max()
    if not largest > 0:
        raise FormatError("the model has no area to weigh vertices by; leave vertex weights out")
    shares = areas / largest
    least = np.where(mesh.is_used, MIN_SHARE * shares.mean(), 0.0)
    return normalize_weights(np.maximum(shares, least), len(shares))


def make_vertex_weights(given: ArrayLike | None, mesh: TriMesh) -> Floats | None:
    """Return weights of mean one from an array (m,), or from the word "area"; None from none.

    Raises
    ------
    SettingError
        When it is another word.
    FormatError
        When the array does not hold a weight per vertex, or the model has no area.
    """
    if given is None:
        return None
    if isinstance(given, str):
        if given != AREA:
            raise SettingError(f'vertex_weights is {given!r}, expected an array or "{AREA}"')
        return weigh_by_area(mesh)
    return normalize_weights(np.asarray(given, np.float64), len(mesh.vertices))
