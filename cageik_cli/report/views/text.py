"""The report as text for a terminal."""

from cageik_cli.method.weights.binding import WeightQuality
from cageik_cli.report.figures import (
    describe_kept,
    describe_size,
    explain_missing_volume,
    format_change,
    format_length,
    format_metric,
    format_percent,
)
from cageik_cli.report.fit_rows import format_fit_rows
from cageik_cli.report.limits import LimitCheck
from cageik_cli.report.record import Report
from cageik_cli.report.regions import (
    describe_region,
    explain_regions,
    format_part_rows,
    label_vertex,
    list_remedies,
)
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.messages import Row, Spelling, spell, spell_keyword
from cageik_cli.util.text import (
    format_block,
    format_count,
    format_decimals,
    group_digits,
    single_line,
)


def format_text(
    report: Report, is_verbose: bool = False, spelling: Spelling = spell_keyword
) -> str:
    """Write a dozen lines: the clip, its errors, their worst places, and how far to trust them.

    `is_verbose` adds what a fit has tried. Settings are written as `spelling` does.
    """
    clip, summary, words = report.clip, report.summary, report.vocabulary
    headline = (
        f"{report.result}: {format_count(clip.frames, 'frame')} of "
        f"{format_count(clip.vertices, 'vertex')} in a cage of {clip.cage_vertices}, "
        f"diagonal {format_length(clip.diagonal)}"
    )
    size = describe_size(clip, summary.fixed_floats)
    e_rms, kg_error = format_metric(summary.e_rms), _format_number(summary.kg_error)
    published = (
        f"to compare with papers: E_RMS {e_rms} (Kavan et al. 2010), KG error {kg_error} (Karni "
        "and Gotsman 2004)"
    )
    rows = [
        *report.origin_rows,
        *_error_rows(report),
        *format_part_rows(report.parts, words.worst),
        *describe_kept(report.kept, clip.vertices),
        *_bound_rows(report),
        ("volume change", _format_volume(report, words)),
        *([("metrics", published)] if words.has_published_metrics else []),
        ("size", f"{group_digits(summary.floats_per_frame)} floats per frame {size}"),
        *_quality_rows(report, words),
        *([] if report.fit is None else format_fit_rows(report.fit, is_verbose)),
        *_skipped_rows(report),
        *_region_rows(report),
        *(format_check_row(check, words) for check in report.gates),
        *(note.row for note in report.notes),
    ]
    return format_block(headline, [(label, spell(text, spelling)) for label, text in rows])


def _error_rows(report: Report) -> list[Row]:
    summary, words = report.summary, report.vocabulary
    by_area = []  # does not depend on how densely parts are cut
    if summary.area_rms is not None and summary.area_rms_percent is not None:
        percent = format_percent(summary.area_rms_percent)
        by_area = [("by area", f"{percent} % (rms {format_length(summary.area_rms)})")]
    return [
        (
            words.measure,
            f"{format_percent(summary.rms_percent)} % of the diagonal "
            f"(rms {format_length(summary.rms)})",
        ),
        *by_area,
        (
            "by radius",
            f"{format_percent(summary.radius_rms_percent)} % of the radius of the smallest sphere "
            f"around the rest pose ({format_length(report.clip.radius)})",
        ),
        (
            words.worst_frame,
            f"{format_percent(summary.worst_frame_rms_percent)} % at {summary.worst_frame}",
        ),
        (
            words.largest,
            f"{format_percent(summary.max_deviation_percent)} % "
            f"({format_length(summary.max_deviation)}) at vertex "
            f"{label_vertex(report.parts, summary.max_deviation_vertex)} "
            f"of {summary.max_deviation_frame}",
        ),
    ]


