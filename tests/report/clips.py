"""Made-up entries of an overview."""

from dataclasses import replace

from cageik_cli.report.figures import ClipRecord, ReportSummary
from cageik_cli.report.limits import LimitCheck
from cageik_cli.report.overview import ClipEntry, build_clip_entry
from cageik_cli.report.record import Report
from cageik_cli.util.messages import Note


def summary(rms_percent: float = 0.25, **others) -> ReportSummary:
    """Metrics of a clip whose diagonal is 2."""
    figures = {
        "rms": rms_percent / 50, "rms_percent": rms_percent, "worst_frame": "f_7.obj",
        "worst_frame_index": 7, "worst_frame_rms": 0.006, "worst_frame_rms_percent": 0.3,
        "max_deviation": 0.02, "max_deviation_percent": 1.0, "max_deviation_frame": "f_8.obj",
        "max_deviation_vertex": 3, "volume_change_percent_max": -1.44,
        "volume_change_frame": "f_9.obj", "volume_drift_percent_max": 2.0, "e_rms": 2.9,
        "kg_error": None, "frames_skipped": 0, "floats_per_frame": 24, "fixed_floats": 144,
        "radius_rms_percent": 2 * rms_percent,
    }  # fmt: skip
    return ReportSummary(**figures | others)


def percent_metrics(figures: ReportSummary) -> dict[str, float | None]:
    """The metrics that a baseline holds of a summary."""
    change = figures.volume_change_percent_max
    return {
        "rms": figures.rms_percent,
        "frame_rms": figures.worst_frame_rms_percent,
        "max_deviation": figures.max_deviation_percent,
        "volume_change": None if change is None else abs(change),
    }


def gate(passed: bool | None, **others) -> LimitCheck:
    """A check of the clip's rms against 0.5 %."""
    found = {True: 0.25, False: 0.75, None: None}[passed]
    fields = {"metric": "rms", "unit": "%", "limit": 0.5, "found": found, "frame": "f_7.obj"}
    return LimitCheck(**fields | {"passed": passed} | others)


def clip(name: str, *gates: LimitCheck, notes=(), **figures) -> ClipEntry:
    """An extracted clip whose summary has these figures."""
    counts = ClipRecord(
        frames=5, vertices=18, cage_vertices=8, diagonal=2.0, radius=1.0, closed=True, fps=24.0
    )
    report = Report(
        schema=1, tool={}, result=name, edited_from=None, sources={}, settings={},
        notes=tuple(map(Note, notes)), clip=counts, binding=None, fit=None, bound=None,
        summary=summary(**figures), vertices=None, frames=(), gates=gates,
    )  # fmt: skip
    return ClipEntry(name, report=report)


def poor(name: str, *gates: LimitCheck, better: str | None = None) -> ClipEntry:
    """An extracted clip whose cages give it poorly."""
    entry = clip(name, *gates)
    return replace(entry, report=replace(entry.report, quality="poor", better=better))


def change(entry: ClipEntry, name: str | None = None, **figures) -> ClipEntry:
    """The entry with another name and other figures in its summary."""
    report = replace(entry.report, summary=replace(entry.report.summary, **figures))
    return replace(entry, name=name or entry.name, report=report)


HOSTILE = {
    "control": "walk\x00\x07\x1b[31m\n\trun",
    "surrogate": "walk\ud800",
    "no character": "walk\uffff\ufffe\u202e",
    "xml": "<a b='c'>&amp;\"]]>",
    "html": '<img src="x" onerror="alert(1)">',
    "pipes": "a|b||c",
    "backticks": "`a` ``b```",
    "emphasis": "*a* _b_ **c** ~~d~~",
    "a link": "[a](http://b.c) ![d](e) <http://f.g>",
    "a list": "1. walk",
    "another list": "- walk",
    "a heading": "# walk",
    "a backslash": "a\\|b\\",
    "an entity": "&lt;b&gt;",
    "empty": "",
    "blank": " ",
    "long": "x" * 5000,
}


def make_500_clips(report: Report) -> list[ClipEntry]:
    """500 clips from one report, each with a curve of 120 points."""
    entry = build_clip_entry(report, page="clip.html")
    curve = replace(
        entry.curve,
        rms_percent=tuple(0.5 + k % 7 for k in range(120)),
        other=tuple(0.5 - k % 5 for k in range(120)),
    )
    return [replace(entry, name=f"characters/hero/shot_{k}", curve=curve) for k in range(500)]
