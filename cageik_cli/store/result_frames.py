"""Read what a result holds to rebuild its frames: binding, fit, rotations and key frames."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.binding import Binding, Correction, reconstruct_frames
from cageik_cli.formats.base.hdf5 import get_dataset, open_checked, read_array
from cageik_cli.solver.metrics import are_lengths
from cageik_cli.store import fit_fields
from cageik_cli.store.fit_fields import UnfittedClip
from cageik_cli.store.hdf5_fields import read_floats
from cageik_cli.store.result import Result, read_weights
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError

MIN_KEY_FRAMES, MAX_KEY_FRAMES = 3, 4
"""Frames that are kept in full: the worst, the median, the best, and that of the worst region."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyFrames:
    """The worst, the median and the best frame: reconstructions and their errors.

    A fourth is that of the worst region, if it is not among them.

    Attributes
    ----------
    indices : (k,) int64
        Their numbers in the clip.
    cages : (k, n, 3) float64
    reconstructed : (k, m, 3) float64
        v̂, the weights times the cages, and the turned offsets if there are any.
    errors : (k, m, 3) float64
        v − v̂, in diagonals of the rest model; nan for vertices that are missing in a frame.
    """

    indices: Integers
    cages: Floats
    reconstructed: Floats
    errors: Floats


def read_low_rank(result: Result) -> Correction | None:
    """Read what a fit of low rank added to the computed weights; None if there is no such fit."""
    shape = len(result.rest.vertices), len(result.cage.vertices)
    with open_checked(result.path) as file:
        return fit_fields.read_low_rank(file, result.fit, *shape)


def read_unfitted(result: Result) -> UnfittedClip | None:
    """Read what a result keeps of the weights before the fit; None if it keeps nothing."""
    shape = len(result.rest.vertices), len(result.cage.vertices)
    with open_checked(result.path) as file:
        return fit_fields.read_unfitted(file, shape, len(result.frames), result.skipped)


def read_binding(result: Result) -> Binding | None:
    """Read the binding of a result; None if it was written without weights.

    Its settings are not read.
    """
    weights = read_weights(result)
    if weights is None:
        return None
    return Binding(
        rest=result.rest,
        cage=result.cage,
        weights=weights,
        has_offsets=result.has_offsets,
        fit=result.fit,
        low_rank=read_low_rank(result),
    )


def read_rotations(result: Result) -> Floats:
    """Read the rotations from the rest pose to each frame, (F, 3, 3); `points @ R` turns points.

    A skipped frame that was not filled has that of the nearest frame.
    """
    count = len(result.frames)
    known = np.setdiff1d(np.arange(count), result.gaps)
    with open_checked(result.path) as file:
        rotations = read_floats(file, "rotations", (count, 3, 3))
        with np.errstate(over="ignore", invalid="ignore"):
            products = rotations @ rotations.swapaxes(1, 2)
            wrong = ~(np.abs(products - np.eye(3)) < 1e-9).all(axis=(1, 2))  # RRᵀ is not I
            wrong |= ~(np.linalg.det(np.where(np.isfinite(rotations), rotations, 0)) > 0)
        wrong[result.gaps] = False
        if wrong.any():
            raise FormatError(
                f"`rotations` of frame {int(np.argmax(wrong))} are not a rotation; extract it again"
            )
    nearest = known[np.abs(known[None] - np.arange(count)[:, None]).argmin(axis=1)]
    return np.asarray(rotations[nearest])


def read_key_frames(result: Result, binding: Binding) -> KeyFrames:
    """Read the frames that are kept in full in a result with weights."""
    m, n, count = *binding.weights.shape, len(result.frames)
    rotations = read_rotations(result) if binding.has_offsets else None
    with open_checked(result.path) as file:
        frames = read_array(file, "poses/frame", "iu", (None,)).astype(np.int64)
        if not MIN_KEY_FRAMES <= len(frames) <= MAX_KEY_FRAMES:
            raise FormatError(
                f"`poses/frame` names {len(frames)} frames, expected {MIN_KEY_FRAMES} or "
                f"{MAX_KEY_FRAMES}; extract it again"
            )
        misses = read_floats(file, "poses/misses", (len(frames), m, 3))
        if not ((frames >= 0) & (frames < count)).all():
            raise FormatError(
                f"`poses/frame` names frames that are not in the clip ({count} frames); extract it "
                "again"
            )
        cages = get_dataset(file, "verts", "f", (count, n, 3))
        posed = np.stack([np.asarray(cages[k], np.float64) for k in frames])
        is_missing = np.isnan(misses) if result.kept is not None else np.zeros(misses.shape, bool)
        if not (
            are_lengths(np.abs(posed)).all() and (are_lengths(np.abs(misses)) | is_missing).all()
        ):
            raise FormatError("`poses` are not finite, or too large; extract it again")
    turns = None if rotations is None else rotations[frames]
    return KeyFrames(frames, posed, reconstruct_frames(binding, posed, turns), misses)
