"""Meshes as they are read from files: polygons are cut into triangles, connectivities compared.

A polygon that a fan would fold over is cut by clipping ears.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.attributes import (
    LAYERS,
    SurfaceAttributes,
    check_corner_counts,
    fan_triangulate,
    find_folded_triangles,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import MAX_NAMED, ConnectivityError, FormatError, join_truncated
from cageik_cli.util.messages import Note, say
from cageik_cli.util.text import format_count, group_digits, pluralize

LayerReaders = dict[str, Callable[[SurfaceAttributes], SurfaceAttributes]]
"""What adds each layer to the attributes before it, by its name in a note: "its normals"."""

MAX_STEPS = 200_000_000
"""Steps that all polygons of a mesh may take, of ten nanoseconds."""

MAX_CORNER_STEPS = 10_000
"""Steps that they may take besides for each of their corners."""

TEST_STEPS = 2000
"""Steps of a test of an ear, apart from one for each corner that is compared with it."""


@dataclass(frozen=True, slots=True)
class Change:
    """What reading has changed of a mesh, in words that many meshes share.

    Attributes
    ----------
    words : str
        A sentence with {} for what is counted or named, and {span} for the numbers in between.
    noun : str
        What is counted, or named.
    count : int
        Of these; not used where there are names.
    names : tuple of str
        Of these.
    span : tuple of float
        The smallest and the largest of some numbers.
    limit : int
        Names that are shown; the others are counted.
    """

    words: str
    noun: str = ""
    count: int = 0
    names: tuple[str, ...] = ()
    span: tuple[float, float] = (0, 0)
    limit: int = MAX_NAMED

    def __str__(self) -> str:
        low, high = (f"{number:.3g}" for number in self.span)
        span = low if low == high else f"{low} to {high}"
        things = format_count(self.count, self.noun) if self.noun else ""
        if self.names:
            noun = self.noun and (self.noun if len(self.names) == 1 else pluralize(self.noun))
            things = f"{noun} {join_truncated(self.names, self.limit)}".lstrip()
        return self.words.format(things, span=span)

    def __add__(self, other: "Change") -> "Change":
        return replace(
            self,
            count=self.count + other.count,
            names=tuple(dict.fromkeys((*self.names, *other.names))),
            span=(min(self.span[0], other.span[0]), max(self.span[1], other.span[1])),
        )


@dataclass(frozen=True, slots=True, eq=False)
class FileMesh:
    """The content of a mesh file, not yet checked.

    Attributes
    ----------
    vertices : (n, 3) float64
        Each value is `float(text)` to the bit; may not be finite.
    corners : (c,) int64
        The vertices of the faces, from 0, one face after the other.
    corner_counts : (p,) int64
        How many corners each face has.
    attributes : SurfaceAttributes, optional
        What else the file says of the surface; its polygons alone if absent.
    left_out : tuple of str or Change
        What of that cannot be used, or was changed, one sentence each.
    """

    vertices: Floats
    corners: Integers
    corner_counts: Integers
    attributes: SurfaceAttributes | None = None
    left_out: tuple[str | Change, ...] = ()

    @staticmethod
    def from_polygons(vertices: Floats, polygons: Sequence[Sequence[int] | Integers]) -> "FileMesh":
        """Return the mesh of polygons, each given by its vertices."""
        counts = np.array([len(polygon) for polygon in polygons], np.int64)
        corners = np.fromiter(chain.from_iterable(polygons), np.int64, counts.sum())
        return FileMesh(vertices, corners, counts)

    @property
    def fans(self) -> Integers:
        """The faces cut into triangles (f, 3), as fans around their first corners."""
        return fan_triangulate(self.corners, self.corner_counts)

    @property
    def polygon_count(self) -> int:
        """Number of faces with more than three corners."""
        return int(np.count_nonzero(self.corner_counts > 3))

    def read_layers(self, layers: LayerReaders) -> "FileMesh":
        """Return it with all that its file says of the surface; a damaged layer is left out."""
        check_corner_counts(self.corner_counts)
        attributes = SurfaceAttributes(self.corner_counts, self.corners)
        left_out = list(self.left_out)
        for noun, read in layers.items():
            try:
                attributes = read(attributes)
            except (FormatError, ValueError) as error:
                words = f"{noun} left out ({{}})"
                left_out.append(Change(words, names=(str(error),), limit=1))
        return replace(self, attributes=attributes, left_out=tuple(left_out))

    def turn_faces(self) -> "FileMesh":
        """Return it with faces and attributes that turn the other way round."""
        assert self.attributes is not None
        turned = self.attributes.reverse(keeps_first=False)
        return replace(self, corners=turned.corners, attributes=turned)

    def make_mesh(self) -> TriMesh:
        """Return the checked mesh: polygons are fans, or ears where a fan would fold over."""
        mesh = TriMesh(self.vertices, self.fans)
        attributes = self.attributes
        if attributes is None and self.polygon_count:
            attributes = SurfaceAttributes(self.corner_counts, self.corners)
        if attributes is None or attributes.is_plain:
            return mesh
        return replace_folded_fans(replace(mesh, attributes=attributes))

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed, one sentence each."""
        if not self.polygon_count:
            return tuple(map(str, self.left_out))
        return (describe_cut(self.polygon_count), *map(str, self.left_out))


