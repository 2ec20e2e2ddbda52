"""What a mesh file says of a surface beside its triangles: polygons, UVs, normals, materials."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

MAX_NAMES = 100_000
"""Names of materials, groups, objects or smoothing groups of a mesh."""

MAX_NAME_LENGTH = 1024
"""Characters of such a name."""

MAX_VALUE = 1e9
"""Larger texture coordinates, colours and sharpnesses are refused."""

NONE = -1
"""The index of a corner or a face that has no value."""

SUBDIVISION_SCHEMES = ("none", "catmullClark", "loop", "bilinear")


def _no_indices() -> Integers:
    return np.empty(0, np.int64)


def _no_values() -> Floats:
    return np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class UvMap:
    """Texture coordinates with indices of their own.

    Attributes
    ----------
    values : (u, 2) float64
    indices : (c,) int64
        The value of each corner; `NONE` for one that has none.

    Raises
    ------
    FormatError
        When an array has another shape, or a value is not finite.
    """

    values: Floats
    indices: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", _freeze_values("UVs", self.values, 2))
        indices = _freeze_indices("UV indices", self.indices, NONE, len(self.values))
        object.__setattr__(self, "indices", indices)


@dataclass(frozen=True, slots=True, eq=False)
class FaceLabels:
    """A name for each face: its material, say.

    Attributes
    ----------
    names : tuple of str
        All different.
    indices : (p,) int64
        The name of each polygon; `NONE` for one that has none.

    Raises
    ------
    FormatError
        When there are too many names, one is empty, too long or of several lines, or an index is
        that of none of them.
    """

    names: tuple[str, ...]
    indices: Integers

    def __post_init__(self) -> None:
        if len(self.names) > MAX_NAMES:
            raise FormatError(f"{len(self.names)} names of faces, expected at most {MAX_NAMES}")
        for name in self.names:
            if not 0 < len(name) <= MAX_NAME_LENGTH or not name.isprintable():
                raise FormatError(
                    f"a name of faces has {len(name)} characters, expected 1 to {MAX_NAME_LENGTH} "
                    "on one line, which can be printed"
                )
        if len(set(self.names)) < len(self.names):
            raise FormatError("a name of faces is there twice")
        indices = _freeze_indices("face names", self.indices, NONE, len(self.names))
        object.__setattr__(self, "indices", indices)

    @staticmethod
    def from_texts(texts: list[str]) -> "FaceLabels | None":
        """Label faces by a text each, empty for none; None if no face has one."""
        names = dict.fromkeys(text for text in texts if text)
        numbers = {name: k for k, name in enumerate(names)} | {"": NONE}
        indices = np.array([numbers[text] for text in texts], np.int64)
        return FaceLabels(tuple(names), indices) if names else None

    def list_members(self) -> Iterator[tuple[str, Integers]]:
        """Yield each name that is used, with the numbers of its polygons."""
        order = np.argsort(self.indices, kind="stable")
        bounds = np.searchsorted(self.indices[order], np.arange(len(self.names) + 1))
        for k, name in enumerate(self.names):
            if bounds[k] < bounds[k + 1]:
                yield name, order[bounds[k] : bounds[k + 1]]


@dataclass(frozen=True, slots=True, eq=False)
class Subdivision:
    """How a renderer is to subdivide the mesh, in the words of USD.

    Attributes
    ----------
    scheme : str
        One of `SUBDIVISION_SCHEMES`.
    crease_vertices, crease_lengths : (k,), (e,) int64
        The vertices of the creases, one crease after the other, and how many each has.
    crease_sharpness : (e,) or (k - e,) float64
        Of each crease, or of each of their edges.
    corner_vertices, corner_sharpness : (s,) int64, (s,) float64
        Vertices that stay sharp.

    Raises
    ------
    FormatError
        When the parts do not agree.
    """

    scheme: str = "none"
    crease_vertices: Integers = field(default_factory=_no_indices)
    crease_lengths: Integers = field(default_factory=_no_indices)
    crease_sharpness: Floats = field(default_factory=_no_values)
    corner_vertices: Integers = field(default_factory=_no_indices)
    corner_sharpness: Floats = field(default_factory=_no_values)

    def __post_init__(self) -> None:
        if self.scheme not in SUBDIVISION_SCHEMES:
            raise FormatError(
                f"the subdivision scheme is `{self.scheme}`, expected one of "
                f"{', '.join(SUBDIVISION_SCHEMES)}"
            )
        for name in ("crease_vertices", "crease_lengths", "corner_vertices"):
            lowest = 2 if name == "crease_lengths" else 0
            array = _freeze_indices(name, getattr(self, name), lowest, None)
            object.__setattr__(self, name, array)
        for name in ("crease_sharpness", "corner_sharpness"):
            object.__setattr__(self, name, _freeze_values(name, getattr(self, name), None))
        creases, ends = len(self.crease_lengths), len(self.crease_vertices)
        if int(self.crease_lengths.sum()) != ends:
            raise FormatError(f"creases of {self.crease_lengths.sum()} vertices name {ends}")
        if len(self.crease_sharpness) not in (creases, ends - creases):
            raise FormatError(
                f"{creases} creases have {len(self.crease_sharpness)} values of sharpness"
            )
        if len(self.corner_vertices) != len(self.corner_sharpness):
            raise FormatError(
                f"{len(self.corner_vertices)} sharp vertices have {len(self.corner_sharpness)} "
                "values of sharpness"
            )


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceAttributes:
    """The polygons of a mesh and all that a file says of them; the solve uses its triangles.

    Polygon k gives the next `corner_counts[k] - 2` triangles of the mesh.

    Attributes
    ----------
    corner_counts : (p,) int64
        How many corners each polygon has.
    corners : (c,) int64
        The vertices of the polygons, one polygon after the other.
    uvs : UvMap, optional
    normal_fans : (c,) int64, optional
        Corners of one number have one normal, which is that of the faces there; `NONE` for a corner
        without. Corners of different vertices have different numbers.
    colours : (n, 3) or (n, 4) float64, optional
        Of the vertices: red, green, blue, and alpha if there is one; 1 is full.
    materials, groups, objects, smoothing : FaceLabels, optional
    material_library : str
        The file of the materials, as it is named.
    subdivision : Subdivision

    Raises
    ------
    FormatError
        When the parts do not agree.
    """

    corner_counts: Integers
    corners: Integers
    uvs: UvMap | None = None
    normal_fans: Integers | None = None
    colours: Floats | None = None
    materials: FaceLabels | None = None
    groups: FaceLabels | None = None
    objects: FaceLabels | None = None
    smoothing: FaceLabels | None = None
    material_library: str = ""
    subdivision: Subdivision = field(default_factory=Subdivision)

    def __post_init__(self) -> None:
        for name, lowest in (("corner_counts", 3), ("corners", 0)):
            array = _freeze_indices(name, getattr(self, name), lowest, None)
            object.__setattr__(self, name, array)
        count, total = len(self.corners), int(self.corner_counts.sum())
        if total != count:
            raise FormatError(f"polygons of {total} corners name {count} vertices")
        if self.uvs is not None:
            _check_length("UV indices", len(self.uvs.indices), "corners", count)
        if self.normal_fans is not None:
            fans = _freeze_indices("normals", self.normal_fans, NONE, count)
            _check_length("normals", len(fans), "corners", count)
            object.__setattr__(self, "normal_fans", fans)
            _check_fans(fans, self.corners)
        for name in LABEL_NAMES:
            labels = getattr(self, name)
            if labels is not None:
                _check_length(name, len(labels.indices), "faces", len(self.corner_counts))
        if self.colours is not None:
            width = np.shape(self.colours)[-1] if np.ndim(self.colours) else 0
            colours = _freeze_values("colours", self.colours, 4 if width == 4 else 3)
            object.__setattr__(self, "colours", colours)
        if len(self.material_library) > MAX_NAME_LENGTH or not self.material_library.isprintable():
            raise FormatError("the name of the material library is no line that can be printed")

    @property
    def is_plain(self) -> bool:
        """Whether it is triangles and nothing else."""
        given = (self.uvs, self.normal_fans, self.colours)
        return (
            bool((self.corner_counts == 3).all())
            and all(part is None for part in given)
            and all(getattr(self, name) is None for name in LABEL_NAMES)
            and not self.material_library
            and self.subdivision.scheme == "none"
        )

    @property
    def starts(self) -> Integers:
        """The first corner of each polygon, (p,)."""
        return np.asarray(np.cumsum(self.corner_counts) - self.corner_counts)

    @property
    def triangle_polygons(self) -> Integers:
        """The polygon of each triangle of the mesh, (t,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts - 2)

    def check_fits(self, vertex_count: int, triangle_count: int) -> None:
        """Refuse attributes that are not of a mesh with these counts.

        Raises
        ------
        FormatError
        """
        named = (self.corners, self.subdivision.crease_vertices, self.subdivision.corner_vertices)
        last = max(int(vertices.max(initial=-1)) for vertices in named)
        if last >= vertex_count:
            raise FormatError(
                f"polygons name vertex {last} (counted from 0), but there are {vertex_count} "
                "vertices; export the mesh again"
            )
        _check_length(
            "triangles",
            triangle_count,
            "triangles of polygons",
            int((self.corner_counts - 2).sum()),
        )
        if self.colours is not None:
            _check_length("colours", len(self.colours), "vertices", vertex_count)

    def check_cut(self, faces: Integers) -> None:
        """Refuse triangles (t, 3) that are not cut from the polygons.

        Raises
        ------
        FormatError
        """
        size = int(max(self.corners.max(initial=0), faces.max(initial=0))) + 1
        polygons = np.repeat(np.arange(len(self.corner_counts)), self.corner_counts)
        triangles = self.triangle_polygons[:, None] * size + faces
        is_own = np.isin(triangles, polygons * size + self.corners).all(axis=1)
        if not is_own.all():
            raise FormatError(
                f"triangle {int(np.argmin(is_own))} has vertices that are not of its polygon"
            )

    def reverse(self, keeps_first: bool = True) -> "SurfaceAttributes":
        """Return them for faces that turn the other way.

        Polygons begin at the same corner, or at what was their last.
        """
        steps = np.arange(len(self.corners)) - np.repeat(self.starts, self.corner_counts)
        counts, starts = (
            np.repeat(a, self.corner_counts) for a in (self.corner_counts, self.starts)
        )
        return self._reorder_corners(starts + (counts - steps - (not keeps_first)) % counts)

    def _reorder_corners(self, order: Integers) -> "SurfaceAttributes":
        """Return them with the corners in another order within their polygons."""
        corners, uvs, fans = self.corners[order], self.uvs, self.normal_fans
        return replace(
            self,
            corners=corners,
            uvs=None if uvs is None else replace(uvs, indices=uvs.indices[order]),
            normal_fans=None if fans is None else number_normal_fans(corners, fans[order]),
        )


