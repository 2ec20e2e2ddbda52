"""Move vertices of a cage towards their neighbours."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers


def move_to_neighbours(cage: TriMesh, chosen: Integers, step: float) -> Floats:
    """Return the vertices (n, 3), the chosen ones moved towards the mean of their neighbours.

    Parameters
    ----------
    chosen : (k,) int64
        Numbers of vertices.
    step : float
        The share of the way to the mean.
    """
    ends = cage.edges.ends
    both = np.concatenate([ends, ends[:, ::-1]])
    both = both[np.isin(both[:, 0], chosen)]
    count = np.bincount(both[:, 0], minlength=len(cage.vertices))
    total = np.zeros_like(cage.vertices)
    np.add.at(total, both[:, 0], cage.vertices[both[:, 1]])
    vertices = cage.vertices.copy()
    mean = total[chosen] / np.maximum(count[chosen], 1)[:, None]
    vertices[chosen] += step * (mean - vertices[chosen])
    return vertices
