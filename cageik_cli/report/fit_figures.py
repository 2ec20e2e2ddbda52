"""The figures of a fit in a report: what it gains on which frames, and what they mean."""

from cageik_cli.report.figures import format_percent
from cageik_cli.solver.fitting.held_out import HELD_OUT_BLOCKS, Comparison
from cageik_cli.solver.fitting.record import (
    MAX_HELD_OUT_RATIO,
    FitRecord,
    FitReport,
)
from cageik_cli.store.result import Result
from cageik_cli.util.errors import join_truncated

MAX_NAMED_CLIPS = 3
"""Clips that a report names."""

Row = tuple[str, str]


def is_fitted_to_clip(result: Result) -> bool:
    """Return whether the weights were fitted to the clip of the result, and to no other."""
    if result.fit is None or result.edited_from is not None:
        return False
    own = result.sources.get("frames", {}).get("sha256")
    return [clip.sha256 for clip in result.fit.clips] == [own]


def measure_gap_closed(result: Result) -> float | None:
    """Return how much of the gap to the best possible error the fit closes, in percent.

    None if the weights are not fitted to this clip, or leave no gap.
    """
    if result.fit is None or result.bound is None or not is_fitted_to_clip(result):
        return None
    before, after = (
        error.rms for error in (result.fit.report.fitted.unfitted, result.fit.report.fitted.fitted)
    )
    gap = before - result.bound.rms_percent
    return 100 * (before - after) / gap if gap > 0 else None


def list_fit_notes(record: FitRecord) -> tuple[str, ...]:
    """Return warnings and notes on a fit, one sentence each."""
    report, notes = record.report, []
    if report.held_out_blocks is None:
        notes.append(
            "the clips are too short to hold frames out: how well the fitted weights follow other "
            "frames is not known"
        )
    elif report.is_repetitive:
        notes.append(
            f"{report.copied_frames} of {report.held_out_blocks.frames} held-out frames are nearly "
            "copies of fitted ones, so the held-out error says nothing about other motion"
        )
    if report.held_out_blocks is not None and report.is_overfitted:
        ratio = report.held_out_blocks.fitted.rms / report.fitted.fitted.rms
        notes.append(
            f"the error of held-out frames is {ratio:.1f} times that of fitted ones (more than "
            f"{MAX_HELD_OUT_RATIO:g}): the weights follow other motion less closely; fit more "
            "motion if they are for other clips"
        )
    return tuple(notes)


def format_fit_rows(record: FitRecord, is_verbose: bool = False) -> list[Row]:
    """Return labelled lines on a fit; `is_verbose` shows all regularizations that were tried."""
    report = record.report
    return [
        ("fit", _describe_settings(record)),
        *([("tried", _format_curve(report))] if is_verbose and report.curve else []),
        ("fitted frames", _format_comparison(report.fitted)),
        ("held out", _format_held_out(report.held_out_blocks)),
        ("last third", _format_comparison(report.unseen_third) if report.unseen_third else "none"),
        (
            "fitted weights",
            f"negative ones sum to {report.negative_per_row:.3f} per vertex, smallest "
            f"{report.min_weight:.3f}, roughness {report.roughness:.2f} of the unfitted",
        ),
    ]


def format_fit_line(report: FitReport) -> str:
    """Return the errors of a fit in one line."""
    parts = {
        "fitted frames": report.fitted,
        "held out": report.held_out_blocks,
        "last third": report.unseen_third,
    }
    return "; ".join(
        f"{name} {format_percent(one.fitted.rms)} % (unfitted {format_percent(one.unfitted.rms)} %)"
        for name, one in parts.items()
        if one is not None
    )


def _describe_settings(record: FitRecord) -> str:
    settings, report = record.settings, record.report
    names = join_truncated((clip.name for clip in record.clips), MAX_NAMED_CLIPS)
    strength = f"{report.regularization:g}"
    if settings.regularization is None:
        strength += " (auto)"
    parts = [f"regularization {strength}", f"smoothness {settings.smoothness:g}"]
    parts += [] if settings.rank is None else [f"rank {settings.rank}"]
    parts += [] if settings.influences is None else [f"{settings.influences} influences"]
    return f"{', '.join(parts)}; {report.fitted_frames} of {report.frames} frames of {names}"


def _format_curve(report: FitReport) -> str:
    tried = (f"{strength:g}: {format_percent(error)} %" for strength, error in report.curve)
    return f"held-out error by regularization: {', '.join(tried)}"


def _format_comparison(comparison: Comparison) -> str:
    fitted, unfitted = comparison.fitted, comparison.unfitted
    return (
        f"{format_percent(fitted.rms)} % (99 % below {fitted.percentile:.2f}, largest "
        f"{fitted.largest:.2f}); unfitted {format_percent(unfitted.rms)} % "
        f"({unfitted.percentile:.2f}, {unfitted.largest:.2f})"
    )


def _format_held_out(comparison: Comparison | None) -> str:
    if comparison is None:
        return "none, the clips are too short"
    return f"{_format_comparison(comparison)}; every 2nd of {HELD_OUT_BLOCKS} blocks"