LABEL_NAMES = ("materials", "groups", "objects", "smoothing")
"""The attributes that are labels of faces."""


def fan_triangulate(corners: Integers, corner_counts: Integers) -> Integers:
    """Cut polygons into fans, (f, 3); their `corners` follow one another, `corner_counts` each.

    Raises
    ------
    InputError
        Naming a polygon of fewer than three corners.
    """
    small = np.flatnonzero(corner_counts < 3)
    if len(small):
        raise FormatError(
            f"face {small[0]} has {corner_counts[small[0]]} corners, expected 3 or more; "
            "export it again"
        )
    counts = corner_counts - 2
    first = np.repeat(np.cumsum(corner_counts) - corner_counts, counts)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.asarray(corners[np.stack([first, first + place + 1, first + place + 2], axis=1)])


def number_normal_fans(corners: Integers, normals: Integers) -> Integers:
    """Number the normals of corners, so that corners of one vertex and one normal have one number.

    Parameters
    ----------
    corners : (c,)
    normals : (c,)
        Some number of the normal of each corner; below zero for none.

    Returns
    -------
    (c,), in the order of the corners; `NONE` for a corner without a normal.
    """
    is_given = normals >= 0
    pairs = np.stack([corners, normals], axis=1)[is_given]
    fans = np.full(len(corners), NONE, np.int64)
    if len(pairs):
        keys = pairs[:, 0] * (int(pairs[:, 1].max()) + 1) + pairs[:, 1]
        _, first, number = np.unique(keys, return_index=True, return_inverse=True)
        fans[is_given] = np.argsort(np.argsort(first))[number]
    return fans


