"""The record of a result that all views show; views compute nothing."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from cageik_cli.fit.settings import FitRecord
from cageik_cli.geometry.points import smallest_enclosing_sphere
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.method.solve.dual_laplacian import SolveQuality
from cageik_cli.method.solve.metrics import KeptMetrics
from cageik_cli.method.solve.summary import VertexBound
from cageik_cli.report.figures import (
    REPORT_SCHEMA,
    ClipRecord,
    FrameRecord,
    KeptSummary,
    ReportSummary,
    ToolRecord,
    VertexMetrics,
    WorstVertex,
    convert_to_integer,
)
from cageik_cli.report.fit_rows import (
    BaselineErrorRecord,
    build_baseline_errors,
    is_fitted_to_clip,
    measure_gap_closed,
)
from cageik_cli.report.limits import LimitCheck, Limits, check_limits, find_frames_digest
from cageik_cli.report.notes import (
    MAX_FAIR_RMS,
    find_tried,
    judge_quality,
    list_notes,
    suggest_step,
)
from cageik_cli.report.regions import (
    PartRecord,
    RegionRecord,
    build_parts,
    build_regions,
    sort_parts,
)
from cageik_cli.report.vocabulary import (
    EDIT_VOCABULARY,
    EXTRACTION_VOCABULARY,
    QUALITY_WORDS,
    Vocabulary,
)
from cageik_cli.store.hdf5_fields import SourceRecord
from cageik_cli.store.result import Result, StoredAnimation
from cageik_cli.store.result_fields import export_fields
from cageik_cli.store.tried_steps import HiddenErrors, Step, TriedStep
from cageik_cli.util.arrays import Floats
from cageik_cli.util.messages import Note, Spelling, spell, spell_keyword
from cageik_cli.util.text import to_unicode

MAX_WORST_VERTICES = 10
"""Worst vertices that a report lists."""


MAX_UNKNOWN_PERCENT = 1.0
"""Percentage of vertices that may be missing, and not be measured, in a result that is good."""

Doubt = Literal["rejected", "missing", "torn"]
"""Which data may be worse than what the figures of a result count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """One result's report; `report.json` is this record.

    The metrics of an edit measure how far it moved the mesh.

    Attributes
    ----------
    schema : int
        Version of this record; it changes when a field does.
    tool : ToolRecord
        What wrote the result.
    result : str
        The name of the file of the result.
    edited_from : str, optional
        What an edit was made from; None for a result of `extract`.
    sources : dict
        The files that were read, by what they were read for.
    settings : dict
        The settings on which the numbers depend.
    notes : tuple of Note
        What was changed, left out or found, one sentence each.
    clip : ClipRecord
        The clip, the model and the cage.
    binding : SolveQuality
        How good the weights are.
    fit : FitRecord, optional
        How weights were fitted to clips; None if they were not.
    bound : VertexBound, optional
        The smallest error that is possible; None if it is not known.
    summary : ReportSummary
        The metrics of the clip.
    vertices : VertexMetrics
        The distribution of the error over the model.
    frames : tuple of FrameRecord
        The metrics of each frame, in order.
    gates : tuple of LimitCheck
        The limits that were given, and whether they are kept.
    regions : tuple of RegionRecord, optional
        The worst regions, none if the largest deviation is within the usual; None for an edit, and
        for results of earlier versions.
    unfitted : BaselineErrorRecord, optional
        The error with the weights before a fit; None if the result does not hold it.
    kept : KeptSummary, optional
        What was left out as missing or as outliers; None if all vertices count alike.
    filled : tuple of str
        The names of skipped frames whose cages were filled from those around them.
    parts : tuple of PartRecord, optional
        In the order of the model; None for a model of one part.
    quality : str, optional
        How good the result is, a key of `QUALITY_WORDS`: good, fair or poor; None for an edit.
    better : str, optional
        The one step that would help most; None for an edit, and where there is no such step.
    gain : TriedStep, optional
        What that step has gained on some frames; None if it was not tried, as it cannot hurt.
    hidden : HiddenErrors, optional
        Errors of vertices that were hidden on purpose, as others are missing; None if none are.
    is_torn : bool
        Whether pieces of the input jump apart from the surface around them, in most frames.
    baseline_name : str, optional
        The result in the baseline that this one was compared with; None if there is none.

    Examples
    --------
    >>> from cageik_cli import build_report, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> report = build_report(result)
    >>> report.clip.frames, len(report.frames), report.clip.closed
    (48, 48, True)
    """

    schema: int
    tool: ToolRecord
    result: str
    edited_from: str | None = None
    sources: dict[str, SourceRecord]
    settings: dict[str, Any]
    notes: tuple[Note, ...]
    clip: ClipRecord
    binding: SolveQuality
    fit: FitRecord | None
    bound: VertexBound | None = None
    summary: ReportSummary
    vertices: VertexMetrics
    frames: tuple[FrameRecord, ...]
    gates: tuple[LimitCheck, ...]
    regions: tuple[RegionRecord, ...] | None = None
    unfitted: BaselineErrorRecord | None = None
    kept: KeptSummary | None = None
    filled: tuple[str, ...] = ()
    parts: tuple[PartRecord, ...] | None = None
    quality: str | None = None
    better: str | None = None
    gain: TriedStep | None = None
    hidden: HiddenErrors | None = None
    is_torn: bool = False
    baseline_name: str | None = None

    @property
    def verdict(self) -> str | None:
        """How good the result is, in a word; None for an edit."""
        return None if self.quality is None else QUALITY_WORDS[self.quality]

    @property
    def doubt(self) -> Doubt | None:
        """Which data alone keeps the result from being good; None if it is not that."""
        if self.quality != "fair":
            return None
        is_good = judge_quality(*_measure_counted(self.summary, self.kept, self.hidden)) == "good"
        found = _find_doubt(self.summary, self.kept, self.hidden, is_torn=self.is_torn)
        return found if is_good else None

    @property
    def has_offsets(self) -> bool:
        """Whether offsets beside the weights make the rest pose exact."""
        return self.fit is not None and self.fit.settings.influences is not None

    @property
    def counted(self) -> ReportSummary | KeptSummary:
        """The summary of the data that counts: of what was kept, if some was left out."""
        return self.summary if self.kept is None else self.kept

    @property
    def vocabulary(self) -> Vocabulary:
        """The words for the result."""
        return EXTRACTION_VOCABULARY if self.edited_from is None else EDIT_VOCABULARY

    @property
    def origin_rows(self) -> list[tuple[str, str]]:
        """The line that names what an edit was made from; none of a result of `extract`."""
        return [] if self.edited_from is None else [("edited from", self.edited_from)]


