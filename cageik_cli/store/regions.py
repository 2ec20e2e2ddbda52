"""The worst regions of a clip, as an attribute of its result."""

from collections.abc import Sequence
from dataclasses import asdict

import h5py

from cageik_cli.solver.metrics import MAX_LENGTH
from cageik_cli.solver.regions import MAX_CAGE_FACES, MAX_REGIONS, Region
from cageik_cli.store.hdf5_fields import read_json_attr, to_json
from cageik_cli.store.json_records import parse_record
from cageik_cli.util.errors import FormatError


def write_regions(file: h5py.File, regions: Sequence[Region]) -> None:
    """Write the worst regions of a clip; none if its largest deviation is within the usual."""
    file.attrs["regions"] = to_json([asdict(region) for region in regions])


def read_regions(
    file: h5py.File, *, frames: int, vertices: int, cage_faces: int
) -> tuple[Region, ...] | None:
    """Read the worst regions of a clip; None if the result was written without them.

    Parameters
    ----------
    frames, vertices, cage_faces : int
        How many of them the result has.

    Raises
    ------
    InputError
        When they are damaged, or name what the result does not have.
    """
    if "regions" not in file.attrs:
        return None
    held = read_json_attr(file, "regions", list)
    try:
        regions: tuple[Region, ...] = parse_record(tuple[Region, ...], held, "regions")
    except FormatError as error:
        raise _make_error(f"does not describe regions ({error})") from error
    if len(regions) > MAX_REGIONS:
        raise _make_error(f"has {len(regions)} regions, expected at most {MAX_REGIONS}")
    for region in regions:
        numbers = [
            ("frames", frames, (region.frame,)),
            ("vertices", vertices, (region.worst_vertex,)),
            ("cage faces", cage_faces, region.cage_faces),
        ]
        for noun, count, found in numbers:
            if not all(0 <= number < count for number in found):
                raise _make_error(f"names {noun} that are not there (found {found}, of {count})")
        if not 1 <= region.vertices <= vertices:
            raise _make_error(
                f"has a region of {region.vertices} vertices, expected 1 to {vertices}"
            )
        _check_sizes(region)
    return regions


def _check_sizes(region: Region) -> None:
    lengths = (region.size, region.max_deviation)
    if not all(0 <= length <= MAX_LENGTH for length in lengths):
        raise _make_error(f"has sizes or deviations that are no lengths (found {lengths})")
    if not 0 < len(region.cage_faces) <= MAX_CAGE_FACES:
        raise _make_error(
            f"has a region near {len(region.cage_faces)} cage faces, expected 1 to {MAX_CAGE_FACES}"
        )
    if not all(abs(place) <= MAX_LENGTH for place in region.centre):
        raise _make_error("has a centre that is too far away")


def _make_error(fault: str) -> FormatError:
    return FormatError(f"attribute `regions` {fault}; extract it again")
