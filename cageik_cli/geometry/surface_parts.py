"""The parts of what a file says of a surface: UVs, names of faces, subdivision."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FormatError

MAX_NAMES = 100_000
"""Names of materials, groups, objects or smoothing groups of a mesh."""

MAX_NAME_LENGTH = 1024
"""Characters of such a name."""

MAX_VALUE = 1e9
"""Larger texture coordinates, colours and sharpnesses are refused."""

MIN_TRANSFORM_VOLUME = 1e-9
"""A transform below this share of the volume of a box of its rows flattens what it moves."""

NONE = -1
"""The index of a corner or a face that has no value."""

PLAIN_COLOUR = (0.8, 0.8, 0.8, 1.0)
"""Red, green, blue and opacity of a material of which nothing is known."""

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
    """

    values: Floats
    indices: Integers

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", freeze_values("UVs", self.values, 2))
        indices = freeze_indices("UV indices", self.indices, NONE, len(self.values))
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
    """

    names: tuple[str, ...]
    indices: Integers

    def __post_init__(self) -> None:
        check_names(self.names, "faces")
        indices = freeze_indices("face names", self.indices, NONE, len(self.names))
        object.__setattr__(self, "indices", indices)

    @staticmethod
    def from_members(
        count: int, members: Iterable[tuple[str, Integers | slice]]
    ) -> "FaceLabels | None":
        """Label `count` faces by the last name that has them among its own; None if none has.

        Names are in the order in which the faces use them.
        """
        numbers: dict[str, int] = {}
        labels = np.full(count, NONE)
        for name, faces in members:
            labels[faces] = numbers.setdefault(name, len(numbers))
        used, first = np.unique(labels, return_index=True)
        used = used[np.argsort(first)]
        used = used[used != NONE]
        if not len(used):
            return None
        places = np.full(len(numbers) + 1, NONE)  # `NONE` is the last
        places[used] = np.arange(len(used))
        names = list(numbers)
        return FaceLabels(tuple(names[k] for k in used.tolist()), places[labels])

    def list_members(self) -> Iterator[tuple[str, Integers]]:
        """Yield each name that is used, with the numbers of its polygons."""
        order = np.argsort(self.indices, kind="stable")
        bounds = np.searchsorted(self.indices[order], np.arange(len(self.names) + 1))
        for k, name in enumerate(self.names):
            if bounds[k] < bounds[k + 1]:
                yield name, order[bounds[k] : bounds[k + 1]]


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """The meshes that one mesh was joined from, in the order of its vertices and polygons.

    Attributes
    ----------
    names : tuple of str
        All different: names, or paths in a scene such as `/hero/geo/body`.
    vertex_counts, polygon_counts : (k,) int64
    transforms : (k, 4, 4) float64
        Of each part at rest: rows of its own space times it are in the space of the scene.

    Raises
    ------
    FormatError
        When they do not agree, a name cannot be printed, or a transform cannot be inverted.
    """

    names: tuple[str, ...]
    vertex_counts: Integers
    polygon_counts: Integers
    transforms: Floats

    def __post_init__(self) -> None:
        check_names(self.names, "parts")
        for name in ("vertex_counts", "polygon_counts"):
            counts = freeze_indices(name, getattr(self, name), 1, None)
            object.__setattr__(self, name, counts)
        values = freeze_values("transforms of parts", np.reshape(self.transforms, (-1,)), None)
        lengths = {len(self.names), len(self.vertex_counts), len(self.polygon_counts)}
        if lengths != {len(values) // 16} or len(values) % 16:
            raise FormatError("the parts have other counts than names or transforms")
        transforms = values.reshape(-1, 4, 4)
        if not is_invertible(transforms).all():
            raise FormatError("the transform of a part cannot be inverted")
        object.__setattr__(self, "transforms", transforms)

    @property
    def vertex_slices(self) -> list[slice]:
        """The vertices of each part."""
        return _make_slices(self.vertex_counts)

    @property
    def polygon_slices(self) -> list[slice]:
        """The polygons of each part."""
        return _make_slices(self.polygon_counts)


def _make_slices(counts: Integers) -> list[slice]:
    stops = np.cumsum(counts).tolist()
    return [slice(start, stop) for start, stop in zip([0, *stops], stops, strict=False)]


def is_invertible(matrices: Floats) -> Mask:
    """Return which transforms (k, 4, 4) of rows move points without flattening them, (k,)."""
    columns = np.linalg.norm(matrices[:, :3, :3], axis=2)
    volumes = np.abs(np.linalg.det(matrices[:, :3, :3]))
    is_affine = (matrices[:, :, 3] == [0, 0, 0, 1]).all(axis=1)
    return np.asarray(is_affine & (volumes > MIN_TRANSFORM_VOLUME * columns.prod(axis=1)))


def make_part_transform(matrix: Floats) -> Floats:
    """Return the transform (4, 4) of a part; none if points cannot be moved back from it."""
    if not np.allclose(matrix[:, 3], [0, 0, 0, 1]) or not np.isfinite(matrix).all():
        return np.eye(4)
    affine = matrix.copy()
    affine[:, 3] = [0, 0, 0, 1]
    return affine if is_invertible(affine[None])[0] else np.eye(4)


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
    part_schemes : tuple of str
        The scheme of each part, where they differ; `scheme` is "none" then.

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
    part_schemes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for scheme in (self.scheme, *self.part_schemes):
            if scheme not in SUBDIVISION_SCHEMES:
                raise FormatError(
                    f"the subdivision scheme is `{scheme}`, expected one of "
                    f"{', '.join(SUBDIVISION_SCHEMES)}"
                )
        for name in ("crease_vertices", "crease_lengths", "corner_vertices"):
            lowest = 2 if name == "crease_lengths" else 0
            array = freeze_indices(name, getattr(self, name), lowest, None)
            object.__setattr__(self, name, array)
        for name in ("crease_sharpness", "corner_sharpness"):
            object.__setattr__(self, name, freeze_values(name, getattr(self, name), None))
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


def check_names(names: tuple[str, ...], noun: str) -> None:
    """Refuse names of faces or parts, the `noun`, that are too many, alike or not one line.

    Raises
    ------
    FormatError
    """
    if len(names) > MAX_NAMES:
        raise FormatError(f"{len(names)} names of {noun}, expected at most {MAX_NAMES}")
    for name in names:
        if not 0 < len(name) <= MAX_NAME_LENGTH or not name.isprintable():
            raise FormatError(
                f"a name of {noun} has {len(name)} characters, expected 1 to {MAX_NAME_LENGTH} "
                "on one line, which can be printed"
            )
    if len(set(names)) < len(names):
        raise FormatError(f"a name of {noun} is there twice")


def freeze_indices(noun: str, values: ArrayLike, lowest: int, count: int | None) -> Integers:
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


def freeze_values(noun: str, values: ArrayLike, width: int | None) -> Floats:
    """Return finite numbers (k,) or (k, width), read-only."""
    with np.errstate(over="ignore", invalid="ignore"):
        array = np.array(values, np.float64)
    if array.ndim != (1 if width is None else 2) or (width is not None and array.shape[1] != width):
        raise FormatError(f"{noun} have shape {array.shape}")
    if not (np.abs(array) <= MAX_VALUE).all():
        raise FormatError(f"{noun} are not finite, or beyond {MAX_VALUE:g}")
    array.flags.writeable = False
    return array
