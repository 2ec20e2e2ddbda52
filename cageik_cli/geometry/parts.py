"""Models of several meshes: joined into one mesh for the solve, and split again for outputs.

Messages name the part that a vertex is in, and count the vertices of each part.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from cageik_cli.geometry.attributes import (
    LABEL_NAMES,
    NONE,
    PLAIN_COLOUR,
    FaceLabels,
    Parts,
    Subdivision,
    SurfaceAttributes,
    UvMap,
    number_normal_fans,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.text import number_names

MAX_PARTS_NAMED = 4
"""Parts that a sentence names; the others are counted."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One of the meshes that a model was joined from.

    Attributes
    ----------
    name : str
        Its name, or its path in a scene; empty for a model that came as one mesh.
    mesh : TriMesh
        In the space of the scene.
    vertices : slice
        Of the model.
    transform : (4, 4) float64
        Rows of its own space times it are in the space of the scene.
    """

    name: str
    mesh: TriMesh
    vertices: slice
    transform: Floats

    @property
    def own_mesh(self) -> TriMesh:
        """The mesh with its faces as they turn in its own space, where a mirror turns them."""
        if np.linalg.det(self.transform[:3, :3]) > 0:
            return self.mesh
        turned = self.mesh.polygons.reverse(keeps_first=False)
        return TriMesh(self.mesh.vertices, self.mesh.faces[:, ::-1], turned)

    def select(self, positions: Floats) -> Floats:
        """Return its positions (..., k, 3) in its own space, of those of the model (..., m, 3)."""
        own = positions[..., self.vertices, :]
        if np.array_equal(self.transform, np.eye(4)):
            return own
        inverse = np.linalg.inv(self.transform)
        return np.asarray(own @ inverse[:3, :3] + inverse[3, :3])


def split_parts(mesh: TriMesh) -> list[Part]:
    """Split a mesh into the parts that it was joined from: itself alone if it came as one."""
    attributes = mesh.attributes
    if attributes is None or attributes.parts is None:
        return [Part("", mesh, slice(0, len(mesh.vertices)), np.eye(4))]
    parts = attributes.parts
    triangle_stops = np.cumsum(attributes.corner_counts - 2)
    found = []
    for k, (vertices, polygons) in enumerate(
        zip(parts.vertex_slices, parts.polygon_slices, strict=True)
    ):
        first = int(triangle_stops[polygons.start - 1]) if polygons.start else 0
        faces = mesh.faces[first : int(triangle_stops[polygons.stop - 1])] - vertices.start
        own = _select_attributes(attributes, vertices, polygons, k)
        part = TriMesh(mesh.vertices[vertices], faces, None if own.is_plain else own)
        found.append(Part(parts.names[k], part, vertices, parts.transforms[k]))
    return found


def list_part_names(mesh: TriMesh) -> tuple[str, ...]:
    """List the names of the parts of a mesh; nothing if it came as one."""
    attributes = mesh.attributes
    return () if attributes is None or attributes.parts is None else attributes.parts.names


def adopt_parts(attributes: SurfaceAttributes, other: SurfaceAttributes) -> SurfaceAttributes:
    """Return attributes with the parts of others, which have some, of the same triangles.

    The triangles may be of other polygons.
    """
    parts = other.parts
    assert parts is not None
    starts = [each.start for each in parts.polygon_slices]
    stops = np.cumsum(np.add.reduceat(other.corner_counts - 2, starts))
    counts = np.diff(attributes.triangle_polygons[stops - 1], prepend=-1)
    parts = Parts(parts.names, parts.vertex_counts, counts, parts.transforms)
    subdivision = attributes.subdivision
    if len(subdivision.part_schemes) != len(parts.names):
        subdivision = replace(subdivision, part_schemes=())
    return replace(attributes, parts=parts, subdivision=subdivision)


def _select_attributes(
    whole: SurfaceAttributes, vertices: slice, polygons: slice, number: int
) -> SurfaceAttributes:
    """Return the attributes of the polygons of one part, whose vertices count from its first."""
    stops = np.cumsum(whole.corner_counts)
    first = int(stops[polygons.start - 1]) if polygons.start else 0
    own = slice(first, int(stops[polygons.stop - 1]))
    corners = whole.corners[own] - vertices.start
    fans = None if whole.normal_fans is None else whole.normal_fans[own]
    labels: dict[str, Any] = {
        name: _select_labels(getattr(whole, name), polygons) for name in LABEL_NAMES
    }
    material_colours = None
    materials, kept = whole.materials, labels["materials"]
    if whole.material_colours is not None and materials is not None and kept is not None:
        rows = [materials.names.index(name) for name in kept.names]
        material_colours = whole.material_colours[rows]
    colours = None if whole.colours is None else whole.colours[vertices]
    if colours is not None and (colours == 1).all():
        colours = None  # white is what a part without colours was given
    return SurfaceAttributes(
        corner_counts=whole.corner_counts[polygons],
        corners=corners,
        uvs=_select_uvs(whole.uvs, own),
        normal_fans=(
            None if fans is None or (fans == NONE).all() else number_normal_fans(corners, fans)
        ),
        colours=colours,
        material_colours=material_colours,
        material_library="" if materials is not None and kept is None else whole.material_library,
        subdivision=_select_subdivision(whole.subdivision, vertices, number),
        **labels,
    )


def _select_uvs(uvs: UvMap | None, corners: slice) -> UvMap | None:
    if uvs is None:
        return None
    used, indices = _count_used(uvs.indices[corners])
    return UvMap(uvs.values[used], indices) if len(used) else None


def _select_labels(labels: FaceLabels | None, polygons: slice) -> FaceLabels | None:
    if labels is None:
        return None
    used, indices = _count_used(labels.indices[polygons])
    return FaceLabels(tuple(labels.names[k] for k in used), indices) if len(used) else None


def _count_used(numbers: Integers) -> tuple[Integers, Integers]:
    """Return which numbers are used, and the place of each among these; `NONE` stays."""
    used, places = np.unique(numbers, return_inverse=True)
    is_absent = int(used[0] == NONE)
    return used[is_absent:], places - is_absent


def _select_subdivision(whole: Subdivision, vertices: slice, number: int) -> Subdivision:
    creases = np.repeat(np.arange(len(whole.crease_lengths)), whole.crease_lengths)
    is_own = _is_within(whole.crease_vertices, vertices)
    own = np.unique(creases[is_own])
    sharpness = whole.crease_sharpness
    if len(sharpness) == len(whole.crease_lengths):
        sharpness = sharpness[own]
    else:
        edges = np.repeat(np.arange(len(whole.crease_lengths)), whole.crease_lengths - 1)
        sharpness = sharpness[np.isin(edges, own)]
    is_sharp = _is_within(whole.corner_vertices, vertices)
    return Subdivision(
        whole.part_schemes[number] if whole.part_schemes else whole.scheme,
        whole.crease_vertices[is_own] - vertices.start,
        whole.crease_lengths[own],
        sharpness,
        whole.corner_vertices[is_sharp] - vertices.start,
        whole.corner_sharpness[is_sharp],
    )


def _is_within(numbers: Integers, vertices: slice) -> np.ndarray:
    return np.asarray((numbers >= vertices.start) & (numbers < vertices.stop))


def join_meshes(
    meshes: Sequence[TriMesh], names: Sequence[str], transforms: Sequence[Floats] | None = None
) -> TriMesh:
    """Join meshes of one space into a model of as many parts.

    Parameters
    ----------
    names : sequence of str
        A name that is there before gets a number.
    transforms : sequence of (4, 4), optional
        Of the parts at rest, see `Parts`; a part whose transform flattens it has none.
    """
    bounds = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    attributes = [mesh.polygons for mesh in meshes]
    parts = Parts(
        names=tuple(number_names(names)),
        vertex_counts=np.diff(bounds),
        polygon_counts=np.array([len(each.corner_counts) for each in attributes]),
        transforms=np.stack([np.eye(4)] * len(meshes) if transforms is None else transforms),
    )
    return TriMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + at for mesh, at in zip(meshes, bounds[:-1], strict=True)]),
        _join_attributes(attributes, bounds, parts),
    )


def _join_attributes(
    attributes: Sequence[SurfaceAttributes], bounds: Integers, parts: Parts
) -> SurfaceAttributes:
    """Join attributes whose vertices are from one of the bounds, (k + 1,), to the next."""
    materials, material_colours = _join_materials(attributes)
    labels: dict[str, Any] = {
        name: _join_labels([getattr(each, name) for each in attributes], attributes)
        for name in LABEL_NAMES
        if name != "materials"
    }
    libraries = {each.material_library for each in attributes} - {""}
    return SurfaceAttributes(
        corner_counts=np.concatenate([each.corner_counts for each in attributes]),
        corners=_shift_and_join([each.corners for each in attributes], bounds),
        uvs=_join_uvs(attributes),
        normal_fans=_join_fans(attributes),
        colours=_join_colours(attributes, np.diff(bounds)),
        materials=materials,
        material_colours=material_colours,
        material_library=libraries.pop() if len(libraries) == 1 else "",
        subdivision=_join_subdivisions([each.subdivision for each in attributes], bounds),
        parts=parts,
        **labels,
    )


def _shift_and_join(numbers: Sequence[Integers], bounds: Integers) -> Integers:
    """Join numbers that count from 0 in each part; `NONE` stays."""
    pairs = zip(numbers, bounds[: len(numbers)], strict=True)
    return np.concatenate([np.where(own == NONE, NONE, own + start) for own, start in pairs])


def _join_uvs(attributes: Sequence[SurfaceAttributes]) -> UvMap | None:
    if all(each.uvs is None for each in attributes):
        return None
    absent = [UvMap(np.zeros((0, 2)), np.full(len(each.corners), NONE)) for each in attributes]
    maps = [each.uvs or none for each, none in zip(attributes, absent, strict=True)]
    bounds = np.cumsum([0, *(len(each.values) for each in maps)])
    indices = _shift_and_join([each.indices for each in maps], bounds)
    return UvMap(np.concatenate([each.values for each in maps]), indices)


def _join_fans(attributes: Sequence[SurfaceAttributes]) -> Integers | None:
    if all(each.normal_fans is None for each in attributes):
        return None
    fans = [
        np.full(len(each.corners), NONE) if each.normal_fans is None else each.normal_fans
        for each in attributes
    ]
    return _shift_and_join(fans, np.cumsum([0, *(int(own.max()) + 1 for own in fans)]))


def _join_colours(attributes: Sequence[SurfaceAttributes], counts: Integers) -> Floats | None:
    """Join the colours of vertices; white where a part has none."""
    given = [each.colours for each in attributes]
    width = max((own.shape[1] for own in given if own is not None), default=0)
    if not width:
        return None
    colours = np.ones((int(counts.sum()), width))
    for own, stop, count in zip(given, np.cumsum(counts), counts, strict=True):
        if own is not None:
            colours[stop - count : stop, : own.shape[1]] = own
    return colours


def _join_labels(
    labels: Sequence[FaceLabels | None], attributes: Sequence[SurfaceAttributes]
) -> FaceLabels | None:
    """Join names of faces; the same name in two parts is one."""
    names = tuple(dict.fromkeys(name for own in labels if own for name in own.names))
    numbers = {name: k for k, name in enumerate(names)}
    indices = [
        np.full(len(each.corner_counts), NONE)
        if own is None
        else np.array([*(numbers[name] for name in own.names), NONE])[own.indices]
        for own, each in zip(labels, attributes, strict=True)
    ]
    return FaceLabels(names, np.concatenate(indices)) if names else None


def _join_materials(
    attributes: Sequence[SurfaceAttributes],
) -> tuple[FaceLabels | None, Floats | None]:
    """Join materials and their colours; one of the same name and another colour gets a number."""
    looks = [_list_materials(each) for each in attributes]
    together = list(dict.fromkeys(chain.from_iterable(looks)))
    names = dict(zip(together, number_names(name for name, _ in together), strict=True))
    labels = [
        None
        if each.materials is None
        else replace(each.materials, names=tuple(names[look] for look in own))
        for each, own in zip(attributes, looks, strict=True)
    ]
    joined = _join_labels(labels, attributes)
    if joined is None or all(each.material_colours is None for each in attributes):
        return joined, None
    return joined, np.array([colour for _, colour in together])


def _list_materials(attributes: SurfaceAttributes) -> list[tuple[str, tuple[float, ...]]]:
    """Return the name and the colour of each material."""
    names = () if attributes.materials is None else attributes.materials.names
    known = attributes.material_colours
    colours = [PLAIN_COLOUR] * len(names) if known is None else map(tuple, known.tolist())
    return list(zip(names, colours, strict=True))


def _join_subdivisions(given: Sequence[Subdivision], bounds: Integers) -> Subdivision:
    """Join schemes, creases and sharp vertices.

    The sharpness of creases becomes that of each of their edges, if one has it so.
    """
    schemes = tuple(each.scheme for each in given)
    is_alike = len(set(schemes)) == 1
    is_by_crease = [len(each.crease_sharpness) == len(each.crease_lengths) for each in given]
    sharpness = [
        np.repeat(each.crease_sharpness, each.crease_lengths - 1)
        if by_crease and not all(is_by_crease)
        else each.crease_sharpness
        for each, by_crease in zip(given, is_by_crease, strict=True)
    ]
    return Subdivision(
        schemes[0] if is_alike else "none",
        _shift_and_join([each.crease_vertices for each in given], bounds),
        np.concatenate([each.crease_lengths for each in given]),
        np.concatenate(sharpness),
        _shift_and_join([each.corner_vertices for each in given], bounds),
        np.concatenate([each.corner_sharpness for each in given]),
        () if is_alike else schemes,
    )


@dataclass(frozen=True, slots=True)
class PartShare:
    """Some of the vertices of a part: how many of how many."""

    name: str
    found: int
    total: int


def get_parts(mesh: TriMesh) -> Parts | None:
    """Return the parts that a mesh was joined from; None unless there are several."""
    parts = None if mesh.attributes is None else mesh.attributes.parts
    return None if parts is None or len(parts.names) < 2 else parts


def name_part(mesh: TriMesh, vertex: int) -> str | None:
    """Return the name of the part that a vertex is of; None for a model of one part."""
    parts = get_parts(mesh)
    return None if parts is None else parts.names[_find_part(parts, vertex)]


def name_vertex(mesh: TriMesh, vertex: int) -> str:
    """Return the number of a vertex, and of a model of several parts its place in its part."""
    parts = get_parts(mesh)
    if parts is None:
        return str(vertex)
    number = _find_part(parts, vertex)
    place = format_place(vertex, parts.names[number], parts.vertex_slices[number].start)
    return f"{vertex} ({place})"


def format_place(vertex: int, part: str, first: int) -> str:
    """Return text such as `/hero/geo/jacket[102]`: the number of a vertex in its part, from 0."""
    return f"{part}[{vertex - first}]"


def count_by_part(mesh: TriMesh, vertices: Integers) -> list[PartShare]:
    """Count those of some vertices (k,) that each part has; the most first, none without any.

    Nothing for a model of one part.
    """
    parts = get_parts(mesh)
    if parts is None:
        return []
    counts = np.bincount(_find_part(parts, vertices), minlength=len(parts.names))
    order = np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]
    totals = parts.vertex_counts
    return [PartShare(parts.names[k], int(counts[k]), int(totals[k])) for k in order]


def describe_by_part(shares: Iterable[PartShare]) -> str:
    """Return text such as ` (/hero/body 12 of 208, /hero/jacket 4 of 112)`; empty for nothing."""
    texts = [f"{share.name} {share.found} of {share.total}" for share in shares]
    return f" ({join_truncated(texts, MAX_PARTS_NAMED)})" if texts else ""


def _find_part(parts: Parts, vertices: Integers | int) -> Integers:
    """Return the number of the part that each of some vertices is of."""
    found: Integers = np.searchsorted(np.cumsum(parts.vertex_counts), vertices, side="right")
    return found
