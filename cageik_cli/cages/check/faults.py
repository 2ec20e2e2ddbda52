"""Faults of a cage by itself, with the numbers, from 0, of all faulty elements.

Each is a finding: a sentence for users, and numbers for programs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.geometry.intersections import self_intersections
from cageik_cli.geometry.mesh import TriMesh, find_groups
from cageik_cli.geometry.shape import bounds_volume, degenerate_face_mask
from cageik_cli.util.arrays import Integers, Mask
from cageik_cli.util.errors import MAX_LISTED, CageError, join_truncated
from cageik_cli.util.messages import Note, Said
from cageik_cli.util.text import format_count, pluralize

SEVERITIES = ("unfit", "warning", "note")
"""From the worst: it does not bind; it binds, but something will be poor; a remark."""

MIN_THICKNESS = 1e-9
"""Cages with less volume, in their area times their diagonal, bound none: it is rounding."""

Point = tuple[float, float, float]
"""A place, file units."""

_FAULTS = {
    "repeated-vertex": ("face", "has a vertex twice in a face:", "delete {it}"),
    "degenerate-face": (
        "face",
        "is degenerate, corners on a line, at",
        "move or merge vertices there",
    ),
    "duplicate-face": ("face", "has faces that repeat others:", "delete {it}"),
    "unreferenced-vertex": (
        "vertex",
        "has vertices in no face, which can move nothing:",
        "delete {it}",
    ),
    "non-manifold-edge": (
        "edge",
        "is not manifold: more than two faces meet at",
        "remove the inner faces",
    ),
    "open-edge": ("edge", "is open: no second face at", "close the hole"),
    "orientation": ("edge", "has neighbours facing opposite ways at", "recalculate its normals"),
    "pinched-vertex": (
        "vertex",
        "is not manifold: its parts touch in a point at",
        "separate them there",
    ),
    "self-intersection": (
        "face pair",
        "crosses or touches itself at",
        "move vertices until faces meet only at common edges and corners",
    ),
}
"""The faults that have elements: what these are, what is wrong with the cage, and what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """One fault or remark.

    Attributes
    ----------
    kind : str
        An identifier for programs, such as `open-edge`.
    severity : str
        One of `SEVERITIES`.
    message : str
        What was found, and where; with names that users gave, and no parameters.
    remedy : str or Text
        What to do; it may name parameters, and no names of users.
    elements : str
        What `numbers` are: `vertices`, `edges`, `faces`, `face pairs`; empty without numbers.
    numbers : (k,) or (k, 2) int64
        All elements, from 0; an edge is its two vertices.
    value : float
        The measured value: the number of elements, unless the message has another one.
    mesh : str
        Of which mesh the elements are: `cage`, `rest`, or `both` for pairs of a face of the rest
        pose and one of the cage.
    place : tuple of float, optional
        Where it is, if it has no elements, file units.
    """

    kind: str
    severity: str
    message: str
    remedy: Said
    elements: str = ""
    numbers: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    value: float = 0.0
    mesh: str = "cage"
    place: Point | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", float(self.value))

    @property
    def sentence(self) -> Said:
        """Return the message and the remedy."""
        return f"{self.message}; " + self.remedy


def validate_cage(cage: TriMesh) -> tuple[TriMesh, tuple[Note, ...]]:
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
        return cage.flip(), tuple(Note(finding.message, "warning") for finding in findings)
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
    found = [
        *_find("repeated-vertex", np.flatnonzero(repeats_corner)),
        *_find("degenerate-face", np.flatnonzero(is_flat)),
        *_find("duplicate-face", np.flatnonzero(is_duplicate)),
        *_find("unreferenced-vertex", cage.unused_vertices),
    ]
    kept = np.flatnonzero(~(repeats_corner | is_duplicate))
    if len(kept):
        surface = TriMesh(cage.vertices, cage.faces[kept])
        joined, remedy, edges = surface, "", surface.edges
        if not surface.is_closed:
            # Its vertices may not be merged yet: coincident ones are then taken as the first.
            places = np.unique(surface.vertices, axis=0, return_index=True, return_inverse=True)
            joined = TriMesh(surface.vertices, places[1][places[2].ravel()][surface.faces])
            if not np.array_equal(joined.faces, surface.faces):
                remedy = "merge coincident vertices, then close the remaining holes"
        found += _find("non-manifold-edge", edges.ends[edges.face_counts > 2])
        found += _find("open-edge", edges.ends[edges.face_counts < 2], remedy)
        is_turned = (edges.face_counts == 2) & ~edges.is_balanced
        found += _find("orientation", edges.ends[is_turned])
        found += _find("pinched-vertex", np.flatnonzero(count_fans(surface) > 1))
        found += [*_find_loose_components(joined), *_find_volume_faults(surface)]
        found += _find("self-intersection", kept[_find_self_intersections(joined, is_flat[kept])])
    return tuple(found)


def _find(kind: str, numbers: Integers, remedy: str = "") -> Iterator[Finding]:
    """Yield a fault at these elements, if there are any; with another remedy if one is given."""
    if len(numbers) == 0:
        return
    noun, what, usual_remedy = _FAULTS[kind]
    message = f"the cage {what} {format_elements(noun, numbers)}"
    remedy = remedy or usual_remedy.format(it="it" if len(numbers) == 1 else "them")
    numbers, elements = numbers.astype(np.int64), pluralize(noun)
    yield Finding(kind, "unfit", message, remedy, elements, numbers, len(numbers))


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
        message = (
            f"the cage has {len(parts)} components (of {join_truncated(sizes, MAX_LISTED)} "
            "vertices), expected "
            "one connected surface"
        )
        remedy = "join them or delete the loose ones"
        yield Finding("components", "unfit", message, remedy, "vertices", small, len(parts))


def _find_volume_faults(surface: TriMesh) -> Iterator[Finding]:
    """Find a volume below `MIN_THICKNESS` times area times diagonal, or below 0."""
    if not bounds_volume(surface):
        return
    volume, area = surface.volume, surface.face_areas.sum()
    if abs(volume) <= MIN_THICKNESS * area * surface.diagonal:
        message = f"the cage bounds no volume ({volume:.3g} in an area of {area:.3g})"
        yield Finding("no-volume", "unfit", message, "give it thickness", value=volume)
    elif volume < 0:
        message = "the cage's faces turn inward; it is used turned outward"
        remedy = "recalculate its normals to avoid this warning"
        yield Finding("inward", "warning", message, remedy, value=volume)


def _find_self_intersections(surface: TriMesh, is_degenerate: Mask) -> Integers:
    """Return pairs of faces, (p, 2), that meet, except at the vertices of degenerate faces."""
    faces = surface.faces
    judged = np.flatnonzero(~np.isin(faces, faces[is_degenerate]).any(axis=1))
    if len(judged) == 0:
        return np.empty((0, 2), np.int64)
    return judged[self_intersections(TriMesh(surface.vertices, faces[judged]))]


def format_elements(noun: str, numbers: ArrayLike) -> str:
    """Return a text such as `face 12`, `edge 3-7` or `3 edges (1-3, 3-7, 1-7)`."""
    names = ["-".join(map(str, np.ravel(number))) for number in np.asarray(numbers).tolist()]
    if len(names) == 1:
        return f"{noun} {names[0]}"
    return f"{format_count(len(names), noun)} ({join_truncated(names, MAX_LISTED)})"
