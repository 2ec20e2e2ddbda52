"""The worst regions of a clip, as an attribute of its result."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import h5py
import numpy as np

from cageik_cli.solver.metrics import MAX_LENGTH
from cageik_cli.solver.region_causes import Cause, Evidence
from cageik_cli.solver.regions import MAX_CAGE_FACES, MAX_REGIONS, Region
from cageik_cli.store.hdf5_fields import read_json_attr, to_json
from cageik_cli.util.errors import FormatError

ATTRIBUTE = "regions"


@dataclass(frozen=True, slots=True)
class StoredRegion:
    """A region of the model that deviates much.

    Attributes
    ----------
    centre : tuple of float
        Mean of its vertices in the rest pose, file units.
    size : float
        Diagonal of the box around them, file units.
    vertices : int
        How many they are.
    frame : int
        The frame of the largest deviation, by its number in the clip.
    max_deviation : float
        File units.
    cage_faces : tuple of int
        The cage's faces nearest to the region, that of the worst vertex first.
    """

    centre: tuple[float, float, float]
    size: float
    vertices: int
    frame: int
    max_deviation: float
    worst_vertex: int
    cage_faces: tuple[int, ...]
    cause: Cause
    evidence: Evidence


@dataclass(frozen=True, slots=True)
class RegionCounts:
    """How many frames, vertices and cage faces the regions of a result can name."""

    frames: int
    vertices: int
    cage_faces: int


def write_regions(file: h5py.File, regions: Sequence[Region]) -> None:
    """Write the worst regions of a clip; none if its largest deviation is within the usual."""
    file.attrs[ATTRIBUTE] = to_json([_make_record(region) for region in regions])


def read_regions(file: h5py.File, counts: RegionCounts) -> tuple[StoredRegion, ...] | None:
    """Read the worst regions of a clip; None if the result was written without them.

    Raises
    ------
    InputError
        When they are damaged, or name what the result does not have.
    """
    if ATTRIBUTE not in file.attrs:
        return None
    held = read_json_attr(file, ATTRIBUTE, list)
    try:
        regions = tuple(_parse_region(record) for record in held)
    except (TypeError, ValueError, KeyError) as error:
        raise _make_error(f"does not describe regions ({error})") from error
    if len(regions) > MAX_REGIONS:
        raise _make_error(f"has {len(regions)} regions, expected at most {MAX_REGIONS}")
    for region in regions:
        _check_region(region, counts)
    return regions


def _make_record(region: Region) -> dict[str, Any]:
    stored = StoredRegion(
        centre=tuple(region.centre.tolist()),
        size=region.size,
        vertices=len(region.vertices),
        frame=region.frame,
        max_deviation=region.max_deviation,
        worst_vertex=region.worst_vertex,
        cage_faces=tuple(region.cage_faces.tolist()),
        cause=region.cause,
        evidence=region.evidence,
    )
    return asdict(stored)


def _parse_region(record: dict[str, Any]) -> StoredRegion:
    """Make a region of a JSON object; errors of Python say what is wrong."""
    names = {field.name for field in fields(StoredRegion)}
    if not isinstance(record, dict) or set(record) != names:
        raise ValueError(f"expected objects of {', '.join(sorted(names))}")
    x, y, z = map(float, record["centre"])
    evidence = dict(record["evidence"])
    judged = {name: bool(evidence.pop(name)) for name in ("in_shared_place", "has_loose_cage")}
    found: dict[str, Any] = {name: float(value) for name, value in evidence.items()}
    return StoredRegion(
        centre=(x, y, z),
        size=float(record["size"]),
        vertices=int(record["vertices"]),
        frame=int(record["frame"]),
        max_deviation=float(record["max_deviation"]),
        worst_vertex=int(record["worst_vertex"]),
        cage_faces=tuple(map(int, record["cage_faces"])),
        cause=Cause(record["cause"]),
        evidence=Evidence(**found, **judged),
    )


def _check_region(region: StoredRegion, counts: RegionCounts) -> None:
    figures = [value for value in asdict(region.evidence).values() if not isinstance(value, bool)]
    if not np.isfinite(figures).all():
        raise _make_error(f"has evidence that is not finite (found {region.evidence})")
    numbers = [
        ("frames", counts.frames, (region.frame,)),
        ("vertices", counts.vertices, (region.worst_vertex,)),
        ("cage faces", counts.cage_faces, region.cage_faces),
    ]
    for noun, count, found in numbers:
        if not all(0 <= number < count for number in found):
            raise _make_error(f"names {noun} that are not there (found {found}, of {count})")
    lengths = (region.size, region.max_deviation)
    if not all(0 <= length <= MAX_LENGTH for length in lengths):
        raise _make_error(f"has sizes or deviations that are no lengths (found {lengths})")
    if not 0 < len(region.cage_faces) <= MAX_CAGE_FACES:
        raise _make_error(
            f"has a region near {len(region.cage_faces)} cage faces, expected 1 to {MAX_CAGE_FACES}"
        )
    if not 1 <= region.vertices <= counts.vertices:
        raise _make_error(
            f"has a region of {region.vertices} vertices, expected 1 to {counts.vertices}"
        )
    if not all(abs(place) <= MAX_LENGTH for place in region.centre):
        raise _make_error("has a centre that is too far away")


def _make_error(fault: str) -> FormatError:
    return FormatError(f"attribute `{ATTRIBUTE}` {fault}; extract it again")
