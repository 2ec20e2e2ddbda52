"""The bar of time: how far off each frame is, as paths of an SVG, and where the worst frame is."""

import math
from itertools import pairwise
from typing import Any

import numpy as np

from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.util.arrays import Floats

MAX_TIMELINE_COLUMNS = 600
"""More frames share columns: the bar has about so many pixels."""

MIN_COLUMN_HEIGHT = 0.04
"""Share of the bar that a frame without error takes, so that it is seen to be there."""


def list_frame_errors(clip: PlayerClip) -> list[float | None] | None:
    """List the errors of the frames, percent; None for a frame that was skipped."""
    if clip.frame_rms is None:
        return None
    digits = 6  # more than the bar of time can show
    errors = clip.frame_rms.tolist()
    return [round(one, digits) if math.isfinite(one) else None for one in errors]


def build_timeline(clip: PlayerClip) -> dict[str, Any]:
    """Build the values of the bar of time.

    Returns
    -------
    dict
        `last`, the number of the last frame from 0, which is the width of `paths`; these, by the
        class of what they show: columns as high as the errors of their frames, and full ones
        where all frames were skipped; and `ticks`, pairs of what a frame is, such as "worst", and
        where, percent of the width; and `jumps`, pairs of a frame from 0 and what it is.
    """
    last = max(len(clip.frames) - 1, 0)
    return {
        "last": last,
        "paths": {} if clip.frame_rms is None or not last else draw_columns(clip.frame_rms),
        "ticks": [
            (label, 100 * frame / last) for frame, (label, _) in clip.held.items() if last > 0
        ],
        "jumps": [(frame, label) for frame, (label, _) in clip.held.items()],
    }


def draw_columns(errors: Floats) -> dict[str, str]:
    """Draw columns of errors, nan where a frame was skipped, in a bar of the height 1."""
    last = len(errors) - 1
    columns = min(len(errors), MAX_TIMELINE_COLUMNS)
    edges = np.arange(columns + 1) * len(errors) // columns
    top = float(errors[np.isfinite(errors)].max(initial=0.0)) or 1.0
    paths = {"error": "", "skipped": ""}
    for start, stop in pairwise(edges):
        known = errors[start:stop][np.isfinite(errors[start:stop])]
        height = max(MIN_COLUMN_HEIGHT, known.max() / top) if len(known) else 1.0
        left, right = max(start - 0.5, 0), min(stop - 0.5, last)
        paths["error" if len(known) else "skipped"] += f"M{left:g} 1V{1 - height:.4g}H{right:g}V1z"
    return paths
