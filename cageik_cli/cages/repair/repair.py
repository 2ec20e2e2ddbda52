"""Make a user's own cage fit for a model, with as little change as possible.

Each step of a repair changes the cage, and says what it did.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cageik_cli.cages.check.enclosure import find_missing_extent, locate_vertices
from cageik_cli.cages.check.faults import Finding, find_cage_faults, format_elements
from cageik_cli.cages.check.quality import (
    MIN_CLEARANCE,
    find_low_clearance,
    find_needle_faces,
    find_surface_crossings,
    find_thin_parts,
)
from cageik_cli.cages.repair.shape import ShapeFit
from cageik_cli.cages.repair.tidy import (
    PolygonMesh,
    close_hole,
    count_topology_faults,
    drop_unreferenced,
    find_boundary_vertices,
    find_coincident,
    find_fins,
    find_holes,
    find_inward_facing,
    find_misoriented,
    find_repeated,
    label_patches,
    replace_corners,
)
from cageik_cli.cages.surface_points import sample_surface
from cageik_cli.cages.transform import Transform, find_transform
from cageik_cli.geometry.mesh import TriMesh, signed_volumes
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import CageError
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.text import format_count, group_digits

REPAIR_CLEARANCE = 0.002
"""How far parts of the cage that must move are moved off the model, in its diagonals."""

MAX_HOLE_EDGES = 16
"""Holes with more edges are not closed."""

MAX_INNER_WALLS = 30
"""Patches of a cage with edges of more than two faces, above which none is tried as a wall."""


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
    vertices: Integers = field(default_factory=lambda: np.empty(0, np.int64))
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


def repair_cage(
    cage: TriMesh,
    model: TriMesh,
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
    if point := find_missing_extent(model):
        raise CageError(point.sentence)
    samples = sample_surface(model)
    repair = Repair(cage, corner_counts)
    repair.tidy_faces(samples)
    transform = None
    if bounds_volume(repair.mesh.triangles):
        transform = repair.undo_transform(model)
    start = repair.mesh.vertices
    repair.unfold()
    if bounds_volume(repair.mesh.triangles):
        # Points are pushed for when they are hardly nearer than a good cage has them.
        least = 1.1 * MIN_CLEARANCE * model.diagonal
        fit = ShapeFit(model, samples, least, REPAIR_CLEARANCE * model.diagonal)
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
        outside = samples[winding_numbers(cage, samples) < 0.5]
        if len(outside):
            x, y, z = outside[0]
            message = (
                f"{group_digits(len(outside))} of {group_digits(len(samples))} points of the "
                "model's surface are outside the "
                f"cage, the first at ({x:.4g}, {y:.4g}, {z:.4g})"
            )
            remedy, count = "move the cage outward there", len(outside)
            holding.append(Finding("surface-outside", "unfit", message, remedy, value=count))
    warnings = [*find_needle_faces(cage), *find_thin_parts(cage)]
    if not is_outside:
        warnings += find_low_clearance(placement)
    return tuple(holding), tuple(warnings)


class Repair:
    """A cage under repair.

    Parameters
    ----------
    cage : TriMesh
        As it was read; its polygons are fans at their first corners.
    corner_counts : (p,) int64, optional
        Of the polygons; all are triangles by default.

    Attributes
    ----------
    mesh : PolygonMesh
        The cage as it is now.
    vertex_map : (n,) int64
        The number of each vertex of the cage given, −1 if it has gone.
    steps : list of RepairStep
        What was done so far.
    """

    def __init__(self, cage: TriMesh, corner_counts: Integers | None) -> None:
        self.mesh = PolygonMesh.from_fans(cage, corner_counts)
        self.vertex_map: Integers = np.arange(len(cage.vertices))
        self.steps: list[RepairStep] = []

    @property
    def origins(self) -> Integers:
        """Return the number in the cage given of each vertex, the first of those merged."""
        numbers = np.arange(len(self.vertex_map))[::-1]
        origins = np.full(len(self.mesh.vertices), -1)
        kept = self.vertex_map[::-1] >= 0
        origins[self.vertex_map[::-1][kept]] = numbers[kept]
        return origins

    def tidy_faces(self, samples: Floats) -> None:
        """Run every step that changes faces but moves nothing: causes come before their effects.

        Parameters
        ----------
        samples : (s, 3)
            Points of the model, which decide what parts of the cage are for.
        """
        self._merge_vertices()
        self._drop_faces(find_repeated(self.mesh), "that repeat others")
        counts = self.mesh.corner_counts
        numbers = self.mesh.polygon_numbers[self.mesh.edge_uses == 1]
        loose = np.bincount(numbers, minlength=len(counts)) == counts
        if not loose.all():
            self._drop_faces(loose, "that touch no others")
        self._drop_faces(find_fins(self.mesh), "that stand on an edge of two others")
        self._drop_inner_walls()
        self._turn_faces()
        self._close_holes()
        self._drop_loose_parts(samples)
        self._turn_faces()
        self._drop_vertices()

    def undo_transform(self, model: TriMesh) -> Transform | None:
        """Bring a cage in another unit, or with other axes, to the model; return how, if so."""
        transform = find_transform(self.mesh.triangles, model)
        if transform is None:
            return None
        self.mesh = self.mesh.move(transform.apply(self.mesh.vertices))
        if transform.is_mirror:
            self.mesh = self.mesh.turn(np.ones(len(self.mesh.corner_counts), bool))
        self._note("transform", f"the cage is {transform.name}: undone", 1)
        return transform

    def fit_shape(
        self, fit: ShapeFit, diagonal: float, progress: Callable[[int, int], None]
    ) -> None:
        """Move what must be moved, of a cage that bounds a volume."""
        shape = fit.run(self.mesh.triangles, progress)
        self.mesh = self.mesh.move(shape.cage.vertices)
        self._note_moves("untangle", "whose faces cross others", shape.untangled, diagonal)
        self._note_moves("push", "to hold the model", shape.pushed, diagonal)

    def unfold(self) -> None:
        """Cut polygons that fold over as a reader of the file would, which reads what is tested."""
        before = (self.mesh.corner_counts > 3).sum()
        self.mesh = self.mesh.unfold()
        lost = int(before - (self.mesh.corner_counts > 3).sum())
        if lost:
            message = f"cut {format_count(lost, 'polygon')} that fold over into triangles"
            self._note("cut-polygons", message, lost)

    def _note(self, kind: str, message: str, count: int, vertices: Integers | None = None) -> None:
        vertices = np.empty(0, np.int64) if vertices is None else vertices
        self.steps.append(RepairStep(kind, message, count, vertices))

    def _note_moves(self, kind: str, why: str, moves: Floats, diagonal: float) -> None:
        """Note the step that moved vertices, if any did; numbers are those of the cage given."""
        length, origins = np.linalg.norm(moves, axis=1), self.origins
        moved = np.flatnonzero(length > 0)
        if len(moved) == 0:
            return
        most, mean = float(length[moved].max()), float(length[moved].mean())
        message = (
            f"moved {format_elements('vertex', origins[moved])} {why}, by "
            f"{100 * mean / diagonal:.2g} % of the diagonal on average, "
            f"{100 * most / diagonal:.2g} % at vertex {origins[length.argmax()]}"
        )
        self.steps.append(RepairStep(kind, message, len(moved), origins[moved], most, mean))

    def _merge_vertices(self) -> None:
        """Merge vertices at one place: all, or if that is not manifold, those on open edges."""
        mesh = self.mesh
        everything = np.arange(len(mesh.vertices))
        if len(replace_corners(mesh, everything).corners) == 0:
            raise CageError(
                "all faces of the cage have a vertex twice; nothing of it would be left"
            )
        before = count_topology_faults(mesh)
        merged, target = mesh, everything
        for candidates in (everything, find_boundary_vertices(mesh)):
            first = find_coincident(mesh.vertices, candidates)
            found = replace_corners(mesh, first)
            if len(found.corners) and count_topology_faults(found) <= before:
                merged, target = found, first
                break
        gone = np.flatnonzero(target != everything)
        lost = len(mesh.corner_counts) - len(merged.corner_counts)
        if len(gone) == 0 and lost == 0:
            return
        parts = []
        if len(gone):
            parts.append(f"merged {format_elements('vertex', gone)} with others at the same place")
        if lost:
            parts.append(f"deleted {format_count(lost, 'face')} with a vertex twice")
        self.mesh, self.vertex_map = merged, target[self.vertex_map]
        self._note("merge", " and ".join(parts), max(len(gone), lost), gone)

    def _drop_inner_walls(self) -> None:
        """Delete a patch of faces whose edges two others share; the largest volume stays.

        Of a cage with more than `MAX_INNER_WALLS` patches, none is tried.
        """
        while True:
            mesh = self.mesh
            labels = label_patches(mesh)
            if not (mesh.edge_uses > 2).any() or labels.max() >= MAX_INNER_WALLS:
                return
            before = count_topology_faults(mesh)
            best, most = None, 0.0
            for patch in range(labels.max() + 1):
                kept = labels != patch
                if not kept.any() or count_topology_faults(mesh.keep(kept)) >= before:
                    continue
                volume = _measure_volume(mesh.keep(kept))
                if volume > most:
                    best, most = patch, volume
            if best is None:
                return
            self._drop_faces(labels == best, "inside the cage")

    def _turn_faces(self) -> None:
        """Turn faces until neighbours agree, then closed components until they face outward."""
        turned = find_misoriented(self.mesh)
        mesh = self.mesh.turn(turned)
        inward = find_inward_facing(mesh)
        turned ^= inward
        if not turned.any():
            return
        self.mesh = mesh.turn(inward)
        numbers = np.flatnonzero(turned)
        what = "all faces" if turned.all() else format_elements("face", numbers)
        self._note("turn", f"turned {what} to face outward", len(numbers))

    def _close_holes(self) -> None:
        """Put faces over holes of up to `MAX_HOLE_EDGES` edges that pass no vertex twice."""
        for loop in find_holes(self.mesh):
            closed = close_hole(self.mesh, loop)
            fits = count_topology_faults(closed) < count_topology_faults(self.mesh)
            if len(loop) <= MAX_HOLE_EDGES and fits and not find_repeated(closed).any():
                at = format_elements("vertex", self.origins[loop])
                self.mesh = closed
                self._note("close-hole", f"closed a hole of {len(loop)} edges at {at}", 1)

    def _drop_loose_parts(self, samples: Floats) -> None:
        """Delete components that hold nothing of the model which the main one lacks."""
        mesh = self.mesh
        labels = label_patches(mesh)
        count = labels.max() + 1
        if count == 1:
            return
        bordered = mesh.polygon_numbers[mesh.edge_uses == 1]
        is_open = np.bincount(labels[bordered], minlength=count) > 0
        parts = [mesh.keep(labels == patch) for patch in range(count)]
        held = [np.abs(winding_numbers(part.triangles, samples)) > 0.5 for part in parts]
        order = [(not is_open[k], held[k].sum(), _measure_volume(parts[k])) for k in range(count)]
        main = max(range(count), key=order.__getitem__)
        if is_open[main]:
            return
        needless = [k for k in range(count) if is_open[k] or not (held[k] & ~held[main]).any()]
        chosen = np.isin(labels, [k for k in needless if k != main])
        self._drop_faces(chosen, "of parts that hold nothing of the model", "drop-part")

    def _drop_vertices(self) -> None:
        """Delete vertices that are in no face; the others keep their order."""
        mesh, numbers = drop_unreferenced(self.mesh)
        gone = np.flatnonzero(numbers < 0)
        if len(gone) == 0:
            return
        origins = self.origins[gone]
        self.mesh = mesh
        self.vertex_map = np.where(self.vertex_map >= 0, numbers[self.vertex_map], -1)
        origins = origins[origins >= 0]
        if len(origins):
            message = f"deleted {format_elements('vertex', origins)} in no face"
            self._note("drop-vertices", message, len(origins), origins)

    def _drop_faces(self, chosen: Mask, what: str, kind: str = "drop-faces") -> None:
        if not chosen.any():
            return
        if chosen.all():
            raise CageError(f"the cage has only faces {what}; nothing of it would be left")
        message = f"deleted {format_elements('face', np.flatnonzero(chosen))} {what}"
        self.mesh = self.mesh.keep(~chosen)
        self._note(kind, message, int(chosen.sum()))


def _measure_volume(mesh: PolygonMesh) -> float:
    """Return the absolute volume of a cage with its faces turned alike."""
    alike = mesh.turn(find_misoriented(mesh))
    return float(abs(signed_volumes(alike.vertices[None], alike.triangles.faces)[0]))
