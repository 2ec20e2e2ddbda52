"""Errors of reconstructions relative to their frames: RMS, deviation and volume."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, signed_volumes
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats, Integers, Mask, Workspace
from cageik_cli.util.errors import NumericalError

MAX_LENGTH = 1e60
"""Far above any length in a scene; its square does not overflow."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameMetrics:
    """Metrics of k frames, each an array (k,); lengths in file units.

    Attributes
    ----------
    rms : float64
        sqrt(mean_i |v̂_i − v_i|²).
    max_deviation : float64
        max_i |v̂_i − v_i|.
    worst_vertex : int64
        The vertex of the largest deviation.
    volume, volume_reconstructed : float64
        Signed volumes of v and v̂; nan for an open model or a sheet, or when vertices are missing
        data.
    spread : float64
        sqrt(mean_i |v_i − centroid|²), what `rms` is divided by in Karni and Gotsman's error.
    """

    rms: Floats
    max_deviation: Floats
    worst_vertex: Integers
    volume: Floats
    volume_reconstructed: Floats
    spread: Floats


@dataclass(frozen=True, slots=True, eq=False)
class KeptMetrics:
    """Metrics of k frames over the vertices that were kept, each an array (k,).

    Attributes
    ----------
    missing : int64
        Vertices that are not data.
    rejected : int64
        Vertices that are data, and weigh less than is given, as outliers.
    rms_kept, max_deviation_kept : float64
        As in `FrameMetrics`, over data that was not rejected.
    area_rms, area_rms_kept : float64
        sqrt(Σ a_i |v̂_i − v_i|² / Σ a_i) over all data, and over what was not rejected, with the
        area a_i of a vertex at rest; nan without area, and in results of earlier versions.
    """

    missing: Integers
    rejected: Integers
    rms_kept: Floats
    max_deviation_kept: Floats
    area_rms: Floats
    area_rms_kept: Floats


METRIC_TYPES = {
    field.name: "i8" if field.name == "worst_vertex" else "f8" for field in fields(FrameMetrics)
}
"""The names of the metrics of frames, and the types of their columns."""

KEPT_TYPES = {
    field.name: "i8" if field.name in ("missing", "rejected") else "f8"
    for field in fields(KeptMetrics)
}
"""The names of the metrics over what was kept, and the types of their columns."""

AREA_COLUMNS = ("area_rms", "area_rms_kept")
"""Those of `KEPT_TYPES` that may be nan."""

Metrics = TypeVar("Metrics", FrameMetrics, KeptMetrics)


def map_columns(metrics: Metrics, change: Callable[[np.ndarray], np.ndarray]) -> Metrics:
    """Return metrics with `change` of each of their columns."""
    names = (field.name for field in fields(metrics))
    return type(metrics)(**{name: change(getattr(metrics, name)) for name in names})


def leave_gaps(metrics: Metrics, gaps: Integers) -> Metrics:
    """Return metrics in which frames at these places have none: nan, or -1 in whole numbers."""

    def change(column: np.ndarray) -> np.ndarray:
        found = column.copy()
        found[gaps] = -1 if np.issubdtype(column.dtype, np.integer) else np.nan
        return found

    return map_columns(metrics, change)


def measure(
    rest: TriMesh,
    frames: Floats,
    reconstructions: Floats,
    data: slice | Integers | Mask,
    workspace: Workspace | None = None,
    is_kept: Mask | None = None,
) -> tuple[FrameMetrics, Floats]:
    """Measure the errors of reconstructions over data.

    Parameters
    ----------
    rest : TriMesh
        Its faces define the volume.
    frames, reconstructions : (k, m, 3)
    data : slice, (c,) int64, or (k, m) bool
        Vertices that are data, of all frames or of each: all in a face but those of weight 0.
    workspace : Workspace, optional
        Memory to reuse.
    is_kept : (k, m) bool, optional
        Data that was not rejected, if vertices of frames count differently. Volumes are then with
        the reconstruction where a vertex was rejected.

    Returns
    -------
    metrics : FrameMetrics
    squared_errors : (k, m) float64
        |v̂_i − v_i|², nan for vertices that are not data; in workspace memory, if one was given.
    """
    if is_kept is None and compiled.kernel is not None:
        return _measure_compiled(rest, frames, reconstructions, data, workspace or Workspace())
    is_data = data
    if is_kept is None:
        is_data = np.zeros(frames.shape[:2], bool)
        is_data[:, data] = True
    return _measure_in_numpy(rest, frames, reconstructions, np.asarray(is_data), is_kept)


