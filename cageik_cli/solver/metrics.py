"""How near a reconstruction is to its frame: RMS, deviation and volume."""

from dataclasses import dataclass, fields

import numpy as np

from cageik_cli.geometry.mesh import TriMesh, signed_volumes
from cageik_cli.util.arrays import Floats, Integers, Scratch
from cageik_cli.util.errors import NumericalError

LARGEST_LENGTH = 1e60
"""Far above any figure of positions that are taken; its square does not overflow."""

WHOLE_FIGURES = ("worst_vertex",)


@dataclass(frozen=True, slots=True, eq=False)
class FrameFigures:
    """Figures of k frames, each an array (k,); lengths in file units.

    Attributes
    ----------
    rms : float64
        sqrt(mean_i |v̂_i − v_i|²).
    max_deviation : float64
        max_i |v̂_i − v_i|.
    worst_vertex : int64
        Where it is.
    volume, volume_reconstructed : float64
        Signed volumes of v and v̂; nan for an open model, or when vertices are missing data.
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
class Measured:
    """What is known of k frames when they are measured.

    Attributes
    ----------
    figures : FrameFigures
    squares : (k, m) float64
        |v̂_i − v_i|², nan for vertices that are missing data.
    """

    figures: FrameFigures
    squares: Floats


def measure(
    rest: TriMesh,
    frames: Floats,
    rebuilt: Floats,
    counted: slice | Integers,
    scratch: Scratch | None = None,
) -> Measured:
    """Compare reconstructions with their frames.

    Parameters
    ----------
    rest : TriMesh
        For the faces, and whether they enclose a volume.
    frames, rebuilt : (k, m, 3)
    counted : slice or (c,) int64
        The vertices that are data; all but those of vertex weight 0.
    scratch : Scratch, optional
        Memory to use.
    """
    misses = (scratch or Scratch()).array("misses", *frames.shape)
    np.subtract(rebuilt, frames, out=misses)
    all_squares = np.einsum("kjx,kjx->kj", misses, misses)
    squares = all_squares[:, counted]
    worst = squares.argmax(axis=1)
    numbers = np.arange(frames.shape[1])[counted]
    data = frames[:, counted]
    centroids = np.full(len(numbers), 1 / len(numbers)) @ data
    centred = np.subtract(data, centroids[:, None], out=misses[:, : len(numbers)])
    if rest.is_closed and len(numbers) == frames.shape[1]:
        volume, volume_rebuilt = (signed_volumes(v, rest.faces) for v in (frames, rebuilt))
    else:
        volume = volume_rebuilt = np.full(len(frames), np.nan)
    figures = FrameFigures(
        rms=np.sqrt(squares.mean(axis=1)),
        max_deviation=np.sqrt(np.take_along_axis(squares, worst[:, None], axis=1)[:, 0]),
        worst_vertex=numbers[worst].astype(np.int64),
        volume=volume,
        volume_reconstructed=volume_rebuilt,
        spread=np.sqrt(np.einsum("kjx,kjx->k", centred, centred) / len(numbers)),
    )
    if len(numbers) < frames.shape[1]:
        missing = np.delete(np.arange(frames.shape[1]), numbers)
        all_squares[:, missing] = np.nan
    return Measured(figures, all_squares)


FIGURES = tuple(field.name for field in fields(FrameFigures))


def are_lengths(values: Floats) -> np.ndarray:
    """Which of them can be lengths; nan is none."""
    return np.asarray((values >= 0) & (values <= LARGEST_LENGTH))


def fault_of(figures: FrameFigures) -> str | None:
    """What cannot be a figure, in words; volumes may be nan."""
    for name in ("rms", "max_deviation", "spread"):
        column = getattr(figures, name)
        if not are_lengths(column).all():
            return f"`metrics/{name}` that is no length"
    for name in ("volume", "volume_reconstructed"):
        if np.isinf(getattr(figures, name)).any():
            return f"`metrics/{name}` that is not finite"
    return None


def refuse_unsound(start: int, cages: Floats, figures: FrameFigures) -> None:
    """Refuse frames from `start` on that are not finite, or too large to be read again.

    Raises
    ------
    NumericalError
    """
    fault = fault_of(figures)
    if fault is not None or not np.isfinite(cages).all():
        raise NumericalError(
            f"the solve gave {fault or 'cages that are not finite'} in frames {start} to "
            f"{start + len(cages) - 1}; scale the scene to coordinates near 1"
        )
