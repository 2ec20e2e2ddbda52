"""The figures of a fit in a report: what it gains on which frames, and what they mean."""

from dataclasses import asdict, dataclass

import numpy as np

from cageik_cli.fit.settings import (
    MAX_EDIT_ROUGHNESS,
    MAX_HELD_OUT_BLOCKS,
    MAX_HELD_OUT_RATIO,
    MAX_ROUGHNESS,
    MIN_DISTINCT_FRAMES,
    MIN_STATED_PERCENT,
    Comparison,
    FitRecord,
    FitReport,
    StrengthLimit,
    TriedStrength,
)
from cageik_cli.report.figures import format_percent
from cageik_cli.store.result import Result, read_baseline_errors
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.messages import Hint, Row, Said, say
from cageik_cli.util.text import format_bytes, format_count, format_decimals, group_digits

_STRENGTH_REASONS = {
    StrengthLimit.FRAMES: f"of fewer than {MIN_DISTINCT_FRAMES} distinct frames, it stays smooth",
    StrengthLimit.NONE_ASIDE: "no frames can be kept aside to try others",
    StrengthLimit.MEMORY: "the memory limit has no room to try others",
    StrengthLimit.INFLUENCES: "with few influences, it stays smooth",
    StrengthLimit.EDITS: "a weaker one made edits of the cage in trials more than "
    f"{MAX_EDIT_ROUGHNESS:g} times as rough",
    StrengthLimit.KEPT_ASIDE: "a weaker one follows frames kept aside worse",
    StrengthLimit.GAIN: "a weaker one follows frames kept aside no better",
    StrengthLimit.LADDER: "no weaker one is tried",
}
"""Why a strength was chosen."""


def is_fitted_to_clip(result: Result) -> bool:
    """Return whether the weights were fitted to the clip of the result, and to no other."""
    if result.fit is None:
        return False
    frames = result.sources.get("frames")
    own = None if frames is None else frames.get("sha256")
    return [clip.sha256 for clip in result.fit.clips] == [own]


def measure_gap_closed(result: Result) -> float | None:
    """Return how much of the gap to the best possible error the fit closes, in percent.

    None if the weights are not fitted to this clip, or there is no gap, or a fit made it wider; and
    if that error is zero by counting.
    """
    bound = result.bound
    if result.fit is None or bound is None or bound.is_trivial or not is_fitted_to_clip(result):
        return None
    before, after = (
        error.rms for error in (result.fit.report.fitted.unfitted, result.fit.report.fitted.fitted)
    )
    gap = before - bound.rms_percent
    is_closer = gap > MIN_STATED_PERCENT and after <= before
    return 100 * (before - after) / gap if is_closer else None


def list_fit_notes(record: FitRecord) -> tuple[Said, ...]:
    """Return warnings and notes on a fit, one sentence each."""
    report = record.report
    held_out, notes = report.held_out_blocks, list[Said]()
    if report.needed_memory is not None:
        notes.append(
            f"the memory limit allowed {format_count(report.fitted_frames, 'frame')} to be "
            "fitted; a fit to more of them needs "
            + Hint("memory", format_bytes(report.needed_memory))
        )
    # A clip that only moves as a whole has none, and leaves nothing to choose.
    if report.limit is StrengthLimit.FRAMES and report.distinct_frames:
        distinct = format_count(report.distinct_frames, "distinct frame")
        notes.append(
            f"the fit has {distinct}, fewer than {MIN_DISTINCT_FRAMES}: too few to choose how "
            "close a fit may be, so it stays smooth; fit more motion, or "
            + Hint("fit_for", "play")
            + " if only these frames are played"
        )
    edits = None if record.settings.influences is not None else report.edits
    is_chosen = record.settings.use == "edit" and report.limit is not StrengthLimit.GIVEN
    if edits is not None and is_chosen and edits.largest > MAX_EDIT_ROUGHNESS:
        notes.append(
            f"edits of the cage are {edits.largest:.2f} times as rough as with the unfitted "
            f"weights (more than {MAX_EDIT_ROUGHNESS:g}); " + say("raise `fit_regularization=`")
        )
    if held_out is None:
        fitted = format_count(report.fitted_frames, "frame")
        notes.append(
            f"no frames were kept aside from the fit ({fitted} fitted): how well the fitted "
            "weights follow other frames is not known"
        )
    elif report.is_repetitive:
        notes.append(
            f"{report.copied_frames} of {format_count(held_out.frames, 'frame')} kept aside from "
            "the fit are nearly copies of fitted ones, so their error says nothing about other "
            "motion"
        )
    return (*notes, *_list_error_notes(report))


def _list_error_notes(report: FitReport) -> list[Said]:
    """Return notes on weights that follow the frames badly, or are rough."""
    held_out, notes = report.held_out_blocks, list[Said]()
    fitted, unfitted = report.fitted.fitted.rms, report.fitted.unfitted.rms
    if fitted > max(unfitted, MIN_STATED_PERCENT):
        notes.append(
            f"the fitted weights follow their frames less closely ({format_percent(fitted)} %) "
            f"than the unfitted ones ({format_percent(unfitted)} %); allow more influences"
        )
    elif held_out is not None and report.is_gainless:
        notes.append(
            "the fitted weights follow frames kept aside from the fit no better "
            f"({format_percent(held_out.fitted.rms)} %) than the unfitted ones "
            f"({format_percent(held_out.unfitted.rms)} %); fit more motion, or leave the fit out"
        )
    elif held_out is not None and report.is_overfitted:
        notes.append(
            f"the error of frames kept aside from the fit, "
            f"{format_percent(held_out.fitted.rms)} %, is more than {MAX_HELD_OUT_RATIO:g} times "
            f"that of fitted ones, {format_percent(fitted)} %: the weights follow other motion "
            "less closely; fit more motion if they are for other clips"
        )
    if report.roughness > MAX_ROUGHNESS:
        notes.append(
            f"the fitted weights are {report.roughness:.1f} times as rough as the unfitted "
            f"ones (more than {MAX_ROUGHNESS:g}); "
            + say("raise `fit_regularization=`, or allow more influences")
        )
    return notes