def describe_cut(polygon_count: int) -> str:
    """Return a note on polygons with more than three corners."""
    return f"{format_count(polygon_count, 'polygon')} cut into triangles to compute with"


def list_layer_readers(
    names: Iterable[str], read: Callable[[str, SurfaceAttributes], SurfaceAttributes]
) -> LayerReaders:
    """Return what reads layers of numbers, with a function of the name of the layer."""
    return {f"its {LAYERS[name].noun}": partial(read, name) for name in names}


def check_not_points(vertex_count: int, face_count: int) -> None:
    """Refuse points without faces."""
    if vertex_count and not face_count:
        raise FormatError(
            f"is a point cloud: {group_digits(vertex_count)} points and no faces, expected a mesh; "
            "reconstruct its surface, or export the mesh with its faces; "
            + say("deform (`mesh=`) and pose take points as .ply")
        )


@dataclass(frozen=True, slots=True, eq=False)
class LoadedMesh:
    """A mesh and where it came from.

    Attributes
    ----------
    source : dict
        `name` and `sha256` of the file; the name alone of a frame of the clip.
    notes : tuple of Note
        What was changed.
    path : Path, optional
        The mesh file; None of a mesh that is in no file, or in one of many frames.
    scene : SceneHints
        Unit and up axis, as far as the file states them.
    is_welded : bool
        Whether its file holds corners alone, so that the numbers of its vertices mean nothing.
    """

    mesh: TriMesh
    source: dict[str, str]
    notes: tuple[Note, ...] = ()
    path: Path | None = None
    scene: SceneHints = field(default_factory=SceneHints)
    is_welded: bool = False


def check_connectivity(count: int, faces: Integers, expected: TriMesh, expected_name: str) -> None:
    """Refuse a mesh whose counts or `faces` differ from the expected ones."""
    for noun, found, wanted in (
        ("vertices", count, len(expected.vertices)),
        ("triangles", len(faces), len(expected.faces)),
    ):
        if found != wanted:
            cut = "; if it is cut off, export it again" * (found < wanted)
            raise ConnectivityError(
                f"{found} {noun}, {expected_name} has {wanted}; "
                f"all must share one connectivity{cut}"
            )
    if faces is expected.faces:
        return
    differs = np.flatnonzero((faces != expected.faces).any(axis=1))
    if len(differs):
        k = differs[0]
        raise ConnectivityError(
            f"triangle {k} joins vertices {_format_corners(faces[k])}, in {expected_name} "
            f"{_format_corners(expected.faces[k])} (counted from 0; {group_digits(len(differs))} "
            "triangles "
            "differ); all must share one connectivity"
        )


