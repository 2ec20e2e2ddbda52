"""Triangle meshes: edges, components, volume."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cageik_cli.geometry.attributes import SurfaceAttributes, fan_triangulate
from cageik_cli.util.arrays import Floats, Integers, Number
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import group_digits

MAX_COORDINATE = 1e50
"""Larger coordinates are refused: squares of areas and volumes would overflow."""

MIN_VOLUME_RATIO = 1e-4
"""Smallest volume of a body over its area times its diagonal: the ratio of a sheet as thick as
0.02 % of the diagonal. A change of less volume, in percent, says nothing."""


@dataclass(frozen=True, eq=False)
class TriMesh:
    """A triangle mesh whose faces turn counter-clockwise seen from outside.

    Attributes
    ----------
    vertices : (n, 3) float64
        Positions, in the units of the file they came from. Finite, no coordinate beyond
        `MAX_COORDINATE`. Read-only.
    faces : (f, 3) int64
        Indices into `vertices`, counted from 0. Read-only.
    attributes : SurfaceAttributes, optional
        The polygons that the triangles are cut from, their UVs and materials; None if there are
        only triangles. The solve does not use them, and exports keep them.

    Raises
    ------
    InputError
        When an array has another shape, a position is not finite or too large, a face names a
        vertex that does not exist, or the attributes are those of another mesh.

    Examples
    --------
    >>> from cageik_cli import TriMesh
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> mesh = TriMesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> mesh
    <TriMesh: 4 vertices, 4 triangles>
    >>> mesh.is_closed, round(mesh.volume, 6)
    (True, 0.166667)
    """

    vertices: Floats
    faces: Integers
    attributes: SurfaceAttributes | None = None

    def __post_init__(self) -> None:
        vertices = make_read_only(validate_positions(self.vertices))
        faces = make_read_only(_validate_faces(self.faces, len(vertices)))
        if self.attributes is not None:
            self.attributes.check_fits(len(vertices), len(faces))
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)

    def __repr__(self) -> str:
        return f"<TriMesh: {len(self.vertices)} vertices, {len(self.faces)} triangles>"

    @cached_property
    def diagonal(self) -> float:
        """Length of the diagonal of the box around the faces, file units."""
        return float(np.linalg.norm(np.ptp(self.vertices[self.used_vertices], axis=0)))

    @cached_property
    def used_vertices(self) -> Integers:
        """Numbers of the vertices that are in a face, (u,), ascending."""
        return np.flatnonzero(self.is_used)

    @cached_property
    def is_used(self) -> NDArray[np.bool_]:
        """Whether each vertex is in a face, (n,); others are no part of the surface."""
        is_used = np.zeros(len(self.vertices), bool)
        is_used[self.faces] = True
        return is_used

    @property
    def unused_vertices(self) -> Integers:
        """Numbers of the vertices that are in no face, ascending."""
        return np.flatnonzero(~self.is_used)

    @cached_property
    def edges(self) -> Edges:
        """The undirected edges of the faces."""
        return Edges.from_faces(self.faces)

    @cached_property
    def is_closed(self) -> bool:
        """Whether the faces use every edge equally often in both directions, so bound a volume."""
        return bool(self.edges.is_balanced.all())

    @cached_property
    def components(self) -> Integers:
        """Number of the connected component of each vertex, (n,); a lone vertex is one."""
        return find_groups(self.edges.ends, len(self.vertices))

    @cached_property
    def volume(self) -> float:
        """Signed volume, cubed file units; positive when the faces turn outward. Closed meshes."""
        return float(signed_volumes(self.vertices[None], self.faces)[0])

    @cached_property
    def face_areas(self) -> Floats:
        """The area of each face, (f,), squared file units."""
        corner = self.vertices[self.faces]
        normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        return np.asarray(np.linalg.norm(normals, axis=1) / 2)

    @cached_property
    def least_volume(self) -> float:
        """Volume up to which a closed mesh is a sheet and no body, cubed file units."""
        return MIN_VOLUME_RATIO * float(self.face_areas.sum()) * self.diagonal

    @cached_property
    def is_body(self) -> bool:
        """Whether the mesh is closed, and its volume more than that of a sheet."""
        return self.is_closed and abs(self.volume) > self.least_volume

    @cached_property
    def polygons(self) -> SurfaceAttributes:
        """The attributes; those of its triangles alone, if it has none."""
        counts = np.full(len(self.faces), 3)
        return self.attributes or SurfaceAttributes(counts, self.faces.ravel())

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays, as a part of a model."""
        return self.vertices.nbytes + self.faces.nbytes + self.polygons.nbytes

    @property
    def shaded(self) -> SurfaceAttributes | None:
        """The attributes, if they say which corners share a normal."""
        return None if self.polygons.normal_fans is None else self.polygons

    @cached_property
    def fan_triangulated(self) -> TriMesh:
        """The mesh with every polygon as a fan: connectivity is compared by it."""
        if self.attributes is None:
            return self
        faces = fan_triangulate(self.attributes.corners, self.attributes.corner_counts)
        return TriMesh(self.vertices, faces, self.attributes)

    @cached_property
    def polygon_sides(self) -> Integers:
        """The sides of the polygons, each once, (e, 2), the smaller vertex number first.

        They are the lines that a person drew: no triangle is cut from another by them.
        """
        corners, counts = self.polygons.corners, self.polygons.corner_counts
        following = np.arange(1, len(corners) + 1)
        following[self.polygons.starts + counts - 1] = self.polygons.starts
        sides = np.sort(np.stack([corners, corners[following]], axis=1), axis=1)
        return np.unique(sides, axis=0)

    def drop_unused_vertices(self) -> TriMesh:
        """Return the mesh without vertices that are in no face; itself if there are none."""
        if self.is_used.all():
            return self
        numbers = np.cumsum(self.is_used) - 1
        return TriMesh(self.vertices[self.used_vertices], numbers[self.faces])

    def flip(self) -> TriMesh:
        """Return the mesh with reversed faces."""
        attributes = None if self.attributes is None else self.attributes.reverse()
        return TriMesh(self.vertices, self.faces[:, ::-1], attributes)

    def move(self, positions: ArrayLike) -> TriMesh:
        """Return the mesh with its vertices at other positions, (n, 3)."""
        return TriMesh(positions, self.faces, self.attributes)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Undirected edges of triangles.

    Attributes
    ----------
    ends : (e, 2) int64
        Vertex numbers, the smaller first. Edges are in the order of their first use by the faces,
        so that sums over edges cancel panel by panel and round little.
    side_edges : (f, 3) int64
        The edge of each face's side; side k is opposite corner k.
    first_side : (e,) int64
        3 face + side of the first side on the edge.
    face_counts : (e,) int64
        Number of faces at the edge.
    is_balanced : (e,) bool
        Whether the faces use the edge equally often in both directions.
    """

    ends: Integers
    side_edges: Integers
    first_side: Integers
    face_counts: Integers
    is_balanced: NDArray[np.bool_]

    @staticmethod
    def from_faces(faces: Integers) -> Edges:
        """Collect the edges of `faces`, (f, 3)."""
        starts, stops = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
        low, high = np.minimum(starts, stops), np.maximum(starts, stops)
        base = int(faces.max(initial=0)) + 1
        keys, first, edge = np.unique(low * base + high, return_index=True, return_inverse=True)
        order = np.argsort(first)
        keys, edge = keys[order], np.argsort(order)[edge]
        turns = np.bincount(edge, weights=np.where(starts < stops, 1.0, -1.0))
        return Edges(
            np.stack([keys // base, keys % base], axis=1),
            edge.reshape(faces.shape),
            first[order],
            np.bincount(edge),
            turns == 0,
        )


def find_groups(pairs: Integers, size: int) -> Integers:
    """Return equal numbers for what `pairs`, (p, 2), tie together, (size,), by first members.

    Every group takes the smallest number that its neighbours have, until none changes; numbers
    that lead to smaller ones are followed at once, so that few rounds are needed.
    """
    lowest = np.arange(size)
    one, two = pairs.T
    while len(one):
        first, second = lowest[one], lowest[two]
        is_apart = first != second
        one, two, first, second = (part[is_apart] for part in (one, two, first, second))
        np.minimum.at(lowest, np.maximum(first, second), np.minimum(first, second))
        while (followed := lowest[lowest]).tobytes() != lowest.tobytes():
            lowest = followed
    return np.unique(lowest, return_inverse=True)[1]


def validate_positions(positions: ArrayLike) -> Floats:
    """Return `positions` as (n, 3) float64."""
    with np.errstate(over="ignore", invalid="ignore"):  # a conversion's overflow is found below
        array = np.asarray(positions, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise FormatError(f"vertices have shape {array.shape}, expected (count, 3)")
    if not np.isfinite(array).all():
        finite = np.isfinite(array).all(axis=1)
        vertex = int(np.argmin(finite))
        x, y, z = array[vertex]
        raise FormatError(
            f"vertex {vertex} is ({x:g}, {y:g}, {z:g}) and {np.count_nonzero(~finite)} of "
            f"{group_digits(len(array))} vertices are not finite; expected finite numbers; "
            "export the file again"
        )
    if max(array.max(), -array.min()) > MAX_COORDINATE:
        vertex = int(np.argmax(np.abs(array).max(axis=1) > MAX_COORDINATE))
        x, y, z = array[vertex]
        raise FormatError(
            f"vertex {vertex} is ({x:g}, {y:g}, {z:g}), expected coordinates of at "
            f"most {MAX_COORDINATE:g}; export the file again, or scale it"
        )
    return array


def validate_known_positions(positions: ArrayLike) -> Floats:
    """Return `positions` as (n, 3) float64; missing ones are nan in all coordinates."""
    array = np.array(positions, dtype=np.float64)
    is_missing = np.isnan(array).any(axis=-1)
    array[is_missing] = 0
    array = validate_positions(array)
    array[is_missing] = np.nan
    return array


def signed_volumes(frames: Floats, faces: Integers) -> Floats:
    """Compute the signed volume of each frame of a closed mesh, by the divergence theorem.

    Parameters
    ----------
    frames : (k, m, 3)
        Positions of k frames, file units.
    faces : (t, 3)
        Outward, counter-clockwise.

    Returns
    -------
    (k,), cubed file units, positive for outward faces. For an open mesh the value would depend on
    the origin and has no meaning.
    """
    volumes = np.empty(len(frames))
    corners = [np.ascontiguousarray(corner) for corner in faces.T]
    reference = faces.min()  # of a face: another vertex may be far away
    # Allocating memory for each frame would cost more than the computation.
    xyz = np.empty((3, frames.shape[1]))
    at, product = np.empty((3, 3, len(faces))), np.empty((2, len(faces)))
    for k, frame in enumerate(frames):
        # Measured from a vertex, a model far from the origin loses no digits.
        np.subtract(frame.T, frame[reference][:, None], out=xyz)
        for corner, place in zip(corners, at, strict=True):
            # The indices are valid, so `clip`, the fastest mode, changes nothing.
            xyz.take(corner, axis=1, out=place, mode="clip")
        (x, y, z), (xb, yb, zb), (xc, yc, zc) = at
        volume = 0.0
        for along, p, q, r, s in ((x, yb, zc, zb, yc), (y, zb, xc, xb, zc), (z, xb, yc, yb, xc)):
            np.multiply(p, q, out=product[0])
            np.multiply(r, s, out=product[1])
            product[0] -= product[1]
            volume += along @ product[0]
        volumes[k] = volume / 6
    return volumes


def _validate_faces(faces: ArrayLike, vertex_count: int) -> Integers:
    array = np.asarray(faces)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise FormatError(f"faces have shape {array.shape}, expected (count, 3) triangles")
    if not np.issubdtype(array.dtype, np.integer):
        raise FormatError(f"faces are {array.dtype} numbers, expected integers")
    array = array.astype(np.int64, copy=False)
    wrong = (array < 0) | (array >= vertex_count)
    if wrong.any():
        face = int(np.argmax(wrong.any(axis=1)))
        raise FormatError(
            f"face {face} names vertices {', '.join(map(str, array[face]))} (counted from 0), "
            f"but there are {group_digits(vertex_count)} vertices; export the mesh again"
        )
    return array


def make_read_only(array: NDArray[Number]) -> NDArray[Number]:
    """Return the array, or a copy, that cannot be written to."""
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array
