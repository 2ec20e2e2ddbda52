"""Models of several meshes: joined into one mesh for the solve, and split again for outputs.

Messages name the part that a vertex is in, and count the vertices of each part.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from cageik_cli.geometry.attributes import (
    LAYERS,
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
from cageik_cli.util.text import group_digits, number_names


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
    spans = {"vertex": vertices, "face": polygons}
    spans["corner"] = slice(first, int(stops[polygons.stop - 1]))
    corners = whole.corners[spans["corner"]] - vertices.start
    layers = {
        name: _select_layer(getattr(whole, name), spans[layer.domain])
        for name, layer in LAYERS.items()
    }
    if layers["normal_fans"] is not None:
        layers["normal_fans"] = number_normal_fans(corners, layers["normal_fans"])
    materials, kept, material_colours = whole.materials, layers["materials"], None
    if whole.material_colours is not None and materials is not None and kept is not None:
        rows = [materials.names.index(name) for name in kept.names]
        material_colours = whole.material_colours[rows]
    return SurfaceAttributes(
        corner_counts=whole.corner_counts[polygons],
        corners=corners,
        material_colours=material_colours,
        material_library="" if materials is not None and kept is None else whole.material_library,
        subdivision=_select_subdivision(whole.subdivision, vertices, number),
        **layers,
    )


def _select_layer(held: Any, span: slice) -> Any:
    """Return what some corners, vertices or faces have of a layer; None if none has a value."""
    if held is None:
        return None
    if isinstance(held, np.ndarray):
        absent = NONE if held.ndim == 1 else 1  # white is what a part without colours was given
        return None if (held[span] == absent).all() else held[span]
    used, indices = _count_used(held.indices[span])
    if not len(used):
        return None
    if isinstance(held, UvMap):
        return UvMap(held.values[used], indices)
    return FaceLabels(tuple(held.names[k] for k in used), indices)


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
    sizes = {
        "corner": [len(each.corners) for each in attributes],
        "vertex": np.diff(bounds).tolist(),
        "face": [len(each.corner_counts) for each in attributes],
    }
    given = {name: [getattr(each, name) for each in attributes] for name in LAYERS}
    given["materials"], material_colours = _join_materials(attributes)
    libraries = {each.material_library for each in attributes} - {""}
    joined = SurfaceAttributes(
        corner_counts=np.concatenate([each.corner_counts for each in attributes]),
        corners=_shift_and_join([each.corners for each in attributes], bounds),
        material_colours=material_colours,
        material_library=libraries.pop() if len(libraries) == 1 else "",
        subdivision=_join_subdivisions([each.subdivision for each in attributes], bounds),
        parts=Parts(
            names=tuple(number_names(names)),
            vertex_counts=np.diff(bounds),
            polygon_counts=np.array(sizes["face"]),
            transforms=np.stack([np.eye(4)] * len(meshes) if transforms is None else transforms),
        ),
        **{name: _join_layer(name, given[name], sizes[LAYERS[name].domain]) for name in LAYERS},
    )
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces for mesh in meshes])
    faces += np.repeat(bounds[:-1], [len(mesh.faces) for mesh in meshes])[:, None]
    for array in (vertices, faces):
        array.flags.writeable = False  # so that they are not copied
    return TriMesh(vertices, faces, joined)


def _join_layer(name: str, given: Sequence[Any], sizes: Sequence[int]) -> Any:
    """Join a layer of parts, of which each has so many corners, vertices or faces.

    None if no part has it. Colours are white where a part has none; the same name of faces in two
    parts is one.
    """
    layer = LAYERS[name]
    if all(own is None for own in given):
        return None
    if layer.domain == "vertex":
        width = max(own.shape[1] for own in given if own is not None)
        rows = np.ones((sum(sizes), width))
        for own, stop in zip(given, np.cumsum(sizes), strict=True):
            if own is not None:
                rows[stop - len(own) : stop, : own.shape[1]] = own
        return rows
    if layer.domain == "face":
        names = tuple(dict.fromkeys(name for own in given if own for name in own.names))
        numbers = {name: k for k, name in enumerate(names)}
        indices = [
            np.full(size, NONE)
            if own is None
            else np.array([*(numbers[name] for name in own.names), NONE])[own.indices]
            for own, size in zip(given, sizes, strict=True)
        ]
        return FaceLabels(names, np.concatenate(indices)) if names else None
    pairs = list(zip(given, sizes, strict=True))
    if name == "normal_fans":
        fans = [np.full(size, NONE) if own is None else own for own, size in pairs]
        return _shift_and_join(fans, np.cumsum([0, *(int(own.max()) + 1 for own in fans)]))
    maps = [own or UvMap(np.zeros((0, layer.width)), np.full(size, NONE)) for own, size in pairs]
    starts = np.cumsum([0, *(len(each.values) for each in maps)])
    joined = _shift_and_join([each.indices for each in maps], starts)
    return UvMap(np.concatenate([each.values for each in maps]), joined)


def _shift_and_join(numbers: Sequence[Integers], bounds: Integers) -> Integers:
    """Join numbers that count from 0 in each part; `NONE` stays."""
    joined = np.concatenate(numbers)
    starts = np.repeat(bounds[: len(numbers)], [len(own) for own in numbers])
    np.add(joined, starts, out=joined, where=joined != NONE)
    joined.flags.writeable = False  # so that it is not copied
    return joined


def _join_materials(
    attributes: Sequence[SurfaceAttributes],
) -> tuple[list[FaceLabels | None], Floats | None]:
    """Return the materials of parts by the names that they have together, and their colours.

    One of the same name and another colour gets a number.
    """
    looks: list[list[tuple[str, tuple[float, ...]]]] = []
    for each in attributes:
        own = () if each.materials is None else each.materials.names
        known = each.material_colours
        colours = [PLAIN_COLOUR] * len(own) if known is None else map(tuple, known.tolist())
        looks.append(list(zip(own, colours, strict=True)))
    together = list(dict.fromkeys(chain.from_iterable(looks)))
    names = dict(zip(together, number_names(name for name, _ in together), strict=True))
    labels = [
        None
        if each.materials is None
        else replace(each.materials, names=tuple(names[look] for look in own))
        for each, own in zip(attributes, looks, strict=True)
    ]
    if not together or all(each.material_colours is None for each in attributes):
        return labels, None
    return labels, np.array([colour for _, colour in together])


def _join_subdivisions(given: Sequence[Subdivision], bounds: Integers) -> Subdivision:
    """Join schemes, creases and sharp vertices.

    The sharpness of creases becomes that of each of their edges, if one has it so.
    """
    schemes = tuple(each.scheme for each in given)
    is_alike = len(set(schemes)) == 1
    is_by_crease = [len(each.crease_sharpness) == len(each.crease_lengths) for each in given]
    is_mixed = not all(is_by_crease)
    sharpness = [
        np.repeat(each.crease_sharpness, each.crease_lengths - 1)
        if by_crease and is_mixed
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
    texts = [
        f"{share.name} {group_digits(share.found)} of {group_digits(share.total)}"
        for share in shares
    ]
    return f" ({join_truncated(texts)})" if texts else ""


def _find_part(parts: Parts, vertices: Integers | int) -> Integers:
    """Return the number of the part that each of some vertices is of."""
    found: Integers = np.searchsorted(np.cumsum(parts.vertex_counts), vertices, side="right")
    return found
