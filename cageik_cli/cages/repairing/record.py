"""What a repair did and what it gives: the steps, the cage, what is left."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.findings import Finding
from cageik_cli.cages.repairing.polygon_mesh import PolygonMesh
from cageik_cli.cages.transforms import Transform
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True)
class RepairSettings:
    """The limits of a repair.

    Attributes
    ----------
    clearance : float
        How far parts of the cage that must move are moved off the model, in its diagonals.
    max_hole_edges : int
        Holes with more edges are not closed.
    allow_transform : bool
        Whether a cage in another unit, or with other axes, is brought to the model.
    """

    clearance: float = 0.002
    max_hole_edges: int = 16
    allow_transform: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class RepairStep:
    """One change of a repair.

    Attributes
    ----------
    kind : str
        A word for programs: `merge`, `drop-faces`, `turn`, `close-hole`, `drop-vertices`,
        `drop-part`, `cut-polygons`, `transform`, `untangle`, `push`.
    message : str
        What was done, in words.
    count : int
        How many vertices, faces or holes.
    vertices : (k,) int64
        Which vertices of the cage given were moved or have gone, from 0; none if faces changed.
    max_move, mean_move : float
        How far the vertices that moved did, file units; 0 if none did.
    """

    kind: str
    message: str
    count: int
    vertices: Integers
    max_move: float = 0.0
    mean_move: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RepairedCage:
    """A cage after its repair.

    Attributes
    ----------
    mesh : PolygonMesh
        Its polygons; vertices are in the order of the cage given.
    vertex_map : (n,) int64
        The new number of each vertex of the cage given; −1 if it has gone.
    moves : (k, 3) float64
        How far each vertex that is left was moved, file units; without the transform.
    transform : Transform, optional
        What was done to the whole cage first.
    faults : tuple of Finding
        What is still wrong; none of a cage that is fit.
    warnings : tuple of Finding
        What is poor about it.
    """

    mesh: PolygonMesh
    vertex_map: Integers
    moves: Floats
    transform: Transform | None
    steps: tuple[RepairStep, ...]
    faults: tuple[Finding, ...]
    warnings: tuple[Finding, ...]

    @property
    def cage(self) -> TriMesh:
        """Return the triangles to compute with, outward if the cage is fit."""
        return self.mesh.triangles

    @property
    def is_fit(self) -> bool:
        """Return whether the cage is sound and holds the whole surface of the model."""
        return not self.faults

    @property
    def max_move(self) -> float:
        """Return how far the vertex that was moved furthest was, file units."""
        return float(np.linalg.norm(self.moves, axis=1).max())

    @property
    def moved_vertices(self) -> Integers:
        """Return numbers of the vertices that were moved, in the repaired cage."""
        return np.flatnonzero((self.moves != 0).any(axis=1))
