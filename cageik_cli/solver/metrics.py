"""Errors of reconstructions relative to their frames: RMS, deviation and volume."""

from dataclasses import dataclass, fields

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
class FrameErrors:
    """Metrics and squared errors of k frames.

    Attributes
    ----------
    squared_errors : (k, m) float64
        |v̂_i − v_i|², nan for vertices that are missing data; in workspace memory, if one was given.
    """

    metrics: FrameMetrics
    squared_errors: Floats


def measure(
    rest: TriMesh,
    frames: Floats,
    reconstructions: Floats,
    data_vertices: slice | Integers,
    workspace: Workspace | None = None,
) -> FrameErrors:
    """Measure the errors of reconstructions relative to their frames.

    Parameters
    ----------
    rest : TriMesh
        Its faces define the volume.
    frames, reconstructions : (k, m, 3)
    data_vertices : slice or (c,) int64
        Vertices that are data: all in a face but those of vertex weight 0.
    workspace : Workspace, optional
        Memory to reuse.
    """
    is_data = np.zeros(frames.shape[1], bool)
    is_data[data_vertices] = True
    has_volume = rest.is_body and is_data[rest.used_vertices].all()
    faces = rest.faces if has_volume else rest.faces[:0]
    compare = _compare_in_numpy if compiled.kernel is None else _compare
    sums, worst, squares = compare(
        frames, reconstructions, is_data, faces, workspace or Workspace()
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
    return FrameErrors(metrics, squares)


Comparison = tuple[Floats, Integers, Floats]
"""Of k frames: sums (k, 5), worst vertices (k,), and squared errors (k, m).

The sums are those of |v̂ − v|², their largest, that of |v − centroid|², and six times the signed
volumes of v and v̂.
"""


def _compare(
    frames: Floats, reconstructions: Floats, is_data: Mask, faces: Integers, workspace: Workspace
) -> Comparison:
    """Compare frames with their reconstructions, compiled."""
    sums, worst = np.empty((len(frames), 5)), np.empty(len(frames), np.int64)
    squares = workspace.array("squares", *frames.shape[:2])
    compiled.kernel.compare_frames(
        np.ascontiguousarray(frames, np.float64),
        np.ascontiguousarray(reconstructions, np.float64),
        is_data.view(np.uint8),
        np.ascontiguousarray(faces),
        squares,
        sums,
        worst,
    )
    return sums, worst, squares


def _compare_in_numpy(
    frames: Floats, reconstructions: Floats, is_data: Mask, faces: Integers, workspace: Workspace
) -> Comparison:
    """Compare frames with their reconstructions where nothing is compiled: the reference."""
    errors = workspace.array("errors", *frames.shape)
    np.subtract(reconstructions, frames, out=errors)
    squares = np.einsum("kjx,kjx->kj", errors, errors)
    compared = np.where(is_data, squares, -1.0)
    counted = np.where(is_data, squares, 0.0)
    centroids = is_data @ frames / np.count_nonzero(is_data)
    centred = np.subtract(frames, centroids[:, None], out=errors)
    sums = np.zeros((len(frames), 5))
    sums[:, 0] = counted.sum(axis=1)
    sums[:, 1] = compared.max(axis=1)
    sums[:, 2] = np.where(is_data, np.einsum("kjx,kjx->kj", centred, centred), 0.0).sum(axis=1)
    if len(faces):
        for column, positions in enumerate((frames, reconstructions), start=3):
            sums[:, column] = 6 * signed_volumes(positions, faces)
    return sums, compared.argmax(axis=1).astype(np.int64), squares


@dataclass(frozen=True, slots=True, eq=False)
class KeptMetrics:
    """Metrics of k frames over the vertices that were kept, each an array (k,).

    Attributes
    ----------
    missing : int64
        Vertices that are not data.
    rejected : int64
        Vertices that are data, and were rejected as outliers.
    rms_kept, max_deviation_kept : float64
        As in `FrameMetrics`, over data that was not rejected.
    """

    missing: Integers
    rejected: Integers
    rms_kept: Floats
    max_deviation_kept: Floats


KEPT_TYPES = {
    field.name: "i8" if field.name in ("missing", "rejected") else "f8"
    for field in fields(KeptMetrics)
}
"""The names of the metrics over what was kept, and the types of their columns."""


@dataclass(frozen=True, slots=True, eq=False)
class KeptErrors:
    """Errors of frames whose vertices count differently.

    Attributes
    ----------
    errors : FrameErrors
        Metrics over all data; squared errors are nan for vertices that were not kept.
    """

    errors: FrameErrors
    metrics: KeptMetrics


def measure_kept(
    rest: TriMesh, frames: Floats, reconstructions: Floats, is_data: Mask, is_kept: Mask
) -> KeptErrors:
    """Measure the errors of reconstructions over data, and over what was kept of it.

    Volumes are of frames that are all data, with the reconstruction where a vertex was rejected.

    Parameters
    ----------
    frames, reconstructions : (k, m, 3)
    is_data, is_kept : (k, m) bool
        What was kept is data.
    """
    errors = reconstructions - frames
    squares = np.einsum("kjx,kjx->kj", errors, errors)
    over_data = np.where(is_data, squares, -1.0)
    worst = over_data.argmax(axis=1)
    volume = volume_rebuilt = np.full(len(frames), np.nan)
    is_whole = is_data[:, rest.used_vertices].all(axis=1) & rest.is_body
    whole = np.flatnonzero(is_whole)
    if len(whole):
        volume, volume_rebuilt = volume.copy(), volume.copy()
        mended = np.where(is_kept[whole, :, None], frames[whole], reconstructions[whole])
        volume[whole] = signed_volumes(mended, rest.faces)
        volume_rebuilt[whole] = signed_volumes(reconstructions[whole], rest.faces)
    counts = np.maximum(is_data.sum(axis=1), 1)
    centroids = np.einsum("kj,kjx->kx", is_data, frames) / counts[:, None]
    spread = np.einsum("kjx,kj->k", (frames - centroids[:, None]) ** 2, is_data) / counts
    over_kept = np.where(is_kept, squares, 0.0)
    metrics = FrameMetrics(
        rms=np.sqrt(np.where(is_data, squares, 0.0).sum(axis=1) / counts),
        max_deviation=np.sqrt(np.maximum(over_data.max(axis=1), 0)),
        worst_vertex=worst.astype(np.int64),
        volume=volume,
        volume_reconstructed=volume_rebuilt,
        spread=np.sqrt(spread),
    )
    kept = KeptMetrics(
        missing=(~is_data).sum(axis=1),
        rejected=(is_data & ~is_kept).sum(axis=1),
        rms_kept=np.sqrt(over_kept.sum(axis=1) / np.maximum(is_kept.sum(axis=1), 1)),
        max_deviation_kept=np.sqrt(over_kept.max(axis=1)),
    )
    return KeptErrors(FrameErrors(metrics, np.where(is_kept, squares, np.nan)), kept)


METRIC_TYPES = {
    field.name: "i8" if field.name == "worst_vertex" else "f8" for field in fields(FrameMetrics)
}
"""The names of the metrics of frames, and the types of their columns."""


def are_lengths(values: Floats) -> np.ndarray:
    """Return which values can be lengths; nan cannot."""
    return np.asarray((values >= 0) & (values <= MAX_LENGTH))


def find_invalid_metric(metrics: FrameMetrics) -> str | None:
    """Return a description of an invalid metric, or None; volumes may be nan."""
    for name in ("rms", "max_deviation", "spread"):
        column = getattr(metrics, name)
        if not are_lengths(column).all():
            return f"`metrics/{name}` that is not a length"
    for name in ("volume", "volume_reconstructed"):
        if np.isinf(getattr(metrics, name)).any():
            return f"`metrics/{name}` that is not finite"
    return None


def check_finite(start: int, cages: Floats, metrics: FrameMetrics) -> None:
    """Check that the cages and metrics of frames from `start` on are finite and not too large.

    Raises
    ------
    NumericalError
    """
    fault = find_invalid_metric(metrics)
    if fault is not None or not np.isfinite(cages).all():
        raise NumericalError(
            f"the solve gave {fault or 'cages that are not finite'} in frames {start} to "
            f"{start + len(cages) - 1}; scale the scene to coordinates near 1"
        )