def build_report(
    result: StoredAnimation,
    limits: Limits | None = None,
    name: str | None = None,
    spelling: Spelling = spell_keyword,
) -> Report:
    """Compute the report of a result or an edit, by the name of its file unless one is given.

    All views show the settings that notes name as `spelling` writes them; the command line shows
    options.
    """
    rest, result_name = result.rest, to_unicode(name or result.path.name)
    _, radius = smallest_enclosing_sphere(rest.vertices[rest.used_vertices])
    limits = limits or Limits()
    fields = export_fields(result)
    digest = find_frames_digest(result.sources, fields.get("edited_from"))
    counterpart = limits.find_counterpart(result_name, digest)
    frames, parts = _build_frames(result, spelling), build_parts(result)
    summary = replace(
        _build_summary(result, frames, radius),
        worst_part=next((part.name for part in sort_parts(parts)), None),
    )
    judged: dict[str, Any] = {}
    if isinstance(result, Result):
        summary = replace(summary, **_summarize_fit(result))
        judged = _judge(result, summary, spelling)
    return Report(
        schema=REPORT_SCHEMA,
        tool={"name": "cageik", "version": result.version},
        result=result_name,
        notes=tuple(
            one.spell(spelling) for one in list_notes(result, result_name, digest, summary, limits)
        ),
        clip=ClipRecord(
            frames=len(frames),
            vertices=len(rest.vertices),
            cage_vertices=len(result.cage.vertices),
            diagonal=rest.diagonal,
            radius=radius,
            closed=rest.is_closed,
            fps=result.scene.fps,
            start=convert_to_integer(result.scene.start),
            frame_step=convert_to_integer(result.scene.frame_step),
            body=rest.is_body,
            metres_per_unit=result.scene.metres_per_unit,
        ),
        summary=summary,
        vertices=_build_vertex_metrics(result),
        frames=frames,
        gates=check_limits(counterpart, summary, limits),
        baseline_name=counterpart,
        parts=parts,
        **fields,
        **judged,
    )