def _bound_rows(report: Report) -> list[Row]:
    """Say which error weights cannot be below, and how much of the way to it a fit takes."""
    bound, closed = report.bound, report.summary.gap_closed_percent
    if bound is None or bound.is_trivial:
        return []
    total = report.clip.vertices
    where = (
        ""
        if bound.vertices >= total
        else f", measured on {group_digits(bound.vertices)} of {group_digits(total)} vertices"
    )
    text = f"{format_percent(bound.rms_percent)} % with any weights and cages{where}"
    if closed is not None:
        share = format_decimals(closed, 0)
        text += f"; the fit takes {share} % of the way from the unfitted error to it"
    return [("best possible", text)]


def format_weights_row(quality: WeightQuality, has_offsets: bool = False) -> tuple[str, str]:
    """Return the row on how exact the weights are; offsets make the rest pose exact."""
    rest = "offsets of the rest pose up to" if has_offsets else "rest pose error"
    return "weights", (
        f"sums differ from 1 by up to {quality.partition_of_unity:.1e}, {rest} "
        f"{quality.linear_precision:.1e}, smallest weight {quality.min_weight:.1e}"
    )


def format_accuracy_row(quality: WeightQuality, accuracy: object) -> tuple[str, str]:
    """Return the row on how close the weights are to exact coordinates of their type."""
    if not quality.panels:
        return "accuracy", "exact (closed form)"
    return "accuracy", (
        f"{accuracy}: estimated weight error {quality.estimated_error:.1e} (mean sum per vertex), "
        f"{format_count(quality.panels, 'panel')} (pieces of faces)"
    )


def format_check_row(check: LimitCheck, words: Vocabulary) -> tuple[str, str]:
    """Return the verdict of a check, and its metric, value, limit and frame as a line."""
    metric, verdict = words.limits[check.metric], check.verdict
    found = check.format_found()
    limit = f"limit {check.format_limit_with_baseline(f' {check.unit}')}"
    if check.found is None:
        return verdict, f"{metric} {found}, {limit}"
    place = words.worst_frame if check.metric == "rms" else "at"
    return (
        verdict,
        f"{metric} {found} {check.unit}, {limit}, {place} {single_line(check.frame or '')}",
    )


def _skipped_rows(report: Report) -> list[Row]:
    """Name skipped frames, with the reason of the first; the record has all reasons."""
    frames = [frame for frame in report.frames if frame.skipped is not None]
    if not frames:
        return []
    total = format_count(len(report.frames), "frame")
    names = join_truncated(frame.name for frame in frames)
    rows: list[Row] = [
        ("skipped", f"{group_digits(len(frames))} of {total}: {names}; {frames[0].skipped}")
    ]
    if report.filled:
        count = format_count(len(report.filled), "frame")
        rows.append(("filled", f"{count} from those around: {join_truncated(report.filled)}"))
    return rows


def _region_rows(report: Report) -> list[Row]:
    """Say that the largest deviation is unusual, where, and what to do."""
    if not report.regions:
        return []
    return [
        ("worst regions", f"{explain_regions(report.summary)}; with probable causes:"),
        *((f"region {k}", describe_region(one)) for k, one in enumerate(report.regions, 1)),
        *(("to do", text) for text in list_remedies(report.regions, report.fit is not None)),
    ]


def _quality_rows(report: Report, words: Vocabulary) -> list[Row]:
    quality = report.binding
    system = (
        f"condition number {quality.condition_number:.4g} (how much it amplifies noise), "
        f"alpha {_format_number(report.settings.get('alpha'))}, "
        f"beta {_format_number(report.settings.get('beta'))}"
    )
    accuracy = format_accuracy_row(quality, report.settings.get("accuracy"))
    return [format_weights_row(quality, report.has_offsets), accuracy, (words.system, system)]


def _format_volume(report: Report, words: Vocabulary) -> str:
    summary = report.summary
    change, drift = summary.volume_change_percent_max, summary.volume_drift_percent_max
    if change is None:
        return f"not defined, {explain_missing_volume(report.clip)}"
    own = "not defined" if drift is None else f"{format_change(drift)} %"
    return f"largest {format_change(change)} % ({summary.volume_change_frame}); {words.drift} {own}"


def _format_number(value: object) -> str:
    return format_metric(value) if isinstance(value, int | float) else "unknown"
