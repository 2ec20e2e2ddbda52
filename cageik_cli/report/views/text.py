"""The report as a page of text."""

from cageik_cli.coordinates.binding import WeightQuality
from cageik_cli.report.figures import Summary, change_text, figure_text, percent_text, units_text
from cageik_cli.report.limits import Gate, found_text, gate_verdict, limit_text
from cageik_cli.report.record import Report
from cageik_cli.report.vocabulary import Wording, wording_of
from cageik_cli.util.errors import first_few
from cageik_cli.util.text import page, shown


def as_text(report: Report) -> str:
    """A dozen lines: the headline first, then where it is worst, then how far to trust it."""
    clip, summary, words = report.clip, report.summary, wording_of(report.edited_from)
    headline = (
        f"{report.result}: {clip.frames} frames of {clip.vertices} vertices in a cage of "
        f"{clip.cage_vertices}, diagonal {clip.diagonal:.6g}"
    )
    rows = [
        *([] if report.edited_from is None else [("edited from", report.edited_from)]),
        (
            words.measure,
            f"{percent_text(summary.rms_percent)} % of the diagonal "
            f"(rms {units_text(summary.rms)})",
        ),
        (
            words.worst_frame,
            f"{percent_text(summary.worst_frame_rms_percent)} % at {summary.worst_frame}",
        ),
        (
            words.largest,
            f"{percent_text(summary.max_deviation_percent)} % "
            f"({units_text(summary.max_deviation)}) at vertex {summary.max_deviation_vertex} "
            f"of {summary.max_deviation_frame}",
        ),
        ("volume change", _volume(report, words)),
        *(_literature(summary) if words.has_literature else []),
        (
            "size",
            f"{summary.floats_per_frame} numbers a frame instead of {3 * clip.vertices}, "
            f"and {summary.fixed_floats} weights once",
        ),
        *_trust(report, words),
        *_skipped(report),
        *(gate_row(gate, words) for gate in report.gates),
        *(("note", note) for note in report.notes),
    ]
    return page(headline, rows)


def weights_row(quality: WeightQuality) -> tuple[str, str]:
    """How far weights can be trusted."""
    return "weights", (
        f"rows sum to 1 within {quality.partition_of_unity:.1e}, rest pose rebuilt within "
        f"{quality.linear_precision:.1e}, smallest {quality.min_weight:.1e}"
    )


def accuracy_row(quality: WeightQuality, accuracy: object) -> tuple[str, str]:
    """How far weights are from exact coordinates of their kind."""
    if not quality.panels:
        return "accuracy", "exact, in closed form"
    return "accuracy", (
        f"{accuracy}: {quality.panels} panels, mean row L1 error {quality.estimated_error:.1e} "
        "(estimated)"
    )


def gate_row(gate: Gate, words: Wording) -> tuple[str, str]:
    """The verdict on a figure, and what it was of: metric, what was found, limit, frame."""
    metric, verdict = words.limits[gate.metric], gate_verdict(gate).text
    found, limit = found_text(gate), f"limit {limit_text(gate, f' {gate.unit}')}"
    if gate.found is None:
        return verdict, f"{metric} {found}, {limit}"
    place = words.worst_frame if gate.metric == "rms" else "at"
    return verdict, f"{metric} {found} {gate.unit}, {limit}, {place} {shown(gate.frame or '')}"


def _skipped(report: Report) -> list[tuple[str, str]]:
    """The frames that were, and why the first was; the record has all reasons."""
    frames = [frame for frame in report.frames if frame.skipped is not None]
    if not frames:
        return []
    names = first_few((frame.name for frame in frames), 5)
    return [
        ("skipped", f"{len(frames)} of {len(report.frames)} frames: {names}; {frames[0].skipped}")
    ]


def _literature(summary: Summary) -> list[tuple[str, str]]:
    kg_error = _number(summary.kg_error)
    return [("literature", f"E_RMS {figure_text(summary.e_rms)}, KG error {kg_error}")]


def _trust(report: Report, words: Wording) -> list[tuple[str, str]]:
    quality = report.binding
    system = (
        f"condition number {quality.condition_number:.4g}, "
        f"alpha {_number(report.settings.get('alpha'))}, "
        f"beta {_number(report.settings.get('beta'))}"
    )
    accuracy = accuracy_row(quality, report.settings.get("accuracy"))
    return [weights_row(quality), accuracy, (words.system, system)]


def _volume(report: Report, words: Wording) -> str:
    summary = report.summary
    change, drift = summary.volume_change_percent_max, summary.volume_drift_percent_max
    if change is None:
        return "not defined" if report.clip.closed else "not defined, the model is open"
    own = "unknown" if drift is None else f"{change_text(drift)} %"
    return (
        f"{change_text(change)} % at most, at {summary.volume_change_frame} ({words.drift}: {own})"
    )


def _number(value: object) -> str:
    return figure_text(value) if isinstance(value, int | float) else "unknown"
