"""Notes on frames that are mirrored or in another unit, and on models of few vertices."""

import numpy as np

from cageik_cli.geometry.mesh import signed_volumes
from cageik_cli.store.result import Result, read_cages
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import join_truncated

MIRRORED_SHARE = -0.5
"""A frame is mirrored whose volume is less than this times that of the rest pose."""

MAX_SIZE_RATIO = 2.0
"""Frames that are larger or smaller than the rest pose by more are noted."""

UNIT_RATIOS = (
    (100.0, "centimetres and metres"),
    (10.0, "millimetres and centimetres"),
    (1000.0, "millimetres and metres"),
    (2.54, "inches and centimetres"),
    (25.4, "inches and millimetres"),
    (39.37, "inches and metres"),
    (12.0, "inches and feet"),
    (3.281, "feet and metres"),
    (30.48, "feet and centimetres"),
)
"""How many of one unit are in another."""

UNIT_TOL = 0.1
"""Relative distance from such a ratio up to which it is named: poses differ in size, too."""

MIN_DATA_PER_CAGE_VERTEX = 2
"""Vertices that are data, per cage vertex, below which the error is noted as too small.

On samba with cages of 60 to 300, and only some vertices as data, the error of the others is 8 to 10
times that of the data at 1 per cage vertex, 5 times at 1.5, 2.5 to 3 times at 2, 1.5 to 1.9 times
at 3, and 1.1 times at 10.
"""

CAGES_PER_BLOCK = 256


def list_clip_notes(result: Result) -> tuple[str, ...]:
    """Return notes on the frames and on how many vertices they have; none for an edited result."""
    if result.edited_from is not None:
        return ()
    return (
        *_note_mirrored_frames(result),
        *_note_other_size(result),
        *_note_few_vertices(result),
    )


def _note_mirrored_frames(result: Result) -> list[str]:
    """Say which frames are turned inside out."""
    shares = _measure_volume_shares(result)
    known = np.flatnonzero(np.isfinite(shares))
    mirrored = known[shares[known] < MIRRORED_SHARE]
    if len(mirrored) == 0:
        return []
    names = join_truncated((result.frames[k] for k in mirrored), 3)
    return [
        f"{len(mirrored)} of {len(result.frames)} frames are mirrored relative to the rest pose "
        f"({names}): their volume has the other sign; a scale of -1 or another handedness of the "
        "axes in the export is the likely cause"
    ]


def _measure_volume_shares(result: Result) -> Floats:
    """Return the signed volume of each frame relative to the rest pose; nan where unknown.

    Of a model that has none, it is that of the cage, which turns inside out with it.
    """
    volumes = result.metrics.volume
    if np.isfinite(volumes).any():
        return np.asarray(volumes / result.rest.volume)
    cages = read_cages(result, CAGES_PER_BLOCK)
    shares = np.concatenate([signed_volumes(block, result.cage.faces) for block in cages])
    shares[list(result.skipped)] = np.nan
    return np.asarray(shares / result.cage.volume)


def _note_other_size(result: Result) -> list[str]:
    """Say so if the frames are of another size than the rest pose, and which units explain it."""
    points = result.rest.vertices[np.isfinite(result.vertex_rms)]
    spread = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if not spread > 0:
        return []
    ratio = float(np.nanmedian(result.metrics.spread)) / spread
    if 1 / MAX_SIZE_RATIO <= ratio <= MAX_SIZE_RATIO:
        return []
    size = f"{ratio:.3g} times as large as" if ratio > 1 else f"{1 / ratio:.3g} times smaller than"
    return [
        f"the frames are {size} the rest pose in the median, by their spread about the centroid; "
        f"{_guess_cause(ratio)}, and the figures compare them with the diagonal of the rest pose"
    ]


def _guess_cause(ratio: float) -> str:
    factor = max(ratio, 1 / ratio) if ratio > 0 else np.inf
    for known, units in UNIT_RATIOS:
        if abs(factor / known - 1) < UNIT_TOL:
            return f"one is likely in another unit ({units})"
    return "one is likely in another unit, or of another model"


def _note_few_vertices(result: Result) -> list[str]:
    """Say so if hardly more vertices are data than the cage has."""
    data, points = int(np.isfinite(result.vertex_rms).sum()), len(result.cage.vertices)
    if data >= MIN_DATA_PER_CAGE_VERTEX * points:
        return []
    return [
        f"{data} vertices of the model are data, and the cage has {points}: with fewer than "
        f"{MIN_DATA_PER_CAGE_VERTEX} per cage vertex the cage follows them more closely than the "
        "surface between them, so the error is too small; take a smaller cage or a denser model"
    ]
