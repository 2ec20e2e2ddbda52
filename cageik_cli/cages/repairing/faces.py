"""The steps of a repair that change faces and numbers of vertices, but move nothing."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.findings import format_elements
from cageik_cli.cages.repairing.holes import close_hole, find_holes
from cageik_cli.cages.repairing.polygon_mesh import PolygonMesh
from cageik_cli.cages.repairing.record import RepairStep
from cageik_cli.cages.repairing.tidy import (
    count_edge_uses,
    count_topology_faults,
    drop_unreferenced,
    find_boundary_vertices,
    find_coincident,
    find_fins,
    find_inward,
    find_repeated,
    find_turned,
    label_patches,
    replace_corners,
)
from cageik_cli.geometry.mesh import TriMesh, signed_volumes
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import CageError
from cageik_cli.util.text import format_count

MAX_WALLS = 30
"""Patches of a cage whose edges have more than two faces that are tried as inner walls."""

NO_VERTICES: Integers = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """A cage under repair.

    Attributes
    ----------
    vertex_map : (n,) int64
        The number of each vertex of the cage given, −1 if it has gone.
    """

    mesh: PolygonMesh
    vertex_map: Integers
    steps: tuple[RepairStep, ...] = field(default=())

    @property
    def origins(self) -> Integers:
        """Return the number in the cage given of each vertex, the first of those merged."""
        numbers = np.arange(len(self.vertex_map))[::-1]
        origins = np.full(len(self.mesh.vertices), -1)
        kept = self.vertex_map[::-1] >= 0
        origins[self.vertex_map[::-1][kept]] = numbers[kept]
        return origins

    def change(self, mesh: PolygonMesh, step: RepairStep) -> "Draft":
        """Return the draft after a step that leaves the numbers of the vertices."""
        return replace(self, mesh=mesh, steps=(*self.steps, step))


def tidy_faces(draft: Draft, samples: Floats, max_hole_edges: int) -> Draft:
    """Run every step on the faces: causes come before their effects."""
    draft = merge_vertices(draft)
    draft = drop_repeated_faces(draft)
    draft = drop_fins(draft)
    draft = drop_inner_walls(draft)
    draft = turn_faces(draft)
    draft = close_holes(draft, max_hole_edges)
    draft = drop_loose_parts(draft, samples)
    draft = turn_faces(draft)
    return drop_vertices(draft)


def merge_vertices(draft: Draft) -> Draft:
    """Merge vertices at one place: all, or those on open edges if all would not stay manifold."""
    mesh = draft.mesh
    if len(replace_corners(mesh, np.arange(len(mesh.vertices))).corners) == 0:
        raise CageError("all faces of the cage have a vertex twice; nothing of it would be left")
    before = count_topology_faults(mesh)
    for candidates in (np.arange(len(mesh.vertices)), find_boundary_vertices(mesh)):
        target = find_coincident(mesh.vertices, candidates)
        gone = np.flatnonzero(target != np.arange(len(target)))
        merged = replace_corners(mesh, target)
        if len(merged.corners) and count_topology_faults(merged) <= before:
            break
    else:
        gone, merged, target = NO_VERTICES, mesh, np.arange(len(mesh.vertices))
    lost = len(mesh.corner_counts) - len(merged.corner_counts)
    if len(gone) == 0 and lost == 0:
        return draft
    parts = [f"merged {format_elements('vertex', gone)} with others at the same place"] * bool(
        len(gone)
    )
    parts += [f"deleted {format_count(lost, 'face')} with a vertex twice"] * bool(lost)
    step = RepairStep("merge", " and ".join(parts), max(len(gone), lost), gone)
    return replace(
        draft, mesh=merged, vertex_map=target[draft.vertex_map], steps=(*draft.steps, step)
    )


def drop_repeated_faces(draft: Draft) -> Draft:
    """Delete faces on the vertices of others, and faces that touch nothing else."""
    mesh = draft.mesh
    draft = _drop_faces(draft, find_repeated(mesh), "that repeat others")
    uses, _ = count_edge_uses(draft.mesh)
    open_sides = np.bincount(draft.mesh.polygon_numbers[uses == 1])
    loose = _pad(open_sides, draft.mesh) == draft.mesh.corner_counts
    return draft if loose.all() else _drop_faces(draft, loose, "that touch no others")


def drop_fins(draft: Draft) -> Draft:
    """Delete faces that stand out from an edge of two others."""
    return _drop_faces(draft, find_fins(draft.mesh), "that stand on an edge of two others")


def drop_inner_walls(draft: Draft) -> Draft:
    """Delete a patch of faces whose edges two others share; the largest volume stays."""
    while True:
        mesh = draft.mesh
        uses, _ = count_edge_uses(mesh)
        labels = label_patches(mesh)
        if not (uses > 2).any() or labels.max() >= MAX_WALLS:
            return draft
        before = count_topology_faults(mesh)
        best, most = None, 0.0
        for patch in range(labels.max() + 1):
            kept = labels != patch
            if not kept.any() or count_topology_faults(mesh.keep(kept)) >= before:
                continue
            volume = _total_volume(mesh.keep(kept))
            if volume > most:
                best, most = patch, volume
        if best is None:
            return draft
        draft = _drop_faces(draft, labels == best, "inside the cage")


def turn_faces(draft: Draft) -> Draft:
    """Turn faces until neighbours agree, then closed components until they face outward."""
    turned = find_turned(draft.mesh)
    mesh = draft.mesh.turn(turned)
    inward = find_inward(mesh)
    turned ^= inward
    if not turned.any():
        return draft
    mesh = mesh.turn(inward)
    numbers = np.flatnonzero(turned)
    what = "all faces" if turned.all() else format_elements("face", numbers)
    step = RepairStep("turn", f"turned {what} to face outward", len(numbers), NO_VERTICES)
    return draft.change(mesh, step)


def close_holes(draft: Draft, max_edges: int) -> Draft:
    """Put faces over holes that have few edges and pass no vertex twice."""
    for loop in find_holes(draft.mesh):
        closed = close_hole(draft.mesh, loop)
        fits = count_topology_faults(closed) < count_topology_faults(draft.mesh)
        if len(loop) <= max_edges and fits and not find_repeated(closed).any():
            at = draft.origins[loop]
            message = f"closed a hole of {len(loop)} edges at {format_elements('vertex', at)}"
            draft = draft.change(closed, RepairStep("close-hole", message, 1, NO_VERTICES))
    return draft


def drop_loose_parts(draft: Draft, samples: Floats) -> Draft:
    """Delete the components of the cage that hold nothing of the model which the main one lacks."""
    mesh = draft.mesh
    labels = label_patches(mesh)
    if labels.max() == 0:
        return draft
    uses, _ = count_edge_uses(mesh)
    is_open = np.bincount(labels[mesh.polygon_numbers[uses == 1]], minlength=labels.max() + 1) > 0
    held = [_find_held(mesh.keep(labels == patch), samples) for patch in range(labels.max() + 1)]
    volumes = [_total_volume(mesh.keep(labels == patch)) for patch in range(labels.max() + 1)]
    order = [(not is_open[k], held[k].sum(), volumes[k]) for k in range(len(held))]
    main = max(range(len(order)), key=order.__getitem__)
    needless = [k for k in range(len(held)) if is_open[k] or not (held[k] & ~held[main]).any()]
    chosen = np.isin(labels, [k for k in needless if k != main])
    if is_open[main]:
        return draft
    return _drop_faces(draft, chosen, "of parts that hold nothing of the model", "drop-part")


def drop_vertices(draft: Draft) -> Draft:
    """Delete vertices that are in no face; the others keep their order."""
    mesh, numbers = drop_unreferenced(draft.mesh)
    gone = np.flatnonzero(numbers < 0)
    if len(gone) == 0:
        return draft
    origins = draft.origins[gone]
    vertex_map = np.where(draft.vertex_map >= 0, numbers[draft.vertex_map], -1)
    draft = replace(draft, mesh=mesh, vertex_map=vertex_map)
    origins = origins[origins >= 0]
    if len(origins) == 0:
        return draft
    message = f"deleted {format_elements('vertex', origins)} in no face"
    step = RepairStep("drop-vertices", message, len(origins), origins)
    return replace(draft, steps=(*draft.steps, step))


def _drop_faces(
    draft: Draft, chosen: NDArray[np.bool_], what: str, kind: str = "drop-faces"
) -> Draft:
    if not chosen.any():
        return draft
    if chosen.all():
        raise CageError(f"the cage has only faces {what}; nothing of it would be left")
    count = int(chosen.sum())
    message = f"deleted {format_elements('face', np.flatnonzero(chosen))} {what}"
    return draft.change(draft.mesh.keep(~chosen), RepairStep(kind, message, count, NO_VERTICES))


def _find_held(part: PolygonMesh, samples: Floats) -> NDArray[np.bool_]:
    return np.abs(winding_numbers(part.triangles, samples)) > 0.5


def _total_volume(mesh: PolygonMesh) -> float:
    """Return the absolute volume of a cage with its faces turned alike."""
    alike = mesh.turn(find_turned(mesh))
    return float(abs(signed_volumes(alike.vertices[None], alike.triangles.faces)[0]))


def _pad(counts: Integers, mesh: PolygonMesh) -> Integers:
    return np.pad(counts, (0, len(mesh.corner_counts) - len(counts)))


def start_draft(cage: TriMesh, corner_counts: Integers | None) -> Draft:
    """Return a draft of a cage as it was given."""
    return Draft(PolygonMesh.from_fans(cage, corner_counts), np.arange(len(cage.vertices)))
