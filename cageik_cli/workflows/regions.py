"""The regions of a clip that deviate most, found when its frames are solved."""

import numpy as np

from cageik_cli.cages.quality import has_too_much_room
from cageik_cli.cages.sections import find_shared_sections
from cageik_cli.coordinates.binding import Binding
from cageik_cli.solver.regions import (
    Region,
    blame_loose_cage,
    blame_shared_places,
    find_worst_regions,
    has_bad_regions,
)
from cageik_cli.solver.summary import ClipSummary
from cageik_cli.util.arrays import Floats


def find_clip_regions(binding: Binding, summary: ClipSummary) -> tuple[Region, ...]:
    """Find the worst regions of a clip; none if its largest deviation is within the usual."""
    rms = float(np.sqrt(np.nanmean(summary.frame_rms**2)))
    largest = float(summary.peaks.deviations.max())
    if not has_bad_regions(rms, largest, binding.rest.diagonal):
        return ()
    regions = find_worst_regions(binding, summary.peaks)
    if _has_loose_cage(binding):
        return blame_loose_cage(regions, binding.rest.diagonal)
    places = _find_shared_places(binding, regions)
    return blame_shared_places(regions, places, binding.rest.diagonal)


def _has_loose_cage(binding: Binding) -> bool:
    """Return whether the cage is far too loose, as the bind found, or judged now if it did not."""
    if binding.has_loose_cage is not None:
        return binding.has_loose_cage
    return has_too_much_room(binding.cage, binding.rest)


def _find_shared_places(
    binding: Binding, regions: tuple[Region, ...]
) -> list[tuple[Floats, float]]:
    """The places at these regions where limbs share a loop of the cage."""
    centres = np.array([region.centre for region in regions])
    sections = find_shared_sections(binding.cage, binding.rest, near=centres)
    return [(section.centre, (section.size + section.length) / 2) for section in sections]
