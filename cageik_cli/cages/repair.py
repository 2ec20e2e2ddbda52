"""Make a user's own cage fit for a model, with as little change as possible."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from cageik_cli.cages.enclosure import find_missing_extent
from cageik_cli.cages.findings import format_elements
from cageik_cli.cages.misfit import find_transform
from cageik_cli.cages.quality import MIN_CLEARANCE
from cageik_cli.cages.repairing.faces import Draft, start_draft, tidy_faces
from cageik_cli.cages.repairing.judge import judge_cage
from cageik_cli.cages.repairing.push import Clearance
from cageik_cli.cages.repairing.record import RepairedCage, RepairSettings, RepairStep
from cageik_cli.cages.repairing.shape import Target, fit_shape
from cageik_cli.cages.surface_points import sample_surface
from cageik_cli.cages.transforms import Transform
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.text import format_count

__all__ = ["RepairSettings", "RepairStep", "RepairedCage", "repair_cage"]

CLEARANCE_MARGIN = 1.1
"""Points are pushed for when they are nearer than this many of the smallest good clearances."""


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
    draft = tidy_faces(start_draft(cage, corner_counts), samples, settings.max_hole_edges)
    transform = None
    if settings.allow_transform and bounds_volume(draft.mesh.triangles):
        draft, transform = _apply_transform(draft, model)
    start = draft.mesh.vertices
    draft = _fit_draft(draft, _make_target(model, samples, settings), progress)
    judgement = judge_cage(draft.mesh.triangles, model, samples)
    return RepairedCage(
        mesh=draft.mesh,
        vertex_map=draft.vertex_map,
        moves=draft.mesh.vertices - start,
        transform=transform,
        steps=draft.steps,
        faults=judgement.faults,
        warnings=judgement.warnings,
    )


def _make_target(model: TriMesh, samples: Floats, settings: RepairSettings) -> Target:
    least = min(CLEARANCE_MARGIN * MIN_CLEARANCE, settings.clearance)
    clearance = Clearance(least * model.diagonal, settings.clearance * model.diagonal)
    return Target(model, samples, clearance)


def _apply_transform(draft: Draft, model: TriMesh) -> tuple[Draft, Transform | None]:
    """Bring a cage in another unit, or with other axes, to the model."""
    transform = find_transform(draft.mesh.triangles, model)
    if transform is None:
        return draft, None
    mesh = draft.mesh.move(transform.apply(draft.mesh.vertices))
    if transform.is_mirror:
        mesh = mesh.turn(np.ones(len(mesh.corner_counts), bool))
    numbers = np.empty(0, np.int64)
    step = RepairStep("transform", f"the cage is {transform.name}: undone", 1, numbers)
    return draft.change(mesh, step), transform


def _fit_draft(draft: Draft, target: Target, progress: Callable[[int, int], None]) -> Draft:
    """Move what must be moved, of a cage that bounds a volume."""
    draft = _unfold(draft)
    if not bounds_volume(draft.mesh.triangles):
        return draft
    shape = fit_shape(draft.mesh.triangles, target, progress)
    origins, diagonal = draft.origins, target.model.diagonal
    steps = (
        *_describe_moves(
            "untangle", "whose faces cross others", shape.untangled, origins, diagonal
        ),
        *_describe_moves("push", "to hold the model", shape.pushed, origins, diagonal),
    )
    mesh = draft.mesh.move(shape.cage.vertices)
    return _unfold(replace(draft, mesh=mesh, steps=(*draft.steps, *steps)))


def _describe_moves(
    kind: str, why: str, moves: Floats, origins: Integers, diagonal: float
) -> list[RepairStep]:
    """Return the step that moved vertices, if any did; numbers are those of the cage given."""
    length = np.linalg.norm(moves, axis=1)
    moved = np.flatnonzero(length > 0)
    if len(moved) == 0:
        return []
    most, mean = float(length[moved].max()), float(length[moved].mean())
    message = (
        f"moved {format_elements('vertex', origins[moved])} {why}, by "
        f"{100 * mean / diagonal:.2g} % of the diagonal on average, {100 * most / diagonal:.2g} % "
        f"at vertex {origins[length.argmax()]}"
    )
    return [RepairStep(kind, message, len(moved), origins[moved], most, mean)]


def _unfold(draft: Draft) -> Draft:
    """Cut polygons that fold over as a reader of the file would, so that what is tested is read."""
    mesh = draft.mesh.unfold()
    lost = int((draft.mesh.corner_counts > 3).sum() - (mesh.corner_counts > 3).sum())
    draft = replace(draft, mesh=mesh)
    if lost == 0:
        return draft
    message = f"cut {format_count(lost, 'polygon')} that fold over into triangles"
    return draft.change(mesh, RepairStep("cut-polygons", message, lost, np.empty(0, np.int64)))