def _judge(result: Result, summary: ReportSummary, spelling: Spelling) -> dict[str, Any]:
    """Return the fields of a report on how well frames were followed, and what would help."""
    kept = _build_kept(result)
    is_torn = find_tried(result, Step.TORN) is not None
    errors = judge_errors(summary, kept, result.hidden, is_torn=is_torn)
    better = suggest_step(result, *errors)
    return {
        "regions": build_regions(result),
        "unfitted": build_baseline_errors(result),
        "kept": kept,
        "filled": tuple(result.frames[k] for k in result.filled),
        "quality": judge_quality(*errors),
        "better": None if better is None else spell(better.step, spelling),
        "gain": None if better is None else better.gain,
        "is_torn": is_torn,
    }


def judge_errors(
    summary: ReportSummary,
    kept: KeptSummary | None,
    hidden: HiddenErrors | None,
    *,
    is_torn: bool = False,
) -> tuple[float, float]:
    """Return the rms and the largest error that the word on a result is of, in percent.

    Of what is in doubt, nothing is known to be good.
    """
    rms, largest = _measure_counted(summary, kept, hidden)
    is_known = _find_doubt(summary, kept, hidden, is_torn=is_torn) is None
    return rms if is_known else max(rms, MAX_FAIR_RMS), largest


def _measure_counted(
    summary: ReportSummary, kept: KeptSummary | None, hidden: HiddenErrors | None
) -> tuple[float, float]:
    """Return both errors of what counts; missing vertices do as those hidden on purpose."""
    counted = summary if kept is None else kept
    rms, largest = counted.rms_percent, counted.max_deviation_percent
    if kept is not None and hidden is not None:
        missing = kept.missing_percent / 100
        rms = float(np.sqrt((1 - missing) * rms**2 + missing * hidden.rms_percent**2))
        largest = max(largest, hidden.largest_percent)
    return rms, largest


def _find_doubt(
    summary: ReportSummary,
    kept: KeptSummary | None,
    hidden: HiddenErrors | None,
    *,
    is_torn: bool,
) -> Doubt | None:
    """Return which data may be worse than what counts, so that the word is fair at best.

    What was rejected may be motion, which the cage does not follow, if all data has another word
    than what was kept; and of many missing vertices nothing is known if none were hidden. Pieces
    that jump are no motion of the model, however closely they are followed.
    """
    if is_torn:
        return "torn"
    if kept is None:
        return None
    everything = judge_quality(summary.rms_percent, summary.max_deviation_percent)
    if everything != judge_quality(kept.rms_percent, kept.max_deviation_percent):
        return "rejected"
    return "missing" if hidden is None and kept.missing_percent > MAX_UNKNOWN_PERCENT else None


