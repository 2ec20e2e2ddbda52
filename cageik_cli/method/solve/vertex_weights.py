"""How much each vertex counts in the solve: by given weights, or by its area."""

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.method.solve.settings import AREA
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError
from cageik_cli.util.text import group_digits


def weigh_by_area(mesh: TriMesh) -> Floats:
    """Return weights of mean one, (m,), by the area around each vertex; 0 for those in no face."""
    areas = lumped_areas(mesh)
    largest = areas.max()
    if not largest > 0:
        raise FormatError("the model has no area to weigh vertices by; leave vertex weights out")
    shares = areas / largest
    # Vertices of faces without area count this little: they are data, not missing.
    least = np.where(mesh.is_used, 1e-9 * shares.mean(), 0.0)
    return normalize_weights(np.maximum(shares, least), len(shares))


def make_vertex_weights(given: ArrayLike | None, mesh: TriMesh) -> Floats | None:
    """Return weights of mean one from an array (m,), or from the word "area"; None from none."""
    if given is None:
        return None
    if isinstance(given, str):
        if given != AREA:
            raise SettingError(f'vertex_weights is {given!r}, expected an array or "{AREA}"')
        return weigh_by_area(mesh)
    return normalize_weights(np.asarray(given, np.float64), len(mesh.vertices))


def normalize_weights(weights: Floats, count: int) -> Floats:
    """Return the weights of `count` vertices scaled to a mean of one."""
    if weights.shape != (count,):
        raise FormatError(
            f"vertex weights have shape {weights.shape}, the model has {group_digits(count)} "
            "vertices; expected "
            "one number per vertex"
        )
    wrong = np.flatnonzero(~(np.isfinite(weights) & (weights >= 0)))
    if len(wrong):
        raise FormatError(
            f"the weight of vertex {wrong[0]} is {weights[wrong[0]]}, expected a finite number of "
            "0 or above"
        )
    if not weights.any():
        raise FormatError("all vertex weights are zero; expected at least one above 0")
    shares = weights / weights.max()  # the sum of very large or very small numbers would fail
    return np.asarray(shares * (count / shares.sum()))


def drop_unused_vertices(weights: Floats | None, mesh: TriMesh) -> Floats | None:
    """Return vertex weights (m,) with 0 for vertices in no face; None if all weights are one."""
    unused = mesh.unused_vertices
    if len(unused) == 0 or (weights is not None and not weights[unused].any()):
        return weights
    kept = np.ones(len(mesh.vertices)) if weights is None else weights.copy()
    kept[unused] = 0
    return normalize_weights(kept, len(kept))
