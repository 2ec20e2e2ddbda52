"""Result files, read with every check: the result, and what its frames are rebuilt from."""

import glob
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from cageik_cli.fit.settings import FitRecord
from cageik_cli.formats.base.hdf5 import (
    get_dataset,
    open_checked,
    read_array,
    read_attribute,
    read_texts,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.metrics import (
    FrameMetrics,
    KeptMetrics,
    are_lengths,
)
from cageik_cli.method.weights.binding import Binding, Correction, reconstruct_frames
from cageik_cli.store import fit_fields
from cageik_cli.store.fit_fields import BaselineErrors, read_fit_record, read_offset_mark
from cageik_cli.store.hdf5_fields import (
    check_format,
    has_format,
    read_floats,
    read_meshes,
    read_version,
)
from cageik_cli.store.result_fields import (
    ResultHeader,
    ResultSizes,
    ResultSummary,
    read_fields,
    read_frame_metrics,
    read_kept_metrics,
    read_skipped,
)
from cageik_cli.util.arrays import Floats, Integers, fill_gaps
from cageik_cli.util.errors import CheckpointError, FileAccessError, FormatError, SettingError
from cageik_cli.util.messages import Said, say

RESULT_FORMAT, RESULT_SCHEMA = "cageik.result", 1
"""What a result file says that it is; raise the number when older versions cannot read it."""

CHECKPOINT_SUFFIX = ".partial"


MIN_KEY_FRAMES, MAX_KEY_FRAMES = 3, 4
"""Frames that are kept in full: the worst, the median, the best, and that of the worst region."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Result(ResultHeader, ResultSummary):
    """The content of a result file, without the cages and the weights.

    Attributes
    ----------
    version : str
        Of the program that wrote it.
    frames : tuple of str
        The source of each of the F frames.
    rest, cage : TriMesh
        The rest pose, m vertices, and its cage, n vertices.
    metrics : FrameMetrics
        nan for a frame that was skipped, and a worst vertex of -1.
    kept : KeptMetrics, optional
        Metrics over the vertices that were kept; None if all counted alike in all frames.
    fit : FitRecord, optional
        How the weights were fitted to clips, and how well they fit.
    has_offsets : bool
        As of `Binding`.
    scene, settings, notes, quality, edited_from
        As of `ResultHeader`.
    vertex_rms, regions, bound, filled, sources, skipped
        As of `ResultSummary`.

    Examples
    --------
    >>> from cageik_cli import extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> result.rest, result.cage
    (<TriMesh: 1570 vertices, 3136 triangles>, <TriMesh: 80 vertices, 156 triangles>)
    >>> result.frames[int(result.metrics.rms.argmax())]
    'walker_26.obj'
    """

    path: Path
    version: str
    frames: tuple[str, ...]
    rest: TriMesh
    cage: TriMesh
    metrics: FrameMetrics
    kept: KeptMetrics | None = None
    fit: FitRecord | None = None
    has_offsets: bool = False

    @property
    def gaps(self) -> list[int]:
        """Return the skipped frames that have no cage."""
        return sorted(set(self.skipped) - set(self.filled))

    def __repr__(self) -> str:
        return (
            f"<Result: {self.path.name}, {len(self.frames)} frames of {len(self.rest.vertices)} "
            f"vertices in a cage of {len(self.cage.vertices)}>"
        )


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


def checkpoint_path(path: Path) -> Path:
    """Return the path of the checkpoint of the run that writes the result at `path`."""
    return path.with_name(path.name + CHECKPOINT_SUFFIX)


def placed_path(path: Path) -> Path:
    """Return the path of the frames whose occluded vertices are placed, until `path` is written."""
    return path.with_name(path.name + ".placed" + CHECKPOINT_SUFFIX)


def smoothed_path(path: Path) -> Path:
    """Return the path of the frames that are smoothed, until the result at `path` is written."""
    return path.with_name(path.name + ".smooth" + CHECKPOINT_SUFFIX)


def read_cages(result: Result, size: int, first: int = 0) -> Iterator[Floats]:
    """Yield the cages from frame `first` on, in blocks of at most `size`, (k, n, 3), gaps filled.

    The cage of a skipped frame is interpolated linearly between the frames before and after; at
    either end of the clip it is that of the nearest frame.
    """
    known = np.setdiff1d(np.arange(len(result.frames)), result.gaps)
    with open_checked(result.path) as file:
        cages = get_dataset(file, "verts", "f", (len(result.frames), len(result.cage.vertices), 3))
        for start in range(first, len(cages), size):
            block = np.asarray(cages[start : start + size], np.float64)
            fill_gaps(block, start, known, cages.__getitem__)
            wrong = np.flatnonzero(~np.isfinite(block).all(axis=(1, 2)))
            if len(wrong):
                name = result.frames[start + wrong[0]]
                raise FormatError(f"the cage of {name} is not finite")
            yield block


def has_weights(result: Result) -> bool:
    """Return whether a result was written with its weights."""
    with open_checked(result.path) as file:
        return fit_fields.holds_weights(file)


def read_weights(result: Result) -> Floats | None:
    """Read the weights of a result, (m, n); None if it was written without."""
    shape = (len(result.rest.vertices), len(result.cage.vertices))
    with open_checked(result.path) as file:
        return fit_fields.read_weights(file, *shape) if fit_fields.holds_weights(file) else None


def is_result(path: Path) -> bool:
    """Return whether an HDF5 file says that it is a result of cageik."""
    with open_checked(path) as file:
        return has_format(file, RESULT_FORMAT)


def read_result(path: Path) -> Result:
    """Read and check a result file.

    Raises
    ------
    InputError
        When it is not HDF5, not a result, of another schema, not complete, or damaged.
    """
    if not path.exists():
        raise FileAccessError(f"{path}: no such file; " + _suggest_instead(path))
    if path.suffix == CHECKPOINT_SUFFIX:
        raise CheckpointError(
            f"{path}: is a checkpoint, not a result; " + say("rerun the command with `resume=True`")
        )
    if path.is_dir() or (path.is_file() and not h5py.is_hdf5(path)):
        found = "a folder" if path.is_dir() else "not an HDF5 file"
        raise FormatError(
            f"{path}: is {found}, expected the result of cageik extract, such as cages.h5; extract "
            "one from frames, or look at the file by cageik info"
        )
    with open_checked(path) as file:
        _check_result_format(file)
        rest, cage = read_meshes(file)
        frames = len(get_dataset(file, "verts", "f", (None, len(cage.vertices), 3)))
        skipped = read_skipped(file, frames)
        sizes = ResultSizes(frames, len(rest.vertices), len(cage.faces), skipped)
        return Result(
            path=path,
            version=read_version(file),
            frames=read_texts(file, "frames/name", frames),
            rest=rest,
            cage=cage,
            metrics=read_frame_metrics(file, sizes),
            kept=read_kept_metrics(file, sizes),
            fit=read_fit_record(file),
            has_offsets=read_offset_mark(file),
            **read_fields(file, sizes),
        )


def _check_result_format(file: h5py.File) -> None:
    check_format(file, RESULT_FORMAT, RESULT_SCHEMA, "a result of cageik extract")
    complete = read_attribute(file, "complete")
    if not (isinstance(complete, np.bool_) and complete):
        raise FormatError(
            "is not complete: the run that wrote it was interrupted; extract it again"
        )


def _suggest_instead(path: Path) -> Said:
    checkpoint_file = checkpoint_path(path)
    if checkpoint_file.exists():
        return f"there is a checkpoint, {checkpoint_file.name}; " + say(
            "rerun the command with `resume=True`"
        )
    if glob.has_magic(str(path)):
        return "it is a pattern; name the files, or write it without quotes"
    return "create it with cageik extract, or give another"


def read_low_rank(result: Result) -> Correction | None:
    """Read what a fit of low rank added to the computed weights; None if there is no such fit."""
    shape = len(result.rest.vertices), len(result.cage.vertices)
    with open_checked(result.path) as file:
        return fit_fields.read_low_rank(file, result.fit, *shape)


def read_baseline_errors(result: Result) -> BaselineErrors | None:
    """Read what a result keeps of the weights before the fit; None if it keeps nothing."""
    shape = len(result.rest.vertices), len(result.cage.vertices)
    with open_checked(result.path) as file:
        return fit_fields.read_baseline_errors(file, shape, len(result.frames), result.skipped)


def read_binding(result: Result) -> Binding | None:
    """Read the binding of a result; None if it was written without weights.

    Its settings are not read.
    """
    weights = read_weights(result)
    if weights is None:
        return None
    read_low_rank(result)  # refuses weights of another form than their fit has
    return Binding(result.rest, result.cage, weights, has_offsets=result.has_offsets)


def load_binding(result: Result, user: str) -> Binding:
    """Read the binding of a result, which `user` needs.

    Raises
    ------
    SettingError
        When the result was written without weights.
    """
    binding = read_binding(result)
    if binding is None:
        raise make_weights_error(result.path, user)
    return binding


def make_weights_error(path: Path, user: str) -> SettingError:
    """Make the error of a result that was written without weights; `user` is what needs them."""
    return SettingError(
        f"{path}: has no weights, which {user} needs; "
        + say("extract it again with them (`keep_weights=True`)")
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
            name = result.frames[int(np.argmax(wrong))]
            raise FormatError(f"`rotations` of {name} are not a rotation; extract it again")
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
