"""The record that every view of a result shows; views compute nothing.

Error definitions, for F frames of m vertices, D the rest bounding box's diagonal:

- rms of a frame: sqrt(mean_i |v̂_i − v_i|²); of the clip: the root of the mean square over frames.
- e_rms = 2000/√3 · rms/D = 1154.70 · rms/D (Kavan, Sloan and O'Sullivan 2010, eq. 8).
- kg_error = 100 |V − V̂|_F / |V − E(V)|_F, E(V) each frame's centroid (Karni and Gotsman 2004).
- volume_change = 100 (V̂ − V)/V and volume_drift = 100 (V − V_rest)/V_rest, percent; signed.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cageik_cli.dual_laplacian import Quality
from cageik_cli.layout import printable
from cageik_cli.mesh import Floats
from cageik_cli.store.result import Result

SCHEMA = 1
E_RMS = 2000 / np.sqrt(3)


@dataclass(frozen=True, slots=True)
class Clip:
    """What was extracted: counts, the diagonal in file units, and whether the model is closed."""

    frames: int
    vertices: int
    cage_vertices: int
    diagonal: float
    closed: bool
    fps: float


@dataclass(frozen=True, slots=True)
class Frame:
    """Figures of one frame: lengths in file units and percent of the diagonal, changes in percent.

    What depends on a volume is None for an open model, or when vertices are missing data. Of a
    frame that was skipped all figures are None, and `skipped` says why it was.
    """

    index: int
    name: str
    rms: float | None
    rms_percent: float | None
    max_deviation: float | None
    max_deviation_percent: float | None
    worst_vertex: int | None
    volume: float | None
    volume_reconstructed: float | None
    volume_change: float | None
    volume_drift: float | None
    skipped: str | None


@dataclass(frozen=True, slots=True)
class Summary:
    """Figures of the clip, over the frames that were not skipped.

    `volume_change_percent_max` is the change of largest size, with its sign.
    `fixed_floats` counts the weights, `floats_per_frame` the coordinates of a cage.
    """

    rms: float
    rms_percent: float
    worst_frame: str
    worst_frame_index: int
    worst_frame_rms_percent: float
    max_deviation: float
    max_deviation_percent: float
    max_deviation_frame: str
    max_deviation_vertex: int
    volume_change_percent_max: float | None
    volume_change_frame: str | None
    volume_drift_percent_max: float | None
    e_rms: float
    kg_error: float | None
    frames_skipped: int
    floats_per_frame: int
    fixed_floats: int


@dataclass(frozen=True, slots=True)
class Report:
    """One result's report; `report.json` is this record."""

    schema: int
    tool: dict[str, str]
    result: str
    sources: dict[str, Any]
    settings: dict[str, Any]
    notes: tuple[str, ...]
    clip: Clip
    binding: Quality
    summary: Summary
    frames: tuple[Frame, ...]
    gates: tuple[dict[str, Any], ...] = ()


def report_of(result: Result) -> Report:
    """Compute the report of a result."""
    rest = result.rest
    frames = _frames(result)
    return Report(
        schema=SCHEMA,
        tool={"name": "cageik", "version": result.version},
        result=printable(result.path.name),
        sources=result.sources,
        settings=result.settings,
        notes=result.notes,
        clip=Clip(
            frames=len(frames),
            vertices=len(rest.vertices),
            cage_vertices=len(result.cage.vertices),
            diagonal=rest.diagonal,
            closed=rest.is_closed,
            fps=result.scene.fps,
        ),
        binding=result.quality,
        summary=_summary(result, frames),
        frames=frames,
    )


def _frames(result: Result) -> tuple[Frame, ...]:
    rest, figures = result.rest, result.figures
    percent = 100 / rest.diagonal
    change = _percent_change(figures.volume_reconstructed, figures.volume)
    rest_volume = rest.volume if rest.is_closed else np.nan
    drift = _percent_change(figures.volume, np.full(len(figures.volume), rest_volume))
    return tuple(
        Frame(
            index=k,
            name=name,
            rms=_finite(figures.rms[k]),
            rms_percent=_finite(percent * figures.rms[k]),
            max_deviation=_finite(figures.max_deviation[k]),
            max_deviation_percent=_finite(percent * figures.max_deviation[k]),
            worst_vertex=None if k in result.skipped else int(figures.worst_vertex[k]),
            volume=_finite(figures.volume[k]),
            volume_reconstructed=_finite(figures.volume_reconstructed[k]),
            volume_change=_finite(change[k]),
            volume_drift=_finite(drift[k]),
            skipped=result.skipped.get(k),
        )
        for k, name in enumerate(result.frames)
    )


def _summary(result: Result, frames: tuple[Frame, ...]) -> Summary:
    figures, diagonal = result.figures, result.rest.diagonal
    rms = float(np.sqrt(np.nanmean(figures.rms**2)))
    spread = float(np.sqrt(np.nanmean(figures.spread**2)))
    worst, furthest = int(np.nanargmax(figures.rms)), int(np.nanargmax(figures.max_deviation))
    worst_rms, deviation = float(figures.rms[worst]), float(figures.max_deviation[furthest])
    changed = max(
        (frame for frame in frames if frame.volume_change is not None),
        key=lambda frame: abs(frame.volume_change or 0.0),
        default=None,
    )
    drifts = [frame.volume_drift for frame in frames if frame.volume_drift is not None]
    return Summary(
        rms=rms,
        rms_percent=100 * rms / diagonal,
        worst_frame=frames[worst].name,
        worst_frame_index=worst,
        worst_frame_rms_percent=100 * worst_rms / diagonal,
        max_deviation=deviation,
        max_deviation_percent=100 * deviation / diagonal,
        max_deviation_frame=frames[furthest].name,
        max_deviation_vertex=int(figures.worst_vertex[furthest]),
        volume_change_percent_max=changed.volume_change if changed else None,
        volume_change_frame=changed.name if changed else None,
        volume_drift_percent_max=max(drifts, key=abs, default=None),
        e_rms=float(E_RMS * rms / diagonal),
        kg_error=100 * rms / spread if spread > 0 else None,
        frames_skipped=len(result.skipped),
        floats_per_frame=3 * len(result.cage.vertices),
        fixed_floats=len(result.rest.vertices) * len(result.cage.vertices),
    )


def _percent_change(new: Floats, old: Floats) -> Floats:
    """100 (new − old)/old; nan where old is zero or nan, and infinite where it is next to zero."""
    usable = np.where(old == 0, np.nan, old)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(100 * (new - old) / usable)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
