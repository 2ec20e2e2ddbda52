"""The frames of points that cages move, with their normals or as splats, as rows of properties."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, Binding
from cageik_cli.coordinates.point_motion import MovedBlock, PointMotion
from cageik_cli.formats.ply_points import place_normals, place_positions, place_splats
from cageik_cli.geometry.oriented import MapFaults, Oriented
from cageik_cli.util.arrays import Floats
from cageik_cli.util.progress import ProgressListener, mark_warning
from cageik_cli.util.threads import OrderedMap
from cageik_cli.workflows.model_file import LoadedModel
from cageik_cli.workflows.reconstruction import CageFrames


def find_oriented(
    model: LoadedModel, binding: Binding, note: Callable[[str], None]
) -> Oriented | None:
    """Return what turns with the points of a model; None if nothing does, or can.

    `note` takes why normals cannot.
    """
    oriented = model.oriented
    coordinates = binding.settings.coordinates
    if oriented is None or oriented.splats is not None or coordinates == "harmonic":
        return oriented
    note(
        f"its normals keep their values: turning them needs gradients, which {coordinates} weights "
        "do not have here; use --coordinates harmonic"
    )
    return None


def prepare_motion(
    binding: Binding, oriented: Oriented, memory: int, jobs: int, progress: ProgressListener
) -> PointMotion:
    """Compute the gradients of the weights of points; raises as `PointMotion`."""
    with progress.stage("gradients"):
        room = max(0, memory - binding.weights.nbytes)
        return PointMotion(binding, oriented, room, jobs, progress.update)


def move_frames(
    motion: PointMotion,
    rest: NDArray[Any],
    cages: CageFrames,
    jobs: int,
    note: Callable[[str], None],
) -> Iterator[NDArray[Any]]:
    """Yield the rows (k, m) of the points of frames, in order; they are overwritten by the next.

    At rest, they are `rest` (m,). At the end, `note` takes what is wrong with the motion, one
    sentence each.
    """
    faults = MapFaults()
    size = min(FRAMES_PER_PRODUCT, cages.count)
    # The next frames are computed while these are written.
    held = cycle([np.repeat(rest[None], size, axis=0) for _ in range(2)])

    def fill(item: tuple[NDArray[Any], Floats]) -> tuple[NDArray[Any], MapFaults]:
        rows, block = item[0][: len(item[1])], item[1]
        return rows, fill_rows(motion, rows, block, jobs)

    with OrderedMap(fill, zip(held, cages.blocks(size), strict=False), 1, 1) as blocks:
        for rows, found in blocks:
            faults += found
            yield rows
    note_faults(faults, motion, len(rest) * cages.count, note)


def note_faults(
    faults: MapFaults, motion: PointMotion, count: int, note: Callable[[str], None]
) -> None:
    """Note how many of `count` moved points are where space has lost its shape."""
    parts, mirrored = "points", "turned inside out"
    if motion.moves_splats:
        parts = "splats"
        mirrored += "; their colours are turned by the nearest rotation"
    for number, what in (
        (faults.mirrored, mirrored),
        (faults.flat, "flattened to a sheet, a line or a point"),
    ):
        if number:
            note(
                mark_warning(
                    f"{number} of {count} moved {parts} are {what}: the cage folds over there"
                )
            )


def fill_rows(motion: PointMotion, rows: NDArray[Any], cages: Floats, jobs: int) -> MapFaults:
    """Fill rows of frames (k, m) block by block in threads, and count what is wrong."""
    faults = MapFaults()
    move = partial(_move_block, motion, rows, cages)
    with OrderedMap(move, range(len(motion)), jobs, 2 * jobs) as blocks:
        for found in blocks:
            faults += found
    return faults


def _move_block(motion: PointMotion, rows: NDArray[Any], cages: Floats, number: int) -> MapFaults:
    moved: MovedBlock = motion.move(number, cages)
    for frame, (places, oriented) in enumerate(zip(moved.places, moved.oriented, strict=True)):
        part = rows[frame, moved.chosen]
        place_positions(part, places.T)
        if oriented.normals is not None:
            place_normals(part, oriented.normals)
        if oriented.splats is not None:
            place_splats(part, oriented.splats)
    return moved.faults
