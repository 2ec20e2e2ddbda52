"""The faults of a check as marks on the cage and the model: in a list, and as colours of a PLY."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.check.faults import Finding
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.render.shading import parse_colour
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.text import pluralize

FAULT_COLOURS = ("#d62f27", "#e08214", "#7b3fa0", "#0f8b8d", "#c2185b", "#5d7a1f", "#8c510a")
"""Colours of faults, in their order; after the last the first comes again."""


@dataclass(frozen=True, slots=True, eq=False)
class FaultMark:
    """One fault that has a place.

    Attributes
    ----------
    number : int
        From 1.
    colour : str
        As #rrggbb.
    text : str
        What it is, with the first numbers.
    cage, rest : (k,) int64
        Vertices of the meshes that it concerns.
    cage_faces : (f,) int64
        Faces of the cage that it concerns; if it concerns vertices, those with no other corners.
    points : (p, 3) float64
        Where it is.
    """

    number: int
    colour: str
    text: str
    cage: Integers
    rest: Integers
    cage_faces: Integers
    points: Floats


def list_marks(
    findings: tuple[Finding, ...], cage: TriMesh, rest: TriMesh | None
) -> tuple[FaultMark, ...]:
    """List the findings that have a place, numbered in their order."""
    placed = [found for found in findings if len(found.numbers) or found.place is not None]
    return tuple(
        _make_mark(number, found, cage, rest) for number, found in enumerate(placed, start=1)
    )


def _make_mark(number: int, found: Finding, cage: TriMesh, rest: TriMesh | None) -> FaultMark:
    of_mesh = dict(_find_vertices(found, cage, rest))
    none: Integers = np.empty(0, np.int64)
    on_cage, on_rest = of_mesh.get("cage", none), of_mesh.get("rest", none)
    # Pairs of faces of both meshes are shown on the cage.
    points = cage.vertices[on_cage]
    if len(on_rest) and not len(on_cage) and rest is not None:
        points = rest.vertices[on_rest]
    if found.place is not None:
        points = np.array([found.place])
    if found.elements.startswith("face") and found.mesh != "rest":
        cage_faces = np.unique(found.numbers[:, 1] if found.mesh == "both" else found.numbers)
    else:
        cage_faces = np.flatnonzero(np.isin(cage.faces, on_cage).all(axis=1))
    return FaultMark(
        number=number,
        colour=FAULT_COLOURS[(number - 1) % len(FAULT_COLOURS)],
        text=_describe(found),
        cage=on_cage,
        rest=on_rest,
        cage_faces=cage_faces,
        points=points,
    )


def _find_vertices(
    found: Finding, cage: TriMesh, rest: TriMesh | None
) -> Iterator[tuple[str, Integers]]:
    """Yield the vertices of each mesh that a finding concerns."""
    if found.mesh == "both":
        if rest is not None and len(found.numbers):
            yield "rest", np.unique(rest.faces[found.numbers[:, 0]])
            yield "cage", np.unique(cage.faces[found.numbers[:, 1]])
        return
    mesh = cage if found.mesh == "cage" or rest is None else rest
    numbers = np.unique(found.numbers)
    is_of_faces = found.elements.startswith("face")
    yield found.mesh, np.unique(mesh.faces[numbers]) if is_of_faces else numbers


def _describe(found: Finding) -> str:
    kind = found.kind.replace("-", " ")
    if found.place is not None:
        x, y, z = found.place
        return f"{kind} at ({x:.3g}, {y:.3g}, {z:.3g})"
    names = ["-".join(map(str, np.ravel(number))) for number in found.numbers.tolist()]
    if len(names) == 1:
        nouns = ("vertex", "edge", "face", "face pair")
        singular = next(noun for noun in nouns if pluralize(noun) == found.elements)
        return f"{kind}: {singular} {names[0]}"
    return f"{kind}: {len(names)} {found.elements} ({join_truncated(names, 3)})"


def encode_marked_ply(cage: TriMesh, rest: TriMesh | None, marks: tuple[FaultMark, ...]) -> bytes:
    """Encode the cage, then the rest pose if there is one, as binary PLY.

    A vertex has the colour of the first fault that concerns it.
    """
    meshes = {"cage": cage} if rest is None else {"cage": cage, "rest": rest}
    points = np.concatenate([mesh.vertices for mesh in meshes.values()])
    colours = [_colour_vertices(marks, name, len(mesh.vertices)) for name, mesh in meshes.items()]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes.values())])
    faces = [mesh.faces + start for mesh, start in zip(meshes.values(), offsets, strict=False)]
    corners = np.concatenate(faces)
    rows = np.zeros(len(points), [("place", "<f8", 3), ("colour", "u1", 3)])
    rows["place"], rows["colour"] = points, np.rint(255 * np.concatenate(colours))
    triangles = np.zeros(len(corners), [("count", "u1"), ("corners", "<i4", 3)])
    triangles["count"], triangles["corners"] = 3, corners
    first = f"the first {len(cage.vertices)} vertices and {len(cage.faces)} faces"
    header = f"""ply
format binary_little_endian 1.0
comment cage: {first}; then the rest pose
element vertex {len(points)}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
element face {len(corners)}
property list uchar int vertex_indices
end_header
"""
    return header.encode() + rows.tobytes() + triangles.tobytes()


def _colour_vertices(marks: tuple[FaultMark, ...], mesh: str, count: int) -> Floats:
    """Colours of all vertices of the `cage` or the `rest`, (count, 3); the first fault counts."""
    plain = {"cage": "#9dbbe0", "rest": "#e2d6c8"}
    colours = np.tile(parse_colour(plain[mesh]), (count, 1))
    for mark in reversed(marks):
        colours[mark.cage if mesh == "cage" else mark.rest] = parse_colour(mark.colour)
    return colours
