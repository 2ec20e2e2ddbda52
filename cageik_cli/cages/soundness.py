"""Tests whether a cage is sound by itself, with the numbers, from 0, of all faulty elements."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.findings import Finding, format_elements, pluralize
from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.geometry.shape import bounds_volume, degenerate_face_mask
from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import CageError, join_truncated
from cageik_cli.util.progress import mark_warning

MIN_VOLUME_RATIO = 1e-9
"""Smallest volume of a cage, relative to its area times its diagonal."""

_REMEDIES = {
    "repeated-vertex": "delete {it}",
    "degenerate-face": "move or merge vertices there",
    "duplicate-face": "delete {it}",
    "unreferenced-vertex": "delete {it}",
    "non-manifold-edge": "remove the inner faces",
    "open-edge": "close the hole",
    "unmerged-edge": "merge coincident vertices, then close the remaining holes",
    "orientation": "recalculate its normals",
    "pinched-vertex": "separate them there",
    "self-intersection": "move vertices until faces meet only at common edges and corners",
}


def validate_cage(cage: TriMesh) -> tuple[TriMesh, tuple[str, ...]]:
    """Return the cage with its faces turned outward, and notes on changes.

    Raises
    ------
    CageError
        Unless the cage is a closed, manifold, consistently oriented surface of one component,
        without self-intersections, degenerate or repeated faces, or unreferenced vertices.
    """
    findings = find_cage_faults(cage)
    for finding in findings:
        if finding.severity == "unfit":
            error = CageError(finding.sentence)
            error.is_repairable = True
            raise error
    if findings:
        return cage.flip(), tuple(mark_warning(finding.message) for finding in findings)
    return cage, ()


def find_cage_faults(cage: TriMesh) -> tuple[Finding, ...]:
    """Find all faults of a cage itself, causes before their consequences.

    Faces that should be deleted (a repeated vertex, a repeated face) are left out of the later
    tests.
    """
    corners = np.sort(cage.faces, axis=1)
    repeats_corner = (corners[:, 1:] == corners[:, :-1]).any(axis=1)
    _, first = np.unique(corners, axis=0, return_index=True)
    is_duplicate = ~repeats_corner & ~np.isin(np.arange(len(corners)), first)
    is_flat = degenerate_face_mask(cage) & ~repeats_corner & ~is_duplicate
    unreferenced = cage.unused_vertices
    found = [
        _make_finding("repeated-vertex", "has a vertex twice in a face:", "face", repeats_corner),
        _make_finding("degenerate-face", "is degenerate, corners on a line, at", "face", is_flat),
        _make_finding("duplicate-face", "has faces that repeat others:", "face", is_duplicate),
        _make_finding(
            "unreferenced-vertex",
            "has vertices in no face, which can move nothing:",
            "vertex",
            unreferenced,
        ),
    ]
    kept = np.flatnonzero(~(repeats_corner | is_duplicate))
    if len(kept):
        surface = TriMesh(cage.vertices, cage.faces[kept])
        # Vertices of an open cage may not be merged yet: coincident vertices are then taken as one.
        joined = surface if surface.is_closed else _merge_coincident_vertices(surface)
        found += [*_find_edge_faults(surface, joined), _find_nonmanifold_vertices(surface)]
        found += [*_find_loose_components(joined), *_find_volume_faults(surface)]
        found += [_find_self_intersections(joined, kept, is_flat[kept])]
    return tuple(finding for finding in found if finding is not None)


def _make_finding(
    kind: str,
    description: str,
    noun: str,
    mask_or_numbers: NDArray[np.bool_] | Integers,
    remedy_kind: str = "",
) -> Finding | None:
    """Return a fault at the elements of a mask or a list; None if there are none."""
    numbers = (
        np.flatnonzero(mask_or_numbers) if mask_or_numbers.dtype == np.bool_ else mask_or_numbers
    )
    if len(numbers) == 0:
        return None
    remedy = _REMEDIES[remedy_kind or kind].format(it="it" if len(numbers) == 1 else "them")
    message = f"the cage {description} {format_elements(noun, numbers)}"
    return Finding(
        kind,
        "unfit",
        message,
        remedy,
        pluralize(noun),
        numbers.astype(np.int64),
        float(len(numbers)),
    )


def _find_edge_faults(surface: TriMesh, joined: TriMesh) -> Iterator[Finding | None]:
    edges = surface.edges
    unmerged = "" if np.array_equal(joined.faces, surface.faces) else "unmerged-edge"
    for kind, what, bad, remedy_kind in (
        (
            "non-manifold-edge",
            "is not manifold: more than two faces meet at",
            edges.face_counts > 2,
            "",
        ),
        ("open-edge", "is open: no second face at", edges.face_counts < 2, unmerged),
        (
            "orientation",
            "has neighbours facing opposite ways at",
            (edges.face_counts == 2) & ~edges.is_balanced,
            "",
        ),
    ):
        yield _make_finding(kind, what, "edge", edges.ends[bad], remedy_kind)


def _find_nonmanifold_vertices(surface: TriMesh) -> Finding | None:
    pinched = np.flatnonzero(count_fans(surface) > 1)
    return _make_finding(
        "pinched-vertex", "is not manifold: its parts touch in a point at", "vertex", pinched
    )


def count_fans(surface: TriMesh) -> Integers:
    """Count the parts of the faces at each vertex that edges hold together, (n,); 0 without one.

    Corners of faces are one part if the faces share an edge there.
    """
    faces, edges = surface.faces, surface.edges
    corners = np.arange(faces.size).reshape(faces.shape)
    # The corners at both ends of each side of a face, in the order of the edge's ends.
    after, before = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
    is_forward = np.roll(faces, -1, axis=1) < np.roll(faces, 1, axis=1)
    low, high = np.where(is_forward, after, before), np.where(is_forward, before, after)
    first = edges.first_side[edges.side_edges].ravel()
    pairs = [np.stack([end.ravel(), end.ravel()[first]], axis=1) for end in (low, high)]
    part = find_groups(np.concatenate(pairs), faces.size)
    one = np.unique(part, return_index=True)[1]
    return np.bincount(faces.ravel()[one], minlength=len(surface.vertices))


def _find_loose_components(surface: TriMesh) -> Iterator[Finding]:
    used = np.unique(surface.faces)
    parts, of_vertex = np.unique(surface.components[used], return_inverse=True)
    if len(parts) > 1:
        sizes = np.bincount(of_vertex)
        small = used[of_vertex != sizes.argmax()]
        yield Finding(
            kind="components",
            severity="unfit",
            message=f"the cage has {len(parts)} components (of {join_truncated(sizes)} vertices), "
            "expected one connected surface",
            remedy="join them or delete the loose ones",
            elements="vertices",
            numbers=small,
            value=float(len(parts)),
        )


def _find_volume_faults(surface: TriMesh) -> Iterator[Finding]:
    if not bounds_volume(surface):
        return
    area = surface.face_areas.sum()
    no_numbers = np.empty(0, np.int64)
    if abs(surface.volume) <= MIN_VOLUME_RATIO * area * surface.diagonal:
        yield Finding(
            kind="no-volume",
            severity="unfit",
            message=f"the cage bounds no volume ({surface.volume:.3g} in an area of {area:.3g})",
            remedy="give it thickness",
            elements="",
            numbers=no_numbers,
            value=surface.volume,
        )
    elif surface.volume < 0:
        yield Finding(
            kind="inward",
            severity="warning",
            message="the cage's faces turn inward; it is used turned outward",
            remedy="recalculate its normals to avoid this warning",
            elements="",
            numbers=no_numbers,
            value=surface.volume,
        )


def _find_self_intersections(
    surface: TriMesh, face_numbers: Integers, is_degenerate: NDArray[np.bool_]
) -> Finding | None:
    """Find faces that cross or touch, except at the vertices of degenerate faces."""
    faces = surface.faces
    judged = np.flatnonzero(~np.isin(faces, faces[is_degenerate]).any(axis=1))
    if len(judged) == 0:
        return None
    pairs = self_intersections(TriMesh(surface.vertices, faces[judged]))
    what = "crosses or touches itself at"
    return _make_finding("self-intersection", what, "face pair", face_numbers[judged[pairs]])


def _merge_coincident_vertices(surface: TriMesh) -> TriMesh:
    """Return the same vertices, with faces that use the first of coincident vertices."""
    _, first, place_of = np.unique(surface.vertices, axis=0, return_index=True, return_inverse=True)
    return TriMesh(surface.vertices, first[place_of.ravel()][surface.faces])
