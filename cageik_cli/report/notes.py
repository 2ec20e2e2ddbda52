"""What stands out of a result, found without being asked: notes, a verdict, and a step that helps.

Each note compares a measure with a threshold, and says both.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.captured.robust import MIN_OUTLIER_RATIO, average_neighbours
from cageik_cli.captured.settings import AUTO_SMOOTHING
from cageik_cli.geometry.mesh import signed_volumes
from cageik_cli.geometry.parts import name_vertex
from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.figures import ReportSummary, format_briefly, format_percent
from cageik_cli.report.fit_rows import list_fit_notes
from cageik_cli.report.limits import Limits, list_baseline_notes, list_limit_notes
from cageik_cli.report.regions import list_region_notes
from cageik_cli.store.result import (
    Result,
    StoredAnimation,
    read_binding,
    read_cages,
    read_key_frames,
)
from cageik_cli.store.tried_steps import Step, TriedStep
from cageik_cli.util.arrays import Floats, Integers, Mask
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.messages import Hint, Note, Said, Text, say
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.units import LONG_UNIT_NAMES, PROGRAM_UNITS, find_units_of_ratio

MIN_DATA_PER_CAGE_VERTEX = 2
"""Vertices that are data, per cage vertex, below which the error is noted as too small.

On samba with cages of 60 to 300, and only some vertices as data, the error of the others is 8 to 10
times that of the data at 1 per cage vertex, 5 times at 1.5, 2.5 to 3 times at 2, 1.5 to 1.9 times
at 3, and 1.1 times at 10.
"""

MIN_OUTLIER_FRAMES = 8
"""Frames of the shortest clip out of which a frame can stand."""

MAX_MIRRORED_SHARE = -0.5
"""Frames with less volume, in that of the rest pose, are mirrored."""

MAX_SPREAD_RATIO = 2.0
"""Frames that are more times as large as the rest pose, or as small, are of another size."""

SPREAD_RATIO_TOL = 0.1
"""How far a ratio of sizes may be from that of two units, as a share: poses differ, too."""

MIN_SPIKE_RATIO = 25.0
"""Frames are named whose largest deviation is more than this many median rms,"""

MIN_SPIKE_PERCENT = 3.0
"""and more than this percentage of the diagonal."""

MIN_JUMP_RATIO = 12.0
"""Acceleration of the cage of a frame that jumps, in medians."""

HELD_TOL = 1e-9
"""Cages that differ by less, in diagonals, are copies."""

MAX_HELD_SHARE = 0.1
"""Clips with a larger share of copies are held on purpose, or on twos."""

MIN_OUTLIER_PERCENT = 1.0
"""Vertices are named as isolated outliers whose rms is above this percentage of the diagonal."""

MAX_GOOD_RMS = 0.3
"""Percent of the diagonal; above this rms, a result is fair at best.