def _build_frames(result: StoredAnimation, spelling: Spelling) -> tuple[FrameRecord, ...]:
    rest, metrics = result.rest, result.metrics
    kept = result.kept if isinstance(result, Result) else None
    percent = 100 / rest.diagonal
    least = rest.least_volume
    change = _percent_change(metrics.volume_reconstructed, metrics.volume, least)
    rest_volume = rest.volume if rest.is_closed else np.nan
    drift = _percent_change(metrics.volume, np.full(len(metrics.volume), rest_volume), least)
    return tuple(
        FrameRecord(
            index=k,
            number=convert_to_integer(result.scene.frame_number(k)),
            name=name,
            rms=_finite_or_none(metrics.rms[k]),
            rms_percent=_finite_or_none(percent * metrics.rms[k]),
            max_deviation=_finite_or_none(metrics.max_deviation[k]),
            max_deviation_percent=_finite_or_none(percent * metrics.max_deviation[k]),
            worst_vertex=None if k in result.skipped else int(metrics.worst_vertex[k]),
            volume=_finite_or_none(metrics.volume[k]),
            volume_reconstructed=_finite_or_none(metrics.volume_reconstructed[k]),
            volume_change=_finite_or_none(change[k]),
            volume_drift=_finite_or_none(drift[k]),
            skipped=spell(result.skipped[k], spelling) if k in result.skipped else None,
            **({} if kept is None or k in result.skipped else _list_kept(kept, k, percent)),
        )
        for k, name in enumerate(result.frames)
    )


def _list_kept(kept: KeptMetrics, frame: int, percent: float) -> dict[str, Any]:
    """Return the fields of a frame on what was kept of it; `percent` is that of a unit."""
    return {
        "missing": int(kept.missing[frame]),
        "rejected": int(kept.rejected[frame]),
        "rms_kept_percent": float(percent * kept.rms_kept[frame]),
        "max_deviation_kept_percent": float(percent * kept.max_deviation_kept[frame]),
        "area_rms_percent": _finite_or_none(percent * kept.area_rms[frame]),
        "area_rms_kept_percent": _finite_or_none(percent * kept.area_rms_kept[frame]),
    }


def _build_kept(result: Result) -> KeptSummary | None:
    """Summarise what was kept of the frames that were not skipped."""
    kept, percent = result.kept, 100 / result.rest.diagonal
    if kept is None:
        return None
    known = np.setdiff1d(np.arange(len(result.frames)), list(result.skipped))
    missing, rejected = kept.missing[known], kept.rejected[known]
    vertices = len(result.rest.vertices)
    data = vertices * len(known) - int(missing.sum())
    most_missing, most_rejected = (int(counts.argmax()) for counts in (missing, rejected))
    return KeptSummary(
        rms_percent=float(percent * np.sqrt(np.mean(kept.rms_kept[known] ** 2))),
        max_deviation_percent=float(percent * kept.max_deviation_kept[known].max()),
        missing_percent=float(100 * missing.sum() / (vertices * len(known))),
        most_missing=int(missing[most_missing]),
        most_missing_frame=result.frames[known[most_missing]],
        rejected_percent=float(100 * rejected.sum() / max(1, data)),
        most_rejected=int(rejected[most_rejected]),
        most_rejected_frame=result.frames[known[most_rejected]],
        area_rms_percent=_finite_or_none(percent * _average_frames(kept.area_rms_kept)),
    )