def _format_corners(corners: Integers) -> str:
    return "-".join(map(str, corners))


def check_vertex_order(first: TriMesh, expected: TriMesh, expected_name: str) -> None:
    """Refuse a clip whose faces do not join the vertices that those of `expected` join.

    Other programs write faces in another order, from another corner or reversed, and cut quads
    along the other diagonal: the vertices keep their numbers, so that is accepted.
    """
    found = first.fan_triangulated
    counts = [(len(mesh.vertices), len(mesh.faces)) for mesh in (found, expected)]
    if counts[0] == counts[1]:
        if any(_has_same_edges(mesh, expected) for mesh in (found, first)):
            return
        if np.array_equal(_sorted_valences(found), _sorted_valences(expected)):
            raise ConnectivityError(
                f"as many vertices and triangles as {expected_name}, in another order; export it "
                "again from the mesh that cageik export wrote, and keep the vertex order"
            )
    check_connectivity(len(found.vertices), found.faces, expected, expected_name)


def _has_same_edges(mesh: TriMesh, expected: TriMesh) -> bool:
    """Return whether both have the same edges, apart from the diagonals of quads."""
    ours, theirs = mesh.edges.ends, expected.edges.ends
    new, lost = ~_rows_in(ours, theirs), ~_rows_in(theirs, ours)
    face, corner = np.nonzero(new[mesh.edges.side_edges])
    # The other diagonal joins the two corners opposite a new edge.
    edge = mesh.edges.side_edges[face, corner]
    facing = mesh.faces[face, corner][np.argsort(edge, kind="stable")]
    if (mesh.edges.face_counts[new] != 2).any():
        return False
    others = np.sort(facing.reshape(-1, 2), axis=1)
    return len(others) == np.count_nonzero(lost) and bool(_rows_in(theirs[lost], others).all())


def _sorted_valences(mesh: TriMesh) -> Integers:
    """Return the number of faces at each vertex, sorted."""
    return np.sort(np.bincount(mesh.faces.ravel()))


def _rows_in(pairs: Integers, others: Integers) -> np.ndarray:
    """Return which rows of `pairs` (a, 2) are rows of `others` (b, 2)."""
    base = int(max(pairs.max(initial=0), others.max(initial=0))) + 1
    return np.isin(pairs @ [base, 1], others @ [base, 1])


def replace_folded_fans(mesh: TriMesh) -> TriMesh:
    """Cut the polygons again whose fans fold over, by clipping ears.

    Ears are found in the plane of the polygon's area vector (Newell). A polygon that crosses itself
    and has none keeps its fan, as does one that would take too long. A polygon's triangles stay
    where its fan was.
    """
    if mesh.attributes is None:
        return mesh
    counts = mesh.attributes.corner_counts - 2
    starts = np.cumsum(counts) - counts
    folded, whole = find_folded_triangles(mesh.vertices, mesh.faces, counts)
    if not folded.any():
        return mesh
    faces = mesh.faces.copy()
    polygons = np.unique(mesh.attributes.triangle_polygons[folded])
    steps = MAX_STEPS + MAX_CORNER_STEPS * int(counts[polygons].sum())
    for k in polygons:
        fan = slice(starts[k], starts[k] + counts[k])
        ring = np.concatenate([faces[fan][0, :2], faces[fan][:, 2]])
        clipping = _EarClipping(_project_to_plane(mesh.vertices[ring], whole[k]))
        ears = clipping.cut(steps)
        steps -= clipping.steps
        if ears is not None:
            faces[fan] = ring[ears]
    return TriMesh(mesh.vertices, faces, mesh.attributes)