def format_fit_rows(record: FitRecord, is_verbose: bool = False) -> list[Row]:
    """Return labelled lines on a fit; `is_verbose` shows all strengths that were tried."""
    report, held_out = record.report, record.report.held_out_blocks
    kept_aside, third = "none", "none"
    # Of fitted ladders, these frames have chosen the strength.
    chosen = "; the strength was chosen on these" if report.ladder else ""
    if held_out is not None:
        blocks = min(MAX_HELD_OUT_BLOCKS, max((clip.frames for clip in record.clips), default=0))
        kept_aside = (
            f"{_format_comparison(held_out)}; every 2nd of {blocks} blocks, between the fitted "
            f"frames{chosen}"
        )
    if report.unseen_third is not None:
        third = f"{_format_comparison(report.unseen_third)}{chosen}"
    rows = [("fit", _describe_settings(record))]
    if report.limit is not StrengthLimit.GIVEN:
        rows.append(("strength", f"chosen; {_STRENGTH_REASONS[report.limit]}"))
    if is_verbose:
        rows += [("tried", _format_tried(one)) for one in report.ladder]
    if report.edits is not None:
        rows.append(
            (
                "edits",
                f"of the cage are {report.edits.smooth:.2f} times as rough as with the unfitted "
                f"weights, local ones {report.edits.local:.2f}",
            )
        )
    return [
        *rows,
        ("fitted frames", _format_comparison(report.fitted)),
        ("kept aside", kept_aside),
        ("last third", third),
        (
            "fitted weights",
            f"negative ones sum to {report.negative_per_row:.3f} per vertex, smallest "
            f"{report.min_weight:.3f}, {report.roughness:.2f} times as rough as the unfitted",
        ),
    ]


def _format_tried(one: TriedStrength) -> str:
    """Return a strength, and what it was measured by."""
    third = "" if one.last_third is None else f", last third {format_percent(one.last_third)} %"
    return (
        f"regularization {one.regularization:g}, smoothness {one.smoothness:g}: kept aside "
        f"{format_percent(one.held_out_blocks)} %{third}, edits {one.edits.smooth:.2f} and "
        f"{one.edits.local:.2f} times as rough"
    )


def format_fit_line(report: FitReport) -> str:
    """Return the errors of a fit in one line."""
    parts = {
        "fitted frames": report.fitted,
        "kept aside": report.held_out_blocks,
        "last third": report.unseen_third,
    }
    return "; ".join(
        f"{name} {format_percent(one.fitted.rms)} % (unfitted {format_percent(one.unfitted.rms)} %)"
        for name, one in parts.items()
        if one is not None
    )


def _describe_settings(record: FitRecord) -> str:
    settings, report = record.settings, record.report
    names = join_truncated(clip.name for clip in record.clips)
    parts = []
    for name, value in asdict(settings).items():
        if name in ("regularization", "smoothness"):
            parts.append(f"{name} {getattr(report, name):g}")
        elif name == "use":
            parts += [f"to {value} only"] if value == "play" else []
        elif name == "influences" and value is not None:
            parts.append(format_count(value, "influence"))
        elif value is not None:
            parts.append(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}")
    frames = format_count(report.frames, "frame")
    return f"{', '.join(parts)}; {group_digits(report.fitted_frames)} of {frames} of {names}"


def _format_comparison(comparison: Comparison) -> str:
    fitted, unfitted = comparison.fitted, comparison.unfitted
    return (
        f"{format_percent(fitted.rms)} % (99 % of deviations below "
        f"{format_decimals(fitted.percentile, 2)}, "
        f"largest {format_decimals(fitted.largest, 2)}); unfitted {format_percent(unfitted.rms)} % "
        f"({format_decimals(unfitted.percentile, 2)}, {format_decimals(unfitted.largest, 2)})"
    )


@dataclass(frozen=True, slots=True)
class BaselineErrorRecord:
    """The error of some frames with the weights before the fit.

    Attributes
    ----------
    coordinates : str
        The kind of the weights before the fit.
    frames : tuple of int
        Numbers of the frames that were measured.
    rms_percent : tuple of float
        The rms of each, percent of the diagonal.
    mean_rms_percent, fitted_rms_percent : float
        The rms over these frames, with the weights before and after the fit.
    """

    coordinates: str
    frames: tuple[int, ...]
    rms_percent: tuple[float, ...]
    mean_rms_percent: float
    fitted_rms_percent: float


def build_baseline_errors(result: Result) -> BaselineErrorRecord | None:
    """Build the record of a result; None if it does not hold the errors before a fit."""
    if result.fit is None:
        return None
    clip = read_baseline_errors(result)
    if clip is None:
        return None
    percent = 100 / result.rest.diagonal
    before, after = percent * clip.rms, percent * result.metrics.rms[clip.frames]
    return BaselineErrorRecord(
        coordinates=str(result.settings.get("coordinates", "harmonic")),
        frames=tuple(clip.frames.tolist()),
        rms_percent=tuple(before.tolist()),
        mean_rms_percent=float(np.sqrt(np.mean(before**2))),
        fitted_rms_percent=float(np.sqrt(np.mean(after**2))),
    )