def _check_length(noun: str, found: int, of: str, expected: int) -> None:
    if found != expected:
        raise FormatError(f"{found} {noun}, expected {expected}, the number of {of}")


def _check_fans(fans: Integers, corners: Integers) -> None:
    """Refuse one normal at several vertices."""
    owner = np.full(int(fans.max(initial=-1)) + 1, -1, np.int64)
    given = fans >= 0
    owner[fans[given]] = corners[given]
    if (owner[fans[given]] != corners[given]).any():
        raise FormatError("a normal is shared by corners of several vertices")


def _freeze_indices(noun: str, values: ArrayLike, lowest: int, count: int | None) -> Integers:
    """Return whole numbers (k,) from `lowest` to below `count`, read-only."""
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and not np.issubdtype(array.dtype, np.integer)):
        raise FormatError(
            f"{noun} are {array.dtype} of shape {array.shape}, expected a list of whole numbers"
        )
    array = array.astype(np.int64)
    if array.size and (array.min() < lowest or (count is not None and array.max() >= count)):
        most = "" if count is None else f" to {count - 1}"
        raise FormatError(
            f"{noun} are {array.min()} to {array.max()}, expected {lowest}{most or ' or more'}"
        )
    array.flags.writeable = False
    return array


def _freeze_values(noun: str, values: ArrayLike, width: int | None) -> Floats:
    """Return finite numbers (k,) or (k, width), read-only."""
    with np.errstate(over="ignore", invalid="ignore"):
        array = np.array(values, np.float64)
    if array.ndim != (1 if width is None else 2) or (width is not None and array.shape[1] != width):
        raise FormatError(f"{noun} have shape {array.shape}")
    if not (np.abs(array) <= MAX_VALUE).all():
        raise FormatError(f"{noun} are not finite, or beyond {MAX_VALUE:g}")
    array.flags.writeable = False
    return array
