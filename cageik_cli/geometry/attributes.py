"""What a mesh file says of a surface beside its triangles: polygons, UVs, normals, materials."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count, group_digits

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

SUBDIVISION_SCHEMES = ("none", "catmullClark", "loop", "bilinear")

PLAIN_COLOUR = (0.8, 0.8, 0.8, 1.0)
"""Red, green, blue and opacity of a material of which nothing is known."""


@dataclass(frozen=True, slots=True)
class Layer:
    """A part of what a file may say of a surface: an attribute of `SurfaceAttributes`.

    Attributes
    ----------
    domain : str
        What has a value. A `vertex` has a row of numbers, a `face` a name (`FaceLabels`), a
        `corner` the number of a row of an `UvMap`, or of its normal.
    width : int
        Numbers of a value, of which vertices may lack the last; 0 for names.
    noun : str
        What a note calls all values, or one name; empty for what it does not mention.
    """

    domain: Literal["corner", "vertex", "face"]
    width: int
    noun: str


def declare_layer(domain: Literal["corner", "vertex", "face"], width: int, noun: str) -> Any:
    """Return a field of `SurfaceAttributes` that is a layer, which a surface may lack."""
    return field(default=None, metadata={"layer": Layer(domain, width, noun)})


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

    def complete(self, value: float = 0.0) -> tuple[Floats, Integers]:
        """Return values and indices of all corners: a last row of `value` for those without one."""
        is_absent = self.indices == NONE
        if not is_absent.any():
            return self.values, self.indices
        values = np.concatenate([self.values, np.full((1, self.values.shape[1]), value)])
        return values, np.where(is_absent, len(self.values), self.indices)


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
    array = array.astype(np.int64, copy=array.flags.writeable)
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
    normal_fans : (c,) int64, optional
        Corners of one number have one normal, which is that of the faces there; `NONE` for a corner
        without. Corners of different vertices have different numbers.
    colours : (n, 3) or (n, 4) float64, optional
        Of the vertices: red, green, blue, and alpha if there is one; 1 is full.
    material_colours : (k, 4) float64, optional
        Linear red, green, blue and opacity of each of the materials' names.
    material_library : str
        The file of the materials, as it is named.
    parts : Parts, optional
        The meshes that it was joined from; None for a mesh that came as one.

    Raises
    ------
    FormatError
        When the parts do not agree.
    """

    corner_counts: Integers
    corners: Integers
    uvs: UvMap | None = declare_layer("corner", 2, "texture coordinates")
    normal_fans: Integers | None = declare_layer("corner", 3, "normals")
    colours: Floats | None = declare_layer("vertex", 4, "colours")
    materials: FaceLabels | None = declare_layer("face", 0, "material")
    groups: FaceLabels | None = declare_layer("face", 0, "group")
    objects: FaceLabels | None = declare_layer("face", 0, "object")
    smoothing: FaceLabels | None = declare_layer("face", 0, "")
    material_colours: Floats | None = None
    material_library: str = ""
    subdivision: Subdivision = field(default_factory=Subdivision)
    parts: Parts | None = None

    def __post_init__(self) -> None:
        for name, lowest in (("corner_counts", 3), ("corners", 0)):
            array = freeze_indices(name, getattr(self, name), lowest, None)
            object.__setattr__(self, name, array)
        count, total = len(self.corners), int(self.corner_counts.sum())
        if total != count:
            raise FormatError(f"polygons of {total} corners name {group_digits(count)} vertices")
        for name, layer in LAYERS.items():
            held = getattr(self, name)
            if isinstance(held, UvMap):
                _check_length("UV indices", len(held.indices), "corners", count)
            elif isinstance(held, FaceLabels):
                _check_length(name, len(held.indices), "faces", len(self.corner_counts))
            elif held is not None and layer.domain == "vertex":
                width = np.shape(held)[-1] if np.ndim(held) else 0
                least = layer.width if width == layer.width else layer.width - 1
                object.__setattr__(self, name, freeze_values(layer.noun, held, least))
        if self.normal_fans is not None:
            fans = freeze_indices("normals", self.normal_fans, NONE, count)
            _check_length("normals", len(fans), "corners", count)
            object.__setattr__(self, "normal_fans", fans)
            _check_fans(fans, self.corners)
        if self.material_colours is not None:
            colours = freeze_values("colours of materials", self.material_colours, 4)
            names = () if self.materials is None else self.materials.names
            _check_length("colours of materials", len(colours), "materials", len(names))
            object.__setattr__(self, "material_colours", colours)
        count = 0 if self.parts is None else len(self.parts.names)
        if self.subdivision.part_schemes and len(self.subdivision.part_schemes) != count:
            raise FormatError(f"{len(self.subdivision.part_schemes)} schemes of {count} parts")
        if self.parts is not None:
            total = int(self.parts.polygon_counts.sum())
            _check_length("polygons of parts", total, "polygons", len(self.corner_counts))
        if len(self.material_library) > MAX_NAME_LENGTH or not self.material_library.isprintable():
            raise FormatError("the name of the material library is no line that can be printed")

    @property
    def is_plain(self) -> bool:
        """Whether it is triangles and nothing else."""
        return (
            bool((self.corner_counts == 3).all())
            and all(getattr(self, name) is None for name in (*LAYERS, "parts"))
            and not self.material_library
            and self.subdivision.scheme == "none"
        )

    @property
    def nbytes(self) -> int:
        """Bytes of the polygons and of their layers."""
        size = self.corner_counts.nbytes + self.corners.nbytes
        for held in (getattr(self, name) for name in LAYERS):
            if isinstance(held, UvMap):
                size += held.values.nbytes
            if held is not None:
                size += (held.indices if isinstance(held, UvMap | FaceLabels) else held).nbytes
        return size

    @property
    def description(self) -> str:
        """What there is, for people."""
        layers = ((layer.noun, getattr(self, name)) for name, layer in LAYERS.items())
        parts = [
            format_count(len(held.names), noun) if isinstance(held, FaceLabels | Parts) else noun
            for noun, held in (*layers, ("part", self.parts))
            if noun and held is not None
        ]
        if self.subdivision.scheme != "none":
            parts.append(f"scheme {self.subdivision.scheme}")
        given = ", ".join(parts)
        count = format_count(len(self.corner_counts), "polygon")
        return f"{count} with {given}" if given else count

    @property
    def starts(self) -> Integers:
        """The first corner of each polygon, (p,)."""
        return np.asarray(np.cumsum(self.corner_counts) - self.corner_counts)

    @property
    def corner_polygons(self) -> Integers:
        """The polygon of each corner, (c,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts)

    @property
    def triangle_polygons(self) -> Integers:
        """The polygon of each triangle of the mesh, (t,)."""
        return np.repeat(np.arange(len(self.corner_counts)), self.corner_counts - 2)

    def check_fits(self, vertex_count: int, triangle_count: int) -> None:
        """Refuse attributes that are not of a mesh with these counts."""
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
        for name, layer in LAYERS.items():
            if layer.domain == "vertex" and getattr(self, name) is not None:
                _check_length(layer.noun, len(getattr(self, name)), "vertices", vertex_count)
        if self.parts is not None:
            total = int(self.parts.vertex_counts.sum())
            _check_length("vertices of parts", total, "vertices", vertex_count)
            numbers = np.arange(len(self.parts.names), dtype=np.int32)
            owners = np.repeat(numbers, self.parts.vertex_counts)
            corners = [int(self.corner_counts[k].sum()) for k in self.parts.polygon_slices]
            if (owners[self.corners] != np.repeat(numbers, corners)).any():
                raise FormatError("a face of one part has a vertex of another")

    def check_cut(self, faces: Integers) -> None:
        """Refuse triangles (t, 3) that are not cut from the polygons."""
        size = int(max(self.corners.max(initial=0), faces.max(initial=0))) + 1
        triangles = self.triangle_polygons[:, None] * size + faces
        is_own = np.isin(triangles, self.corner_polygons * size + self.corners).all(axis=1)
        if not is_own.all():
            raise FormatError(
                f"triangle {int(np.argmin(is_own))} has vertices that are not of its polygon"
            )

    def add_layer(
        self, name: str, values: Floats, indices: Integers | None = None
    ) -> "SurfaceAttributes":
        """Return it with a layer of numbers, (k, width), as files have them.

        `indices`, (c,), are the row of each corner; those of normals are shared where they are
        equal when rounded, as many programs write the same normal for each corner anew.
        """
        held: dict[str, Any] = {name: values}
        if LAYERS[name].domain == "vertex":
            return replace(self, **held)
        assert indices is not None
        if name != "normal_fans":
            held[name] = UvMap(values, indices)
            return replace(self, **held)
        indices = freeze_indices("normals", indices, NONE, len(values))
        decimals = 4  # of unit normals: as many as text formats usually write
        with np.errstate(over="ignore", invalid="ignore"):
            rounded = values.round(decimals)
        same = np.unique(rounded, axis=0, return_inverse=True)[1].ravel()
        shared = np.array([*same, NONE])[indices]
        return replace(self, normal_fans=number_normal_fans(self.corners, shared))

    def reverse(self, keeps_first: bool = True) -> "SurfaceAttributes":
        """Return them for faces that turn the other way.

        Polygons begin at the same corner, or at what was their last.
        """
        steps = np.arange(len(self.corners)) - np.repeat(self.starts, self.corner_counts)
        counts, starts = (
            np.repeat(a, self.corner_counts) for a in (self.corner_counts, self.starts)
        )
        order = starts + (counts - steps - (not keeps_first)) % counts
        turned: dict[str, Any] = {"corners": self.corners[order]}
        for name in LAYERS:
            held = getattr(self, name)
            if isinstance(held, UvMap):
                turned[name] = replace(held, indices=held.indices[order])
        if self.normal_fans is not None:
            fans = self.normal_fans[order]
            turned["normal_fans"] = number_normal_fans(turned["corners"], fans)
        return replace(self, **turned)


LAYERS: dict[str, Layer] = {
    each.name: each.metadata["layer"]
    for each in fields(SurfaceAttributes)
    if "layer" in each.metadata
}
"""The layers of a surface, by name. The table of each format says where it keeps them."""

LABEL_NAMES = tuple(name for name, layer in LAYERS.items() if layer.domain == "face")
"""The layers that are labels of faces."""


def check_corner_counts(corner_counts: Integers) -> None:
    """Refuse polygons of fewer than three corners."""
    small = np.flatnonzero(corner_counts < 3)
    if len(small):
        raise FormatError(
            f"face {small[0]} has {corner_counts[small[0]]} corners, expected 3 or more; "
            "export it again"
        )


def fan_triangulate(corners: Integers, corner_counts: Integers) -> Integers:
    """Cut polygons into fans, (f, 3); their `corners` follow one another, `corner_counts` each."""
    check_corner_counts(corner_counts)
    counts = corner_counts - 2
    first = np.repeat(np.cumsum(corner_counts) - corner_counts, counts)
    place = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.asarray(corners[np.stack([first, first + place + 1, first + place + 2], axis=1)])


def find_folded_triangles(
    vertices: Floats, faces: Integers, counts: Integers
) -> tuple[Mask, Floats]:
    """Find the triangles of fans that are turned against their polygon: it folds over there.

    `counts` says how many triangles each polygon has, (p,). Which are turned is (f,); beside it is
    twice the area vector of each polygon, (p, 3).
    """
    starts = np.cumsum(counts) - counts
    a, b, c = (vertices[corner] for corner in faces.T)
    areas = np.cross(b - a, c - a)
    whole = np.add.reduceat(areas, starts)
    turned = np.einsum("fx,fx->f", areas, np.repeat(whole, counts, axis=0))
    # What is turned by less than this share of the polygon's area is rounding.
    allowed = -1e-9 * np.einsum("px,px->p", whole, whole)
    return np.asarray(turned < np.repeat(allowed, counts)), whole


def number_normal_fans(corners: Integers, normals: Integers) -> Integers:
    """Number the normals of corners, so that corners of one vertex and one normal have one number.

    `normals` has some number of the normal of each of the `corners`, (c,), below zero for none. The
    new numbers, (c,), are in the order of the corners; `NONE` for a corner without a normal.
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


def make_part_transform(matrix: Floats) -> Floats:
    """Return the transform (4, 4) of a part; none if points cannot be moved back from it."""
    is_affine = matrix[:, 3].tolist() == [0, 0, 0, 1] or np.allclose(matrix[:, 3], [0, 0, 0, 1])
    if not is_affine or not np.isfinite(matrix).all():
        return np.eye(4)
    affine = matrix.copy()
    affine[:, 3] = [0, 0, 0, 1]
    return affine if is_invertible(affine[None])[0] else np.eye(4)
