"""What a mesh file says of a surface beside its triangles: polygons, UVs, normals, materials."""

from dataclasses import dataclass, field, replace

import numpy as np

from cageik_cli.geometry.surface_parts import (
    MAX_NAME_LENGTH,
    NONE,
    FaceLabels,
    Parts,
    Subdivision,
    UvMap,
    freeze_indices,
    freeze_values,
)
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import FormatError
from cageik_cli.util.text import format_count


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
    uvs: UvMap | None = None
    normal_fans: Integers | None = None
    colours: Floats | None = None
    materials: FaceLabels | None = None
    groups: FaceLabels | None = None
    objects: FaceLabels | None = None
    smoothing: FaceLabels | None = None
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
            raise FormatError(f"polygons of {total} corners name {count} vertices")
        if self.uvs is not None:
            _check_length("UV indices", len(self.uvs.indices), "corners", count)
        if self.normal_fans is not None:
            fans = freeze_indices("normals", self.normal_fans, NONE, count)
            _check_length("normals", len(fans), "corners", count)
            object.__setattr__(self, "normal_fans", fans)
            _check_fans(fans, self.corners)
        for name in LABEL_NAMES:
            labels = getattr(self, name)
            if labels is not None:
                _check_length(name, len(labels.indices), "faces", len(self.corner_counts))
        if self.colours is not None:
            width = np.shape(self.colours)[-1] if np.ndim(self.colours) else 0
            colours = freeze_values("colours", self.colours, 4 if width == 4 else 3)
            object.__setattr__(self, "colours", colours)
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
        given = (self.uvs, self.normal_fans, self.colours, self.parts)
        return (
            bool((self.corner_counts == 3).all())
            and all(part is None for part in given)
            and all(getattr(self, name) is None for name in LABEL_NAMES)
            and not self.material_library
            and self.subdivision.scheme == "none"
        )

    @property
    def description(self) -> str:
        """What there is, for people."""
        labels = ((getattr(self, name), name.removesuffix("s")) for name in LABEL_NAMES[:3])
        parts = [
            "texture coordinates" if self.uvs is not None else "",
            "normals" if self.normal_fans is not None else "",
            "colours" if self.colours is not None else "",
            *(format_count(len(held.names), noun) if held else "" for held, noun in labels),
            format_count(len(self.parts.names), "part") if self.parts else "",
            f"scheme {self.subdivision.scheme}" if self.subdivision.scheme != "none" else "",
        ]
        given = ", ".join(part for part in parts if part)
        count = format_count(len(self.corner_counts), "polygon")
        return f"{count} with {given}" if given else count

    @property
    def starts(self) -> Integers:
        """The first corner of each polygon, (p,)."""
        return np.asarray(np.cumsum(self.corner_counts) - self.corner_counts)

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
        if self.colours is not None:
            _check_length("colours", len(self.colours), "vertices", vertex_count)
        if self.parts is not None:
            total = int(self.parts.vertex_counts.sum())
            _check_length("vertices of parts", total, "vertices", vertex_count)
            owners = np.repeat(np.arange(len(self.parts.names)), self.parts.vertex_counts)
            corners = [int(self.corner_counts[k].sum()) for k in self.parts.polygon_slices]
            if (owners[self.corners] != np.repeat(np.arange(len(corners)), corners)).any():
                raise FormatError("a face of one part has a vertex of another")

    def check_cut(self, faces: Integers) -> None:
        """Refuse triangles (t, 3) that are not cut from the polygons."""
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
