"""A rest cage as the page has it: what is sent to it, and what is read of what it sends."""

import json
from typing import Any

import numpy as np

from cageik_cli.formats.base.mesh_data import FileMesh
from cageik_cli.geometry.mesh import MAX_COORDINATE, TriMesh
from cageik_cli.util.errors import FormatError
from cageik_cli.util.json_files import JsonFormat, format_value, parse_json
from cageik_cli.util.text import format_count
from cageik_cli.workflows.view.page_edits import MAX_SENT_BYTES

MAX_EDITED_VERTICES = 2500
"""Vertices of a cage that is edited: a closed one then has as many faces as can be bound."""

MAX_EDITED_CORNERS = 20_000
"""Corners of all its polygons, and so the triangles that they are cut into."""

CAGE_FORMAT = JsonFormat("a cage of the page", MAX_SENT_BYTES)


def check_size(cage: TriMesh) -> None:
    """Refuse a cage that is too large to be edited."""
    for count, most, noun in (
        (len(cage.vertices), MAX_EDITED_VERTICES, "vertex"),
        (len(cage.polygons.corners), MAX_EDITED_CORNERS, "corner"),
    ):
        if count > most:
            raise FormatError(
                f"the cage has {format_count(count, noun)}, at most {most} can be edited; "
                "use a coarser cage"
            )


def encode_cage(cage: TriMesh, **values: Any) -> str:
    """Return the JSON of a cage, and of further values, with all digits of its coordinates."""
    document = {"vertices": cage.vertices.tolist(), "polygons": list_polygons(cage), **values}
    return json.dumps(document, separators=(",", ":"))


def list_polygons(mesh: TriMesh) -> list[list[int]]:
    """Return the vertices of each polygon."""
    starts = mesh.polygons.starts.tolist()
    return [part.tolist() for part in np.split(mesh.polygons.corners, starts[1:])]


def parse_cage(data: bytes) -> TriMesh:
    """Return the cage of a body that was sent; its vertices have the numbers of the text.

    Raises
    ------
    FormatError
        When it is not {"vertices": [[x, y, z], …], "polygons": [[…], …]}, or too large.
    """
    document = parse_json(data, CAGE_FORMAT)
    if not isinstance(document, dict) or document.keys() != {"vertices", "polygons"}:
        raise FormatError(
            f"is {format_value(document)}, expected an object with `vertices` and `polygons` alone"
        )
    vertices = _check_rows(document["vertices"], "vertices", MAX_EDITED_VERTICES)
    for k, vertex in enumerate(vertices):
        if len(vertex) != 3 or not all(map(_is_coordinate, vertex)):
            raise FormatError(
                f"vertices[{k}]: expected three numbers up to {MAX_COORDINATE:g}; send the cage "
                "again"
            )
    polygons = _check_rows(document["polygons"], "polygons", MAX_EDITED_CORNERS // 3)
    for k, polygon in enumerate(polygons):
        if len(polygon) < 3 or not all(_is_index(corner, len(vertices)) for corner in polygon):
            raise FormatError(
                f"polygons[{k}]: expected three or more vertices from 0 to {len(vertices) - 1}; "
                "send the cage again"
            )
    if (count := sum(map(len, polygons))) > MAX_EDITED_CORNERS:
        raise FormatError(
            f"polygons: have {count} corners, expected at most {MAX_EDITED_CORNERS}; use a "
            "coarser cage"
        )
    return FileMesh.from_polygons(np.array(vertices, float), polygons).make_mesh()


def _check_rows(value: Any, name: str, most: int) -> list[list[Any]]:
    """Return a list of lists that is not empty and not too long."""
    if not isinstance(value, list) or not 0 < len(value) <= most:
        raise FormatError(
            f"{name}: is {format_value(value)}, expected a list of 1 to {most}; use a coarser cage"
        )
    for k, row in enumerate(value):
        if not isinstance(row, list):
            raise FormatError(f"{name}[{k}]: is {format_value(row)}, expected a list")
    return value


def _is_coordinate(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= MAX_COORDINATE


def _is_index(value: Any, count: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count


def has_polygons_of(cage: TriMesh, other: TriMesh) -> bool:
    """Whether two cages have the same polygons, and as many vertices: vertices at most moved."""
    return len(cage.vertices) == len(other.vertices) and all(
        np.array_equal(getattr(cage.polygons, name), getattr(other.polygons, name))
        for name in ("corner_counts", "corners")
    )
