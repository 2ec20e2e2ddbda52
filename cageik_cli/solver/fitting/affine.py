"""Affine exactness: changes of weights that keep W·1 = 1 and W·C = X."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import CageError

AFFINE_FUNCTIONS = 4
"""1 and the three coordinates: the functions that weights reproduce."""

MIN_CAGE_THICKNESS = 1e-9
"""Cages that are thinner, relative to their diagonal, lie in a plane."""

AFFINE_TOL = 1e-13
"""Weights nearer to affine exactness than this are left as they are."""


def complement_basis(cage: TriMesh) -> Floats:
    """Return an orthonormal basis of the vectors orthogonal to 1 and to the cage's coordinates.

    Rows of weights may change by these vectors; their sums and `weights @ cage` stay the same.

    Returns
    -------
    (n, n - 4) float64.

    Raises
    ------
    CageError
        When all vertices of the cage lie in a plane.
    """
    return np.asarray(
        np.linalg.qr(_affine_functions(cage), mode="complete")[0][:, AFFINE_FUNCTIONS:]
    )


def restore_affine(weights: Floats, rest: TriMesh, cage: TriMesh) -> Floats:
    """Return the nearest weights, (m, n), whose rows sum to one and give the rest vertices.

    Weights that do so already, to rounding, are returned as they are.

    Raises
    ------
    CageError
        When all vertices of the cage lie in a plane.
    """
    functions = _affine_functions(cage)
    target = _evaluate(rest.vertices, cage)
    inverse = np.linalg.pinv(functions)
    for _ in range(2):  # the second step removes the rounding of the first
        missing = target - weights @ functions
        if np.abs(missing).max() <= AFFINE_TOL:
            break
        weights = weights + missing @ inverse
    return weights


def _affine_functions(cage: TriMesh) -> Floats:
    """Return 1 and the scaled coordinates at the vertices of the cage, (n, 4)."""
    functions = _evaluate(cage.vertices, cage)
    smallest = np.linalg.svd(functions[:, 1:], compute_uv=False)[-1]
    if len(functions) < AFFINE_FUNCTIONS or smallest < MIN_CAGE_THICKNESS:
        raise CageError(
            f"the {len(functions)} vertices of the cage lie in a plane (thickness {smallest:.1e} "
            "of the diagonal); weights in it cannot reproduce a model; use a cage with volume"
        )
    return functions


def _evaluate(points: Floats, cage: TriMesh) -> Floats:
    """Return 1 and the coordinates of points about the cage's centre, in its diagonals, (p, 4)."""
    scaled = (points - cage.vertices.mean(axis=0)) / cage.diagonal
    return np.column_stack([np.ones(len(points)), scaled])