The bounds were chosen by looking at the worst frames of a dancer, a horse and a cartoon chicken
beside their input. At 0.16 and 2.4 % they look alike. At 0.6 and 6.4 % a hoof or a finger has
another shape, which is seen if one looks for it. At 0.64 and 8 % legs are visibly deformed.
"""

MAX_GOOD_DEVIATION = 3.0
"""Percent of the diagonal; above this largest deviation, a result is fair at best."""

MAX_FAIR_RMS = 0.75
"""Percent of the diagonal; above this rms, a result is poor."""

MAX_FAIR_DEVIATION = 7.0
"""Percent of the diagonal; above this largest deviation, a result is poor."""

MAX_ROUGH_SHARE = 0.7
"""Share of the squared errors by which vertices differ from the mean of their neighbours, at most,
where more cage vertices are advised. It is 7/6 for noise on a mesh with six edges at each vertex,
and 0.03 to 0.46 in clean clips of six models.
"""

MAX_ADVISED_VERTICES = 400
"""Vertices of a cage that are advised, at most: by hand, one poses fewer."""


def list_notes(
    result: StoredAnimation,
    name: str,
    digest: str | None,
    summary: ReportSummary,
    limits: Limits,
) -> tuple[Note, ...]:
    """List all notes; a baseline knows the result by `name`, or by the digest of its frames.

    Warnings come first, then notes on how good a result is, then those on the files it came from.

    Nothing stands out of an edit: how far it moves what is up to who made it.
    """
    clip: list[Said] = []
    outliers: list[Said] = []
    if isinstance(result, Result):
        clip = [*list_clip_notes(result), *list_region_notes(result, summary)]
        outliers = list_outlier_notes(result)
    found: tuple[Said, ...] = (
        *([] if result.fit is None else list_fit_notes(result.fit)),
        *clip,
        *list_limit_notes(limits, result.rest.diagonal),
        *outliers,
        *list_baseline_notes(name, digest, summary, limits),
    )
    every = (*map(Note, found), *result.notes)
    return tuple(sorted(every, key=lambda note: note.kind != "warning"))


def list_clip_notes(result: Result) -> list[Said]:
    """List notes on the frames as a whole and on their vertices."""
    return [
        *_note_mirrored_frames(result),
        *_note_other_size(result),
        *_note_few_vertices(result),
    ]


def list_outlier_notes(result: Result) -> list[Said]:
    """Say which frames and vertices stand out, by how much, and which option would help."""
    is_long = len(result.frames) - len(result.skipped) >= MIN_OUTLIER_FRAMES
    return [
        *_note_rejection(result),
        *(_note_spikes(result) if is_long else []),
        *(_note_motion(result) if is_long else []),
        *_note_isolated_outliers(result),
    ]


def _note_mirrored_frames(result: Result) -> Iterator[Said]:
    """Say which frames have less volume than `MAX_MIRRORED_SHARE` times that of the rest pose."""
    shares = _measure_volume_shares(result)
    known = np.flatnonzero(np.isfinite(shares))
    mirrored = known[shares[known] < MAX_MIRRORED_SHARE]
    if len(mirrored):
        yield (
            f"{group_digits(len(mirrored))} of {group_digits(len(result.frames))} frames are "
            "mirrored relative to the rest "
            f"pose ({_name_frames(result, mirrored)}): their volume has the other sign; a scale "
            "of -1 or another handedness of the axes in the export is the likely cause"
        )


def _measure_volume_shares(result: Result) -> Floats:
    """Return the signed volume of each frame relative to the rest pose; nan where unknown.

    Of a model that has none, it is that of the cage, which turns inside out with it.
    """
    volumes = result.metrics.volume
    if np.isfinite(volumes).any():
        return np.asarray(volumes / result.rest.volume)
    blocks = read_cages(result, size=256)
    shares = np.concatenate([signed_volumes(block, result.cage.faces) for block in blocks])
    shares[list(result.skipped)] = np.nan
    return np.asarray(shares / result.cage.volume)


def _note_other_size(result: Result) -> Iterator[Said]:
    """Say so if the frames are of another size than the rest pose, and which units explain it."""
    points = result.rest.vertices[np.isfinite(result.vertex_rms)]
    spread = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if not spread > 0:
        return
    ratio = float(np.nanmedian(result.metrics.spread)) / spread
    if 1 / MAX_SPREAD_RATIO <= ratio <= MAX_SPREAD_RATIO:
        return
    size = f"{ratio:.3g} times as large as" if ratio > 1 else f"{1 / ratio:.3g} times smaller than"
    cause = "one is likely in another unit, or of another model"
    units = find_units_of_ratio(ratio, SPREAD_RATIO_TOL)  # nearly: poses differ in size, too
    if units is not None:
        rarer, usual = sorted(units, key=PROGRAM_UNITS.index, reverse=True)
        names = f"{LONG_UNIT_NAMES[rarer]} and {LONG_UNIT_NAMES[usual]}"
        cause = f"one is likely in another unit ({names})"
    yield (
        f"the frames are {size} the rest pose in the median, by their spread about the centroid; "
        f"{cause}, and the figures compare them with the diagonal of the rest pose"
    )


def _note_few_vertices(result: Result) -> Iterator[Said]:
    """Say so if hardly more vertices are data than the cage has."""
    data, points = int(np.isfinite(result.vertex_rms).sum()), len(result.cage.vertices)
    if data < MIN_DATA_PER_CAGE_VERTEX * points:
        yield (
            f"{group_digits(data)} vertices of the model are data, and the cage has {points}: "
            "with fewer than "
            f"{MIN_DATA_PER_CAGE_VERTEX} per cage vertex the cage follows them more closely than "
            "the surface between them, so the error is too small; take a smaller cage or a denser "
            "model"
        )


def _note_rejection(result: Result) -> Iterator[Said]:
    """Say that the input has outliers, and what rejecting them gains, if that has helped."""
    for step, found, what in (
        (Step.ROBUST, "single vertices of the input are outliers among their neighbours", "them"),
        (Step.TORN, "pieces of the input jump apart from the surface around them", "what is torn"),
    ):
        tried = find_tried(result, step)
        if tried is None:
            continue
        if tried.has_helped:
            yield (
                f"{found}; without {what}, the "
                f"error of the others is {format_percent(tried.after_percent)} % in place of "
                f"{format_percent(tried.before_percent)} % in {tried.frames} frames; "
                + say("reject them by `robust=True`")
            )
        elif step == Step.TORN:
            yield (
                f"{found}, in most frames; errors are measured to them, and how far off the model "
                "is itself is not known: mend the input"
            )


def _note_spikes(result: Result) -> Iterator[Said]:
    """Name frames in which single vertices are outliers."""
    found = np.flatnonzero(_find_spikes(result))
    if len(found) and _has_outlier_vertex(result):
        metrics, percent = result.metrics, 100 / result.rest.diagonal
        largest = percent * np.nan_to_num(metrics.max_deviation)
        middle = percent * float(np.nanmedian(metrics.rms))
        worst = int(found[largest[found].argmax()])
        yield (
            f"{format_count(len(found), 'frame')} with vertices far away, up to "
            f"{format_percent(largest[worst])} % in {result.frames[worst]} (median error "
            f"{format_percent(middle)} %): {_name_frames(result, found)}"
        )


def _find_spikes(result: Result) -> Mask:
    """Return the frames whose largest deviation is far above the median rms, (F,).

    None of a result that was solved robustly, where outlier vertices have no weight.
    """
    metrics, percent = result.metrics, 100 / result.rest.diagonal
    if result.kept is not None and result.settings.get("robust"):
        return np.zeros(len(result.frames), bool)
    largest = percent * np.nan_to_num(metrics.max_deviation)
    middle = percent * float(np.nanmedian(metrics.rms))
    return np.asarray((largest > MIN_SPIKE_RATIO * middle) & (largest > MIN_SPIKE_PERCENT))


def _has_outlier_vertex(result: Result) -> bool:
    """Return whether the furthest vertex of the frames that are kept in full is off by itself.

    Its neighbours tell: a limb that the cage cannot follow deviates as a whole. False if the result
    does not hold its weights, which are needed to know.
    """
    binding = read_binding(result)
    if binding is None:
        return False
    sizes = np.linalg.norm(np.nan_to_num(read_key_frames(result, binding).errors), axis=-1)
    frame, worst = np.unravel_index(sizes.argmax(), sizes.shape)
    around = average_neighbours(result.rest, sizes[frame])[worst]
    return bool(sizes[frame, worst] > MIN_OUTLIER_RATIO * around)


def _note_motion(result: Result) -> Iterator[Said]:
    """Name frames that jump, and frames that are copies of the one before."""
    sizes, steps = _measure_motion(result)
    known = np.ones(len(result.frames), bool)
    known[list(result.skipped)] = False
    middle = float(np.median(sizes[sizes > 0])) if (sizes > 0).any() else 0.0
    is_jump = (sizes > MIN_JUMP_RATIO * middle) & known
    # The acceleration is large beside a jump, too: the frame of the largest one counts.
    peaks = np.flatnonzero(
        is_jump & (sizes >= np.roll(sizes, 1)) & (sizes >= np.roll(sizes, -1)) & (middle > 0)
    )
    if len(peaks):
        worst = int(peaks[sizes[peaks].argmax()])
        yield (
            f"{format_count(len(peaks), 'frame')} where the motion jumps, most in "
            f"{result.frames[worst]} ({sizes[worst] / middle:.0f} times the median "
            f"acceleration): {_name_frames(result, peaks)}; " + say("smooth them by `smooth=auto`")
        )
    held = np.flatnonzero((steps <= HELD_TOL * result.rest.diagonal) & known)
    if 0 < len(held) <= MAX_HELD_SHARE * len(steps):
        yield (
            f"{format_count(len(held), 'frame')} the same as the one before: "
            f"{_name_frames(result, held)}; "
            + say("if they were lost, leave them out, and fill them by `fill_gaps=True`")
        )


def _measure_motion(result: Result) -> tuple[Floats, Floats]:
    """Return acceleration and largest step to the frame before, of each cage, (F,) each."""
    count = len(result.frames)
    sizes, steps = np.zeros(count), np.full(count, np.inf)
    last = np.empty((0, *result.cage.vertices.shape))
    start = 0
    for block in read_cages(result, size=64):
        cages = np.concatenate([last, block])
        first = start - len(last)
        bends = np.sqrt((np.diff(cages, 2, axis=0) ** 2).mean(axis=(1, 2)))
        sizes[first + 1 : first + 1 + len(bends)] = bends
        moved = np.abs(np.diff(cages, axis=0)).max(axis=(1, 2))
        steps[first + 1 : first + 1 + len(moved)] = moved
        start, last = start + len(block), cages[-2:]
    return sizes, steps


def _note_isolated_outliers(result: Result) -> Iterator[Said]:
    """Name vertices whose rms is far above that of their neighbours."""
    found = np.flatnonzero(_find_isolated_outliers(result))
    if len(found):
        rms, percent = result.vertex_rms, 100 / result.rest.diagonal
        around = average_neighbours(result.rest, rms)
        worst = int(found[rms[found].argmax()])
        numbers = join_truncated(map(str, found.tolist()))
        yield (
            f"{format_count(len(found), 'vertex')} moving unlike the neighbours: {numbers}; "
            f"vertex {name_vertex(result.rest, worst)} is off by "
            f"{format_percent(percent * rms[worst])} %, those around it by "
            f"{format_percent(percent * around[worst])} %; "
            + say("if the input is wrong there, give them the weight 0 by `vertex_weights=`")
        )


def _find_isolated_outliers(result: Result) -> Mask:
    """Return the vertices whose rms is far above that of their neighbours, (m,).

    None if some have no data.
    """
    rms, percent = result.vertex_rms, 100 / result.rest.diagonal
    if not np.isfinite(rms).all():
        return np.zeros(len(rms), bool)
    around = average_neighbours(result.rest, rms)
    return np.asarray((rms > MIN_OUTLIER_RATIO * around) & (percent * rms > MIN_OUTLIER_PERCENT))


def _name_frames(result: Result, frames: Integers) -> str:
    return join_truncated(result.frames[k] for k in frames.tolist())


def judge_quality(rms_percent: float, max_deviation_percent: float) -> str:
    """Return a key of `QUALITY_WORDS`; both errors are in percent of the diagonal.

    They are compared as they are shown beside the word.
    """
    rms_percent, max_deviation_percent = (
        float(format_briefly(error)) for error in (rms_percent, max_deviation_percent)
    )
    if rms_percent <= MAX_GOOD_RMS and max_deviation_percent <= MAX_GOOD_DEVIATION:
        return "good"
    if rms_percent <= MAX_FAIR_RMS and max_deviation_percent <= MAX_FAIR_DEVIATION:
        return "fair"
    return "poor"


def is_invisible(rms_percent: float, max_deviation_percent: float) -> bool:
    """Return whether both errors, in percent of the diagonal, are far below what can be seen."""
    return 2 * rms_percent <= MAX_GOOD_RMS and 2 * max_deviation_percent <= MAX_GOOD_DEVIATION


@dataclass(frozen=True, slots=True)
class Advice:
    """A step that would lower the error, and what it has gained on some frames if it was tried."""

    step: Text
    gain: TriedStep | None = None


def suggest_step(result: Result, rms_percent: float, max_deviation_percent: float) -> Advice | None:
    """Return the one step that would lower the error most and is not taken yet.

    None if there is none, or the error is far below what can be seen. It is a step that was tried
    on some frames of the clip and has helped, or that cannot hurt. Parameters are keywords in
    backticks, as in messages, and all that is to be given.
    """
    smooth = find_tried(result, Step.SMOOTH)
    if smooth is not None and smooth.has_helped:
        return Advice(_describe_step(Step.SMOOTH, result), smooth)
    if is_invisible(rms_percent, max_deviation_percent):
        return None
    # Weights of a cage that is built are fitted, unless the input has outliers.
    is_fitted = result.fit is not None or find_tried(result, Step.FIT) is not None
    is_clean = not any(find_tried(result, step) for step in (Step.ROBUST, Step.TORN))
    can_build = is_fitted and is_clean and _has_smooth_errors(result)
    region, is_built = result.worst_region, _has_built_cage(result)
    is_loose = region is not None and region.cause == Cause.LOOSE_CAGE
    if is_loose and not is_built and can_build:
        count = len(result.cage.vertices)
        more = Hint("vertices", count) if count > BuildSettings().vertices else ""
        place = ", without " + _name_cage_source(result) + ": a tighter cage is built"
        return Advice(_repeat(more, place))
    helpful = [one for one in result.tried if one.has_helped]
    if helpful:
        best = min(helpful, key=lambda one: one.after_percent / one.before_percent)
        return Advice(_describe_step(best.step, result), best)
    return _suggest_vertices(result) if result.fit is not None and can_build else None


def _describe_step(step: Step, result: Result) -> Text:
    """Say how to take a step that was tried."""
    if step in (Step.ROBUST, Step.TORN):
        return _repeat(say("`robust=True`"))
    if step == Step.ROBUST_FIT:
        return _repeat(say("`robust=True` `fit=True`"))
    if step == Step.SMOOTH:
        return _repeat(Hint("smooth", AUTO_SMOOTHING))
    if "binding" in result.sources:
        return say("bind again with `fit=FRAMES`, then extract with that `binding=`")
    return _repeat(say("`fit=True`"))


def find_tried(result: Result, step: Step) -> TriedStep | None:
    """Return how a step has gone that the run has tried; None if it has not."""
    return next((one for one in result.tried if one.step == step), None)


def _has_smooth_errors(result: Result) -> bool:
    """Return whether errors are alike in neighbours, in the frames that are kept in full.

    Then a cage of more vertices can follow them. Those of noise and of outliers differ from vertex
    to vertex, and a cage that follows them more closely is no better. False if vertices are missing
    or rejected, or the result does not hold its weights.
    """
    binding = None if result.kept is not None else read_binding(result)
    if binding is None:
        return False
    errors = np.nan_to_num(read_key_frames(result, binding).errors)
    rough = [
        error - np.stack([average_neighbours(result.rest, column) for column in error.T], axis=1)
        for error in errors
    ]
    return bool(np.square(rough).sum() <= MAX_ROUGH_SHARE * np.square(errors).sum())


def _repeat(step: Said, condition: Said = "") -> Text:
    """Say how the run that made the result is repeated with a step; the result is replaced."""
    steps = "extract again with " + step + " " if step else "extract again with "
    return steps + say("`overwrite=True`") + condition


def _has_built_cage(result: Result) -> bool:
    return "cage_vertices" in result.settings


def _name_cage_source(result: Result) -> Text:
    """Return the parameter by which the cage was given."""
    return say("`binding=`") if "binding" in result.sources else say("`cage=`")


def _suggest_vertices(result: Result) -> Advice | None:
    """Return the advice of twice as many cage vertices, if the model has data for them.

    It cannot hurt where their weights are fitted to the clip, and what is missed is no noise.
    """
    data = len(result.rest.vertices) // MIN_DATA_PER_CAGE_VERTEX
    count = min(2 * len(result.cage.vertices), MAX_ADVISED_VERTICES)
    if count <= len(result.cage.vertices) or count > data:
        return None
    place = "" if _has_built_cage(result) else ", without " + _name_cage_source(result)
    return Advice(_repeat(Hint("vertices", count), place))
