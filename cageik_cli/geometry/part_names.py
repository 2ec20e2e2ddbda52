"""The parts of a model in sentences: where a vertex is, and how many vertices of each are meant."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface_parts import Parts
from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import join_truncated

MAX_PARTS_NAMED = 4
"""Parts that a sentence names; the others are counted."""


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