def describe_folded(mesh: TriMesh) -> list[Change]:
    """Return a note on the polygons whose triangles fold over, if there are any."""
    if mesh.attributes is None:
        return []
    folded, _ = find_folded_triangles(mesh.vertices, mesh.faces, mesh.attributes.corner_counts - 2)
    count = len(np.unique(mesh.attributes.triangle_polygons[folded]))
    words = "of {}, some triangles lie over others: sides cross, or wind too much to be cut well"
    return [Change(words, "polygon", count)] * (count > 0)


def _project_to_plane(points: Floats, normal: Floats) -> Floats:
    """Project points (k, 3) along `normal`, (k, 2); counter-clockwise seen against it."""
    direction = normal / np.abs(normal).max()  # first, since tiny squares would be zeros
    direction /= np.linalg.norm(direction)
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    return np.asarray((points - points[0]) @ np.stack([across, np.cross(direction, across)]).T)


class _EarClipping:
    """Cuts a polygon (k, 2), counter-clockwise, into triangles (Meisters 1975).

    A triangle of neighbours is an ear if it turns left and holds no other corner. Only corners that
    do not turn left can lie in one; those near a triangle are found along x.
    """

    def __init__(self, points: Floats) -> None:
        count = len(points)
        self._xy = points.tolist()
        self._before, self._after = [count - 1, *range(count - 1)], [*range(1, count), 0]
        reflex = [corner for corner in range(count) if not self._turns_left(corner)]
        reflex.sort(key=points[:, 0].__getitem__)
        self._places = {corner: place for place, corner in enumerate(reflex)}
        self._x, self._y = np.ascontiguousarray(points[reflex].T)
        self.steps = 0

    def cut(self, most: int) -> list[list[int]] | None:
        """Return the triangles; None if there is no ear, or that takes more than `most` steps."""
        count, known = len(self._xy), -1
        ears: dict[int, list[int]] = {}
        waiting: deque[int] = deque()
        while len(ears) < count - 3:
            if not waiting and known < len(ears):
                known = len(ears)
                waiting.extend(corner for corner in range(count) if corner not in ears)
            if not waiting or self.steps > most:
                return None
            corner = waiting.popleft()
            if corner not in ears and self._turns_left(corner) and self._is_ear(corner):
                before, after = self._before[corner], self._after[corner]
                self._after[before], self._before[after] = after, before
                self._forget_if_left(before)
                self._forget_if_left(after)
                ears[corner] = [before, corner, after]
                # Either may be an ear now. They wait, so that ears are no fan of thin triangles.
                waiting += (before, after)
        last = [corner for corner in range(count) if corner not in ears]
        return [*ears.values(), last]

    def _turns_left(self, corner: int) -> bool:
        (ax, ay), (bx, by), (cx, cy) = self._list_triangle(corner)
        return (bx - ax) * (cy - by) - (by - ay) * (cx - bx) > 0

    def _list_triangle(self, corner: int) -> list[list[float]]:
        return [self._xy[k] for k in (self._before[corner], corner, self._after[corner])]

    def _forget_if_left(self, corner: int) -> None:
        """Keep a corner that turns left from being found in triangles: nan lies in none."""
        if corner in self._places and self._turns_left(corner):
            self._y[self._places.pop(corner)] = np.nan

    def _is_ear(self, corner: int) -> bool:
        triangle = self._list_triangle(corner)
        xs = [x for x, _ in triangle]
        first, last = self._x.searchsorted(min(xs)), self._x.searchsorted(max(xs), "right")
        self.steps += TEST_STEPS + int(last - first)
        return not _holds_any(triangle, self._x[first:last], self._y[first:last])


def _holds_any(triangle: list[list[float]], x: Floats, y: Floats) -> bool:
    """Return whether points lie in a triangle that turns left, apart from its corners."""
    for (ax, ay), (bx, by) in pairwise([*triangle, triangle[0]]):
        is_left = (bx - ax) * (y - ay) >= (by - ay) * (x - ax)
        x, y = x[is_left], y[is_left]
    return any([cx, cy] not in triangle for cx, cy in zip(x.tolist(), y.tolist(), strict=True))
