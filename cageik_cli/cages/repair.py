"""Make a user's own cage fit for a model, with as little change as possible."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.check.enclosure import find_missing_extent, locate_vertices
from cageik_cli.cages.check.faults import Finding, find_cage_faults
from cageik_cli.cages.check.misfit import Transform
from cageik_cli.cages.check.quality import (
    MIN_CLEARANCE,
    find_low_clearance,
    find_needle_faces,
    find_surface_crossings,
    find_thin_parts,
)
from cageik_cli.cages.repairing.polygon_mesh import PolygonMesh
from cageik_cli.cages.repairing.shape import ShapeFit
from cageik_cli.cages.repairing.steps import Repair, RepairStep
from cageik_cli.cages.settings import RepairSettings
from cageik_cli.cages.surface_points import sample_surface
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.progress import ignore_progress


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


def repair_cage(
    cage: TriMesh,
    model: TriMesh,
    settings: RepairSettings | None = None,
    corner_counts: Integers | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
) -> RepairedCage:
    """Repair a cage: its faces first, then its place, then its shape.

    Parameters
    ----------
    cage : TriMesh
        As it was read; its polygons are fans at their first corners.
    model : TriMesh
        What it must hold.
    corner_counts : (p,) int64, optional
        How many corners each polygon of the cage has, in the order of the fans; all are triangles
        by default. Quads stay quads.
    progress : callable
        Called with (rounds done, rounds) while vertices move.

    Returns
    -------
    RepairedCage
        Fit, or with the faults that are left.

    Raises
    ------
    CageError
        When nothing of the cage would be left, or the model is one point.
    """
    settings = settings or RepairSettings()
    if point := find_missing_extent(model):
        raise CageError(point.sentence)
    samples = sample_surface(model)
    repair = Repair(cage, corner_counts)
    repair.tidy_faces(samples, settings.max_hole_edges)
    transform = None
    if settings.allow_transform and bounds_volume(repair.mesh.triangles):
        transform = repair.undo_transform(model)
    start = repair.mesh.vertices
    repair.unfold()
    if bounds_volume(repair.mesh.triangles):
        # Points are pushed for when they are hardly nearer than a good cage has them.
        least = min(1.1 * MIN_CLEARANCE, settings.clearance) * model.diagonal
        fit = ShapeFit(model, samples, least, settings.clearance * model.diagonal)
        repair.fit_shape(fit, model.diagonal, progress)
        repair.unfold()
    faults, warnings = judge_cage(repair.mesh.triangles, model, samples)
    return RepairedCage(
        mesh=repair.mesh,
        vertex_map=repair.vertex_map,
        moves=repair.mesh.vertices - start,
        transform=transform,
        steps=tuple(repair.steps),
        faults=faults,
        warnings=warnings,
    )


def judge_cage(
    cage: TriMesh, model: TriMesh, samples: Floats
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Test a cage alone, and around every vertex, face and sample of the model.

    Returns
    -------
    tuple of Finding
        Why it does not hold the model; none of a cage that is fit.
    tuple of Finding
        What is poor about it, all the same.
    """
    if faults := find_cage_faults(cage):
        return faults, ()
    placement = locate_vertices(cage, model)
    is_outside = len(placement.outside_indices) > 0
    holding = [placement.find_outside("move the cage outward there")] if is_outside else []
    holding += find_surface_crossings(placement)
    if not holding:
        holding += _find_outside_samples(cage, samples)
    warnings = [*find_needle_faces(cage), *find_thin_parts(cage)]
    if not is_outside:
        warnings += find_low_clearance(placement)
    return tuple(holding), tuple(warnings)


def _find_outside_samples(cage: TriMesh, samples: Floats) -> Iterator[Finding]:
    """Find points on faces of the model that are outside."""
    outside = samples[winding_numbers(cage, samples) < 0.5]
    if len(outside):
        x, y, z = outside[0]
        message = (
            f"{len(outside)} of {len(samples)} points of the model's surface are outside the "
            f"cage, the first at ({x:.4g}, {y:.4g}, {z:.4g})"
        )
        remedy, count = "move the cage outward there", float(len(outside))
        yield Finding("surface-outside", "unfit", message, remedy, value=count)