def _measure_compiled(
    rest: TriMesh,
    frames: Floats,
    reconstructions: Floats,
    data: slice | Integers | Mask,
    workspace: Workspace,
) -> tuple[FrameMetrics, Floats]:
    """Measure frames whose vertices count alike, compiled."""
    is_data = np.zeros(frames.shape[1], bool)
    is_data[data] = True
    has_volume = rest.is_body and is_data[rest.used_vertices].all()
    sums, worst = np.empty((len(frames), 5)), np.empty(len(frames), np.int64)
    squares = workspace.array("squares", *frames.shape[:2])
    # The sums are those of |v̂ − v|², their largest, that of |v − centroid|², and six times the
    # signed volumes of v and v̂.
    compiled.kernel.compare_frames(
        np.ascontiguousarray(frames, np.float64),
        np.ascontiguousarray(reconstructions, np.float64),
        is_data.view(np.uint8),
        np.ascontiguousarray(rest.faces if has_volume else rest.faces[:0]),
        squares,
        sums,
        worst,
    )
    count = np.count_nonzero(is_data)
    volumes = sums[:, 3:] / 6 if has_volume else np.full((len(frames), 2), np.nan)
    metrics = FrameMetrics(
        rms=np.sqrt(sums[:, 0] / count),
        max_deviation=np.sqrt(sums[:, 1]),
        worst_vertex=worst,
        volume=volumes[:, 0],
        volume_reconstructed=volumes[:, 1],
        spread=np.sqrt(sums[:, 2] / count),
    )
    if count < frames.shape[1]:
        squares[:, ~is_data] = np.nan
    return metrics, squares


def _measure_in_numpy(
    rest: TriMesh, frames: Floats, reconstructions: Floats, is_data: Mask, is_kept: Mask | None
) -> tuple[FrameMetrics, Floats]:
    """Measure frames whose vertices may count differently: the reference."""
    errors = reconstructions - frames
    squares = np.einsum("kjx,kjx->kj", errors, errors)
    over_data = np.where(is_data, squares, -1.0)
    counts = is_data.sum(axis=1)
    known = np.where(counts > 0, counts, np.nan)
    is_taken = is_data if is_kept is None else is_kept
    volume, volume_rebuilt = np.full((2, len(frames)), np.nan)
    whole = np.flatnonzero(is_data[:, rest.used_vertices].all(axis=1) & rest.is_body)
    if len(whole):
        mended = np.where(is_taken[whole, :, None], frames[whole], reconstructions[whole])
        volume[whole] = signed_volumes(mended, rest.faces)
        volume_rebuilt[whole] = signed_volumes(reconstructions[whole], rest.faces)
    centroids = np.einsum("kj,kjx->kx", is_data, frames) / known[:, None]
    spread = np.einsum("kjx,kj->k", (frames - centroids[:, None]) ** 2, is_data) / known
    metrics = FrameMetrics(
        rms=np.sqrt(np.where(is_data, squares, 0.0).sum(axis=1) / known),
        max_deviation=np.sqrt(np.where(counts > 0, over_data.max(axis=1), np.nan)),
        worst_vertex=over_data.argmax(axis=1).astype(np.int64),
        volume=volume,
        volume_reconstructed=volume_rebuilt,
        spread=np.sqrt(spread),
    )
    return metrics, np.where(is_data, squares, np.nan)


