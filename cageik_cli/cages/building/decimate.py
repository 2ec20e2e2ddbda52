"""A shell made coarse by quadric decimation (Garland and Heckbert 1997; libigl's qslim)."""

import igl
import numpy as np

from cageik_cli.geometry.mesh import TriMesh

STEP = 0.6
"""Share of the vertices that a stage leaves."""

FIRST_STAGE = 4.0
"""How many times the vertices asked for the first stage has, at least."""

UNTESTED = 1200
"""Vertices down to which collapses need no test: a fine shell hardly tangles."""


def euler_characteristic(mesh: TriMesh) -> int:
    """Return V − E + F: 2 − 2 genus of a closed surface of one component."""
    return len(mesh.vertices) - len(mesh.edges.ends) + len(mesh.faces)


def stages(count: int) -> list[int]:
    """Return vertex counts of the stages from a fine shell down to `count`."""
    counts = [float(count)]
    while counts[-1] < FIRST_STAGE * count:
        counts.append(counts[-1] / STEP)
    return [int(np.ceil(stage)) for stage in counts[::-1]]


def thin_shell(shell: TriMesh, count: int) -> TriMesh:
    """Thin a fine shell to `count` vertices by libigl's quick collapses, which are not tested."""
    faces = 2 * (count - euler_characteristic(shell))
    vertices, corners, _, _ = igl.qslim(
        np.asfortranarray(shell.vertices), np.asfortranarray(shell.faces.astype(np.int32)), faces
    )
    used, corners = np.unique(corners, return_inverse=True)
    return TriMesh(vertices[used], corners.reshape(-1, 3))