def _build_summary(
    result: StoredAnimation, frames: tuple[FrameRecord, ...], radius: float
) -> ReportSummary:
    metrics, diagonal = result.metrics, result.rest.diagonal
    rms = float(np.sqrt(np.nanmean(metrics.rms**2)))
    worst, furthest = int(np.nanargmax(metrics.rms)), int(np.nanargmax(metrics.max_deviation))
    worst_rms, deviation = float(metrics.rms[worst]), float(metrics.max_deviation[furthest])
    changed = max(
        (frame for frame in frames if frame.volume_change is not None),
        key=lambda frame: abs(frame.volume_change or 0.0),
        default=None,
    )
    spread = float(np.sqrt(np.nanmean(metrics.spread**2)))
    dense = len(result.rest.vertices) * len(result.cage.vertices)
    drifts = [frame.volume_drift for frame in frames if frame.volume_drift is not None]
    return ReportSummary(
        rms=rms,
        rms_percent=100 * rms / diagonal,
        worst_frame=frames[worst].name,
        worst_frame_index=worst,
        worst_frame_rms=worst_rms,
        worst_frame_rms_percent=100 * worst_rms / diagonal,
        max_deviation=deviation,
        max_deviation_percent=100 * deviation / diagonal,
        max_deviation_frame=frames[furthest].name,
        max_deviation_vertex=int(metrics.worst_vertex[furthest]),
        volume_change_percent_max=changed.volume_change if changed else None,
        volume_change_frame=changed.name if changed else None,
        volume_drift_percent_max=max(drifts, key=abs, default=None),
        radius_rms_percent=100 * rms / radius,
        e_rms=float(2000 / np.sqrt(3) * rms / diagonal),
        kg_error=100 * rms / spread if spread > 0 else None,
        frames_skipped=len(result.skipped),
        # Offsets turn with each frame: its rotation has three numbers.
        floats_per_frame=3 * (len(result.cage.vertices) + int(result.has_offsets)),
        fixed_floats=dense if result.fit is None else result.fit.report.fixed_floats,
        **_summarize_by_area(result),
    )


def _summarize_fit(result: Result) -> dict[str, Any]:
    """Return the fields of a summary on how well the clip can be followed, and a fit follows it."""
    fit, bound = result.fit, result.bound
    held_out = fit.report.held_out_blocks if fit is not None and is_fitted_to_clip(result) else None
    return {
        "best_possible_percent": (None if bound is None or bound.is_trivial else bound.rms_percent),
        "gap_closed_percent": measure_gap_closed(result),
        "held_out_rms_percent": None if held_out is None else held_out.fitted.rms,
    }


def _summarize_by_area(result: StoredAnimation) -> dict[str, Any]:
    """Return the rms over the clip in which vertices count by their area in the rest pose."""
    kept = result.kept if isinstance(result, Result) else None
    known = np.isfinite(result.vertex_rms)
    areas = lumped_areas(result.rest)[known]
    if kept is not None:  # the rms of a vertex is that of what was kept
        rms = _average_frames(kept.area_rms)
    elif areas.any():
        shares = areas / areas.max()  # squares of lengths times areas could overflow
        rms = float(np.sqrt(np.average(result.vertex_rms[known] ** 2, weights=shares)))
    else:
        rms = np.nan
    percent = 100 * rms / result.rest.diagonal
    return {"area_rms": _finite_or_none(rms), "area_rms_percent": _finite_or_none(percent)}


def _average_frames(rms: Floats) -> float:
    """Return the rms of a clip by that of its frames, nan for those without; nan if all are."""
    known = rms[np.isfinite(rms)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def _build_vertex_metrics(result: StoredAnimation) -> VertexMetrics:
    bins = 40  # of the histogram of the page
    rms, percent = result.vertex_rms, 100 / result.rest.diagonal
    known = np.flatnonzero(np.isfinite(rms))
    top = float(np.nanmax(percent * rms)) or 1.0
    counts, edges = np.histogram(percent * rms[known], bins, (0.0, top))
    worst = known[np.argsort(-rms[known], kind="stable")[:MAX_WORST_VERTICES]]
    return VertexMetrics(
        edges_percent=tuple(edges.tolist()),
        counts=tuple(counts.tolist()),
        worst=tuple(
            WorstVertex(
                vertex=int(k),
                rms=float(rms[k]),
                rms_percent=float(percent * rms[k]),
                position=tuple(result.rest.vertices[k].tolist()),
            )
            for k in worst
        ),
    )


def _percent_change(new: Floats, old: Floats, least: float) -> Floats:
    """Return 100 (new − old)/old; nan where old is nan, or at most `least` in absolute value."""
    usable = np.where(np.abs(old) > least, old, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(100 * (new - old) / usable)


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