def measure_kept(
    squared_errors: Floats, is_data: Mask, is_kept: Mask, areas: Floats
) -> KeptMetrics:
    """Measure squared errors, (k, m), over what was kept of the data, as of `measure`.

    Areas, (m,), are those of the vertices in the rest pose.
    """
    over_kept = np.where(is_kept, squared_errors, 0.0)
    shares = areas / (areas.max() or 1.0)  # squares of lengths times areas could overflow

    def average_by_area(is_counted: Mask) -> Floats:
        counted = np.where(is_counted, shares, 0.0)
        whole = counted.sum(axis=1)
        sums = (counted * np.where(is_counted, squared_errors, 0.0)).sum(axis=1)
        return np.asarray(np.sqrt(sums / np.where(whole > 0, whole, np.nan)))

    return KeptMetrics(
        missing=(~is_data).sum(axis=1),
        rejected=(is_data & ~is_kept).sum(axis=1),
        rms_kept=np.sqrt(over_kept.sum(axis=1) / np.maximum(is_kept.sum(axis=1), 1)),
        max_deviation_kept=np.sqrt(over_kept.max(axis=1)),
        area_rms=average_by_area(is_data),
        area_rms_kept=average_by_area(is_kept),
    )


@dataclass(frozen=True, slots=True, eq=False)
class DeviationPeaks:
    """The largest deviation of each vertex over some frames.

    Peaks of blocks of frames, merged in order, are those of all their frames at once.

    Attributes
    ----------
    deviations : (m,) float64
        max |v̂ − v|, file units; 0 for vertices without data.
    frames : (m,) int64
        The first frame in which it was; −1 where no frame deviates.
    """

    deviations: Floats
    frames: Integers

    @staticmethod
    def of_frames(squared_errors: Floats, frames: Integers) -> "DeviationPeaks":
        """Find the peaks of the frames with these numbers, (k,).

        Squared errors, |v̂ − v|², are (k, m), and nan in all frames for vertices without data.
        """
        squares = np.zeros(squared_errors.shape[1])
        found = np.full(len(squares), -1)
        for row, frame in zip(squared_errors, frames, strict=True):
            is_larger = row > squares  # not where it is nan
            np.copyto(squares, row, where=is_larger)
            np.copyto(found, frame, where=is_larger)
        return DeviationPeaks(np.sqrt(squares), found)

    @staticmethod
    def none(vertex_count: int) -> "DeviationPeaks":
        """Return the peaks of no frame."""
        return DeviationPeaks(np.zeros(vertex_count), np.full(vertex_count, -1))

    def merge(self, later: "DeviationPeaks") -> "DeviationPeaks":
        """Return the peaks of these frames and of later ones; the first of equal ones counts."""
        is_later = later.deviations > self.deviations
        return DeviationPeaks(
            np.where(is_later, later.deviations, self.deviations),
            np.where(is_later, later.frames, self.frames),
        )


def are_lengths(values: Floats) -> np.ndarray:
    """Return which values can be lengths; nan cannot."""
    return np.asarray((values >= 0) & (values <= MAX_LENGTH))


def find_impossible_kept(
    metrics: KeptMetrics, vertices: int, skipped: Sequence[int] | Integers
) -> str | None:
    """Return the name of a metric that is impossible in frames not skipped, or None."""
    for name, kind in KEPT_TYPES.items():
        held = np.delete(getattr(metrics, name), skipped)
        fits = (held >= 0) & (held <= vertices) if kind == "i8" else are_lengths(held)
        if not (fits | (np.isnan(held) & (name in AREA_COLUMNS))).all():
            return name
    return None


def find_invalid_metric(metrics: FrameMetrics) -> str | None:
    """Return a description of an invalid metric, or None; volumes may be nan."""
    for name in ("rms", "max_deviation", "spread"):
        column = getattr(metrics, name)
        if not are_lengths(column).all():
            return f"`metrics/{name}` that is not a length"
    for name in ("volume", "volume_reconstructed"):
        if (np.abs(getattr(metrics, name)) > MAX_LENGTH**3).any():
            return f"`metrics/{name}` that is not finite, or too large"
    return None


def check_finite(frames: Sequence[int] | Integers, cages: Floats, metrics: FrameMetrics) -> None:
    """Check that the cages and metrics of frames, given by number, are finite and not too large."""
    fault = find_invalid_metric(metrics)
    if fault is not None or not are_lengths(np.abs(cages)).all():
        raise NumericalError(
            f"the solve gave {fault or 'cages that are not finite, or too large,'} in frames "
            f"{frames[0]} to {frames[-1]}, counted from 0; scale the scene to coordinates near 1"
        )
