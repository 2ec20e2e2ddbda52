"""The report as a page of text."""

from cageik_cli.coordinates.binding import WeightQuality
from cageik_cli.report.figures import (
    ReportSummary,
    format_change,
    format_length,
    format_metric,
    format_percent,
)
from cageik_cli.report.limits import (
    LimitCheck,
    format_limit_with_baseline,
    format_measured,
    make_verdict,
)
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import Vocabulary, choose_vocabulary
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.text import format_block, single_line


def format_text(report: Report) -> str:
    """A dozen lines: the headline first, then where it is worst, then how far to trust it."""
    clip, summary, words = report.clip, report.summary, choose_vocabulary(report.edited_from)
    headline = (
        f"{report.result}: {clip.frames} frames of {clip.vertices} vertices in a cage of "
        f"{clip.cage_vertices}, diagonal {clip.diagonal:.6g}"
    )
    rows = [
        *([] if report.edited_from is None else [("edited from", report.edited_from)]),
        (
            words.measure,
            f"{format_percent(summary.rms_percent)} % of the diagonal "
            f"(rms {format_length(summary.rms)})",
        ),
        (
            words.worst_frame,
            f"{format_percent(summary.worst_frame_rms_percent)} % at {summary.worst_frame}",
        ),
        (
            words.largest,
            f"{format_percent(summary.max_deviation_percent)} % "
            f"({format_length(summary.max_deviation)}) at vertex {summary.max_deviation_vertex} "
            f"of {summary.max_deviation_frame}",
        ),
        ("volume change", _format_volume(report, words)),
        *(_published_metrics_rows(summary) if words.has_published_metrics else []),
        (
            "size",
            f"{summary.floats_per_frame} numbers a frame instead of {3 * clip.vertices}, "
            f"and {summary.fixed_floats} weights once",
        ),
        *_quality_rows(report, words),
        *_skipped_rows(report),
        *(format_check_row(check, words) for check in report.gates),
        *(("note", note) for note in report.notes),
    ]
    return format_block(headline, rows)


def format_weights_row(quality: WeightQuality) -> tuple[str, str]:
    """How far weights can be trusted."""
    return "weights", (
        f"rows sum to 1 within {quality.partition_of_unity:.1e}, rest pose rebuilt within "
        f"{quality.linear_precision:.1e}, smallest {quality.min_weight:.1e}"
    )


def format_accuracy_row(quality: WeightQuality, accuracy: object) -> tuple[str, str]:
    """How far weights are from exact coordinates of their kind."""
    if not quality.panels:
        return "accuracy", "exact, in closed form"
    return "accuracy", (
        f"{accuracy}: {quality.panels} panels, mean row L1 error {quality.estimated_error:.1e} "
        "(estimated)"
    )


def format_check_row(check: LimitCheck, words: Vocabulary) -> tuple[str, str]:
    """The verdict on a figure, and what it was of: metric, what was found, limit, frame."""
    metric, verdict = words.limits[check.metric], make_verdict(check).text
    found, limit = (
        format_measured(check),
        f"limit {format_limit_with_baseline(check, f' {check.unit}')}",
    )
    if check.found is None:
        return verdict, f"{metric} {found}, {limit}"
    place = words.worst_frame if check.metric == "rms" else "at"
    return (
        verdict,
        f"{metric} {found} {check.unit}, {limit}, {place} {single_line(check.frame or '')}",
    )


def _skipped_rows(report: Report) -> list[tuple[str, str]]:
    """The frames that were, and why the first was; the record has all reasons."""
    frames = [frame for frame in report.frames if frame.skipped is not None]
    if not frames:
        return []
    names = join_truncated((frame.name for frame in frames), 5)
    return [
        ("skipped", f"{len(frames)} of {len(report.frames)} frames: {names}; {frames[0].skipped}")
    ]


def _published_metrics_rows(summary: ReportSummary) -> list[tuple[str, str]]:
    kg_error = _format_number(summary.kg_error)
    return [("literature", f"E_RMS {format_metric(summary.e_rms)}, KG error {kg_error}")]


def _quality_rows(report: Report, words: Vocabulary) -> list[tuple[str, str]]:
    quality = report.binding
    system = (
        f"condition number {quality.condition_number:.4g}, "
        f"alpha {_format_number(report.settings.get('alpha'))}, "
        f"beta {_format_number(report.settings.get('beta'))}"
    )
    accuracy = format_accuracy_row(quality, report.settings.get("accuracy"))
    return [format_weights_row(quality), accuracy, (words.system, system)]


def _format_volume(report: Report, words: Vocabulary) -> str:
    summary = report.summary
    change, drift = summary.volume_change_percent_max, summary.volume_drift_percent_max
    if change is None:
        return "not defined" if report.clip.closed else "not defined, the model is open"
    own = "unknown" if drift is None else f"{format_change(drift)} %"
    where = f"at {summary.volume_change_frame} ({words.drift}: {own})"
    return f"{format_change(change)} % at most, {where}"


def _format_number(value: object) -> str:
    return format_metric(value) if isinstance(value, int | float) else "unknown"
