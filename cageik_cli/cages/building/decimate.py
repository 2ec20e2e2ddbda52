"""A shell made coarse by quadric decimation (Garland and Heckbert 1997; libigl's qslim)."""

import igl
import numpy as np

from cageik_cli.geometry.mesh import TriMesh

COARSE_ENOUGH = 1500
"""Vertices down to which collapses need no test: a fine shell hardly tangles, and tests are slow."""


def euler_characteristic(mesh: TriMesh) -> int:
    """V − E + F: 2 − 2 genus of a closed surface of one component."""
    return len(mesh.vertices) - len(mesh.edges.ends) + len(mesh.faces)


def decimate(shell: TriMesh, count: int) -> TriMesh | None:
    """The shell with `count` vertices, or one more; None when it cannot be had."""
    middle = max(COARSE_ENOUGH, 3 * count)
    if len(shell.vertices) > 1.5 * middle:
        shell = _collapse(shell, middle, is_tested=False)
    coarse = _collapse(shell, count, is_tested=True)
    return coarse if len(coarse.vertices) <= count else None


def _collapse(shell: TriMesh, count: int, is_tested: bool) -> TriMesh:
    """Collapse edges; those that would make faces meet are left when `is_tested`."""
    faces = 2 * (count - euler_characteristic(shell))
    vertices, corners, _, _ = igl.qslim(
        np.asfortranarray(shell.vertices),
        np.asfortranarray(shell.faces.astype(np.int32)),
        faces,
        is_tested,
    )
    used, corners = np.unique(corners, return_inverse=True)
    return TriMesh(vertices[used], corners.reshape(-1, 3))
