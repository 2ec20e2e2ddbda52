"""Cages at rest that are spoiled for tests."""

from pathlib import Path

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import closest_points

DATA = Path(__file__).resolve().parents[2] / "data_fixtures"
WALKER = DATA / "walker"
BROKEN = sorted((DATA / "broken").glob("cage_*"))


def dent(cage: TriMesh, model: TriMesh, vertices: list[int], depth: float) -> TriMesh:
    """Push vertices of a cage into its model, to a depth in diagonals."""
    positions = cage.vertices.copy()
    nearest = closest_points(model, positions[vertices]).position
    inward = nearest - positions[vertices]
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    positions[vertices] = nearest + depth * model.diagonal * inward
    return cage.move(positions)
