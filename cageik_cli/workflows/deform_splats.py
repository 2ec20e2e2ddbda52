"""The frames of Gaussian splats that cages move, as rows of their files."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, Binding
from cageik_cli.coordinates.splat_motion import MovedBlock, SplatMotion
from cageik_cli.formats.points_ply import PointFile, place_positions
from cageik_cli.formats.splat_ply import place_splats
from cageik_cli.geometry.splats import MapFaults, Splats
from cageik_cli.util.arrays import Floats
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import mark_warning
from cageik_cli.util.threads import OrderedMap
from cageik_cli.workflows.reconstruction import CageFrames


def prepare_splats(
    binding: Binding, splats: Splats, memory: int, jobs: int, progress: ProgressListener
) -> SplatMotion:
    """Compute the gradients of the weights of splats; raises as `SplatMotion`."""
    with progress.stage("gradients"):
        room = max(0, memory - binding.weights.nbytes)
        return SplatMotion(binding, splats, room, jobs, progress.update)


def move_frames(
    motion: SplatMotion,
    points: PointFile,
    cages: CageFrames,
    jobs: int,
    note: Callable[[str], None],
) -> Iterator[NDArray[Any]]:
    """Yield the rows (k, m) of the splats of frames, in order; they are overwritten by the next.

    At the end, `note` takes what is wrong with the motion, one sentence each.
    """
    faults = MapFaults()
    size = min(FRAMES_PER_PRODUCT, cages.count)
    # The next frames are computed while these are written.
    held = cycle([np.repeat(points.rows[None], size, axis=0) for _ in range(2)])

    def fill(item: tuple[NDArray[Any], Floats]) -> tuple[NDArray[Any], MapFaults]:
        rows, block = item[0][: len(item[1])], item[1]
        return rows, fill_rows(motion, rows, block, jobs)

    with OrderedMap(fill, zip(held, cages.blocks(size), strict=False), 1, 1) as blocks:
        for rows, found in blocks:
            faults += found
            yield rows
    note_faults(faults, len(points.rows) * cages.count, note)


def note_faults(faults: MapFaults, count: int, note: Callable[[str], None]) -> None:
    """Note how many of `count` moved splats have lost their shape."""
    for number, what in (
        (faults.mirrored, "turned inside out; their colours are turned by the nearest rotation"),
        (faults.flat, "flattened to a sheet, a line or a point"),
    ):
        if number:
            note(
                mark_warning(
                    f"{number} of {count} moved splats are {what}: the cage folds over there"
                )
            )


def fill_rows(motion: SplatMotion, rows: NDArray[Any], cages: Floats, jobs: int) -> MapFaults:
    """Fill rows of frames (k, m) block by block in threads, and count what is wrong."""
    faults = MapFaults()
    move = partial(_move_block, motion, rows, cages)
    with OrderedMap(move, range(len(motion)), jobs, 2 * jobs) as blocks:
        for found in blocks:
            faults += found
    return faults


def _move_block(motion: SplatMotion, rows: NDArray[Any], cages: Floats, number: int) -> MapFaults:
    moved: MovedBlock = motion.move(number, cages)
    for frame, (places, splats) in enumerate(zip(moved.places, moved.splats, strict=True)):
        part = rows[frame, moved.chosen]
        place_positions(part, places.T)
        place_splats(part, splats)
    return moved.faults
