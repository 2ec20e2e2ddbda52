"""Frames and vertices that stand out of a clip, found in its result without being asked."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.figures import format_percent
from cageik_cli.store.result import Result, read_cages
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.text import format_count

MIN_FRAMES = 8
"""Frames of the shortest clip out of which a frame can stand."""

SPIKE_RATIO, SPIKE_PERCENT = 25.0, 3.0
"""A frame has spikes if its largest deviation is above so many median rms, and so many percent."""

JUMP_RATIO = 12.0
"""A frame jumps if the acceleration of its cage is above so many medians."""

HOLD_TOL = 1e-9
"""Cages that differ by less, in diagonals, are copies."""

MAX_HOLD_SHARE = 0.1
"""Clips with more copies than this share are held on purpose, or on twos."""

VERTEX_RATIO, VERTEX_PERCENT = 8.0, 1.0
"""A vertex stands out if its rms is above so many of its neighbours', and so many percent."""

BLOCK = 64


def list_standout_notes(result: Result) -> list[str]:
    """Say which frames and vertices stand out, by how much, and which option would help."""
    if result.edited_from is not None:
        return []
    notes = _list_vertex_notes(result)
    if len(result.frames) - len(result.skipped) >= MIN_FRAMES:
        notes = [*_list_spike_notes(result), *_list_motion_notes(result), *notes]
    return notes


def _list_spike_notes(result: Result) -> list[str]:
    metrics, percent = result.metrics, 100 / result.rest.diagonal
    if result.kept is not None and result.settings.get("robust"):
        return []
    largest = percent * np.nan_to_num(metrics.max_deviation)
    middle = percent * float(np.nanmedian(metrics.rms))
    found = np.flatnonzero((largest > SPIKE_RATIO * middle) & (largest > SPIKE_PERCENT))
    if not len(found):
        return []
    worst = int(found[largest[found].argmax()])
    return [
        f"{format_count(len(found), 'frame')} with vertices far away, up to "
        f"{format_percent(largest[worst])} % in {result.frames[worst]} (median error "
        f"{format_percent(middle)} %): {_name(result, found)}; reject them by --robust"
    ]


def _list_motion_notes(result: Result) -> list[str]:
    """Find frames that jump, and frames that are copies of the one before."""
    sizes, steps = _measure_motion(result)
    known = np.ones(len(result.frames), bool)
    known[list(result.skipped)] = False
    notes = []
    middle = float(np.median(sizes[sizes > 0])) if (sizes > 0).any() else 0.0
    is_jump = (sizes > JUMP_RATIO * middle) & known
    # The acceleration is large beside a jump, too: the frame of the largest one counts.
    peaks = np.flatnonzero(
        is_jump & (sizes >= np.roll(sizes, 1)) & (sizes >= np.roll(sizes, -1)) & (middle > 0)
    )
    if len(peaks):
        worst = int(peaks[sizes[peaks].argmax()])
        notes.append(
            f"{format_count(len(peaks), 'frame')} where the motion jumps, most in "
            f"{result.frames[worst]} ({sizes[worst] / middle:.0f} times the median acceleration): "
            f"{_name(result, peaks)}; smooth them by --smooth auto"
        )
    held = np.flatnonzero((steps <= HOLD_TOL * result.rest.diagonal) & known)
    if 0 < len(held) <= MAX_HOLD_SHARE * len(steps):
        notes.append(
            f"{format_count(len(held), 'frame')} the same as the one before: "
            f"{_name(result, held)}; if they were lost, leave them out, and fill them by "
            "--fill-gaps"
        )
    return notes


def _measure_motion(result: Result) -> tuple[Floats, Floats]:
    """Return acceleration and largest step to the frame before, of each cage, (F,) each."""
    count = len(result.frames)
    sizes, steps = np.zeros(count), np.full(count, np.inf)
    last = np.empty((0, *result.cage.vertices.shape))
    start = 0
    for block in read_cages(result, BLOCK):
        cages = np.concatenate([last, block])
        first = start - len(last)
        bends = np.sqrt((np.diff(cages, 2, axis=0) ** 2).mean(axis=(1, 2)))
        sizes[first + 1 : first + 1 + len(bends)] = bends
        moved = np.abs(np.diff(cages, axis=0)).max(axis=(1, 2))
        steps[first + 1 : first + 1 + len(moved)] = moved
        start, last = start + len(block), cages[-2:]
    return sizes, steps


def _list_vertex_notes(result: Result) -> list[str]:
    """Find vertices that deviate far more than their neighbours: they do not move with them."""
    rms, percent = result.vertex_rms, 100 / result.rest.diagonal
    if not np.isfinite(rms).all():
        return []
    around = _average_neighbours(result.rest, rms)
    found = np.flatnonzero((rms > VERTEX_RATIO * around) & (percent * rms > VERTEX_PERCENT))
    if not len(found):
        return []
    worst = int(found[rms[found].argmax()])
    numbers = join_truncated(map(str, found.tolist()), 5)
    return [
        f"{format_count(len(found), 'vertex')} moving unlike the neighbours: {numbers}; vertex "
        f"{worst} is off by {format_percent(percent * rms[worst])} %, those around it by "
        f"{format_percent(percent * around[worst])} %; reject them by --robust, or give them the "
        "weight 0 by --vertex-weights"
    ]


def _average_neighbours(mesh: TriMesh, values: Floats) -> Floats:
    """Return the mean of the values of each vertex's neighbours; its own if it has none."""
    first, second = mesh.edges.ends.T
    own = np.concatenate([first, second])
    others = values[np.concatenate([second, first])]
    counts = np.bincount(own, minlength=len(values))
    sums = np.bincount(own, others, minlength=len(values))
    return np.asarray(np.where(counts > 0, sums / np.maximum(counts, 1), values))


def _name(result: Result, frames: Integers) -> str:
    return join_truncated((result.frames[k] for k in frames.tolist()), 5)
