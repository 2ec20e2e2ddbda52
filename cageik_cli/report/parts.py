"""The error of each part of a model, and where a vertex is in words.

The rms of a part is the root of the mean square of its vertices over the clip, in percent of the
diagonal of the whole model, so that parts can be compared with each other and with the clip.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.geometry.parts import format_place, get_parts
from cageik_cli.report.figures import format_percent
from cageik_cli.store.result import StoredAnimation
from cageik_cli.util.arrays import Floats

MAX_PART_ROWS = 8
"""Parts that have a line each in the text of a report, the worst first; the others are counted."""


@dataclass(frozen=True, slots=True)
class PartRecord:
    """A part of the model, and the rms of its vertices over the clip; None if none is data.

    `first_vertex` is the number of its first vertex in the model. Lengths are in file units.
    """

    name: str
    first_vertex: int
    vertices: int
    rms: float | None
    rms_percent: float | None


def build_parts(result: StoredAnimation) -> tuple[PartRecord, ...] | None:
    """Measure each part, in the order of the model; None for a model of one part."""
    parts = get_parts(result.rest)
    if parts is None:
        return None
    records = []
    for name, vertices in zip(parts.names, parts.vertex_slices, strict=True):
        rms = measure_rms(result.vertex_rms[vertices])
        percent = None if rms is None else 100 * rms / result.rest.diagonal
        count = vertices.stop - vertices.start
        records.append(PartRecord(name, vertices.start, count, rms, percent))
    return tuple(records)


def measure_rms(vertex_rms: Floats) -> float | None:
    """Return the rms of the vertices that are data, whose own is given, (m,); None if none is."""
    known = vertex_rms[np.isfinite(vertex_rms)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def sort_parts(parts: Sequence[PartRecord] | None) -> list[PartRecord]:
    """Return the parts, those with the largest rms first, those without data last."""
    return sorted(parts or (), key=lambda part: 1.0 if part.rms is None else -part.rms)


def place_vertex(parts: Sequence[PartRecord] | None, vertex: int) -> str:
    """Return where a vertex is in its part, such as `/hero/jacket[102]`; empty for one part."""
    for part in parts or ():
        if part.first_vertex <= vertex < part.first_vertex + part.vertices:
            return format_place(vertex, part.name, part.first_vertex)
    return ""


def label_vertex(parts: Sequence[PartRecord] | None, vertex: int) -> str:
    """Return the number of a vertex, and of a model of several parts its place in its part."""
    place = place_vertex(parts, vertex)
    return f"{vertex} ({place})" if place else str(vertex)


def format_part_rows(parts: Sequence[PartRecord] | None, worst: str) -> list[tuple[str, str]]:
    """Return a line per part, the worst first, which `worst` labels; nothing for one part."""
    rows = []
    for k, part in enumerate(sort_parts(parts)):
        text = f"no data in {part.name}"
        if part.rms_percent is not None:
            text = f"{format_percent(part.rms_percent)} % in {part.name}"
        rows.append((f"{worst} part" if not k else "part", text))
    if len(rows) > MAX_PART_ROWS:
        rows = [*rows[:MAX_PART_ROWS], ("parts", f"and {len(rows) - MAX_PART_ROWS} more")]
    return rows
