"""Results of `extract` and edits of their animations: their files, written, and read with checks.

Both hold a cage animation and what its meshes are rebuilt from. What else they hold is declared at
their records, `Result` and `Edit`: how each field is written, read, checked, shown and exported.
"""

import glob
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

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
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.rotations import are_rotations
from cageik_cli.method.solve.dual_laplacian import SolveQuality
from cageik_cli.method.solve.metrics import (
    KEPT_TYPES,
    METRIC_TYPES,
    FrameMetrics,
    KeptMetrics,
    are_lengths,
)
from cageik_cli.method.solve.regions import Region
from cageik_cli.method.solve.summary import VertexBound
from cageik_cli.method.weights.binding import Binding, Correction, Poses, reconstruct_frames
from cageik_cli.store import fit_fields, result_fields
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.fit_fields import MAX_STORED_ERROR, BaselineErrors
from cageik_cli.store.hdf5_fields import (
    SourceRecord,
    check_schema,
    create_hdf5,
    has_format,
    read_floats,
    read_json_attr,
    read_meshes,
    read_notes,
    read_optional_record,
    read_record,
    read_scene,
    read_sources,
    read_text_attr,
    read_version,
    write_meshes,
)
from cageik_cli.store.result_fields import ClipSizes, declare_field, list_fields
from cageik_cli.store.tried_steps import (
    HiddenErrors,
    TriedStep,
    read_hidden_errors,
    read_tried_steps,
)
from cageik_cli.util.arrays import Floats, Integers, fill_gaps
from cageik_cli.util.errors import (
    CheckpointError,
    FileAccessError,
    FormatError,
    SettingError,
    error_context,
)
from cageik_cli.util.files import open_content
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.outputs import DeferredErrorFile, atomic_file
from cageik_cli.util.version import __version__

ANIMATION_SCHEMA = 1
"""Of the files of results and of edits; raise the number when older versions cannot read them."""

CHECKPOINT_SUFFIX = ".partial"


MIN_KEY_FRAMES, MAX_KEY_FRAMES = 3, 4
"""Frames that are kept in full: the worst, the median, the best, and that of the worst region."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StoredAnimation:
    """The content of the file of a result or an edit, without the cages and the weights.

    Attributes
    ----------
    FORMAT : str
        What the attribute `format` of its files says.
    version : str
        Of the program that wrote it.
    frames : tuple of str
        The source of each of the F frames.
    rest, cage : TriMesh
        The rest pose, m vertices, and its cage, n vertices.
    settings : dict
        The settings of the run.
    sources : dict
        Name and digest of each file that was read.
    skipped : dict
        By number in the clip, why a frame was skipped.
    notes : tuple of Note
        What was changed or left out, one sentence each.
    quality : SolveQuality
        How good the weights are.
    metrics : FrameMetrics
        nan for a frame that was skipped, and a worst vertex of -1.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) of each vertex over the frames that were not skipped; nan for vertices
        that are missing data.
    fit : FitRecord, optional
        How the weights were fitted to clips, and how well they fit. Like `has_offsets`, it is
        written with the weights, whose form depends on it.
    has_offsets : bool
        As of `Binding`.
    """

    FORMAT: ClassVar[str]

    path: Path
    rest: TriMesh
    cage: TriMesh
    version: str = declare_field(
        lambda file, _: read_version(file), write=result_fields.write_plain
    )
    frames: tuple[str, ...] = declare_field(
        lambda file, sizes: read_texts(file, "frames/name", sizes.frames),
        write=result_fields.write_names,
    )
    scene: Scene = declare_field(
        lambda file, _: read_scene(file),
        write=result_fields.write_scene,
        show=result_fields.show_scene,
    )
    settings: dict[str, Any] = declare_field(
        lambda file, _: read_json_attr(file, "settings", dict),
        show=lambda clip: [("settings", ", ".join(f"{k} {v}" for k, v in clip.settings.items()))],
        export="settings",
    )
    sources: dict[str, SourceRecord] = declare_field(
        lambda file, _: read_sources(file),
        show=lambda clip: [(f"from {k}", str(v.get("name"))) for k, v in clip.sources.items()],
        export="sources",
    )
    skipped: dict[int, Said] = declare_field(
        lambda _, sizes: sizes.skipped,
        write=result_fields.write_skipped,
        show=result_fields.show_skipped,
    )
    notes: tuple[Note, ...] = declare_field(lambda file, _: read_notes(file))
    quality: SolveQuality = declare_field(
        lambda file, _: read_record(file, "quality", SolveQuality), export="binding"
    )
    metrics: FrameMetrics = declare_field(result_fields.read_frame_metrics, columns=METRIC_TYPES)
    vertex_rms: Floats = declare_field(
        result_fields.read_vertex_rms, write=result_fields.write_vertex_rms
    )
    fit: FitRecord | None = declare_field(
        lambda file, _: fit_fields.read_fit_record(file), default=None, export="fit"
    )
    has_offsets: bool = declare_field(
        lambda file, _: fit_fields.read_offset_mark(file),
        write=result_fields.write_plain,
        default=False,
    )

    @property
    def shape(self) -> tuple[int, int]:
        """Return how many vertices the model and the cage have: the shape of the weights."""
        return len(self.rest.vertices), len(self.cage.vertices)

    @property
    def gaps(self) -> list[int]:
        """Return the skipped frames that have no cage."""
        return sorted(self.skipped)

    @property
    def worst_region(self) -> Region | None:
        """Return where the clip is followed worst, by far; None if there is no such region."""
        return None

    def __repr__(self) -> str:
        kind, (m, n) = type(self).__name__, self.shape
        frames = len(self.frames)
        return f"<{kind}: {self.path.name}, {frames} frames of {m} vertices in a cage of {n}>"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Result(StoredAnimation):
    """The content of a result of `extract`, without the cages and the weights.

    Its metrics compare the frames, v, with their reconstruction, v̂.

    Attributes
    ----------
    kept : KeptMetrics, optional
        Metrics over the vertices that were kept; None if all counted alike in all frames.
    regions : tuple of Region, optional
        The worst regions, the worst first; none if the largest deviation is within the usual. None
        if the result was written by a version that did not look for them.
    bound : VertexBound, optional
        The error of the best possible cage animation of the clip.
    filled : tuple of int
        Skipped frames whose cages were filled from those around them.
    tried : tuple of TriedStep
        What was tried on some frames, and how much it helped; nothing where the error is small.
    hidden : HiddenErrors, optional
        Errors of vertices that were hidden on purpose; None if none are missing.

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

    FORMAT = "cageik.result"

    kept: KeptMetrics | None = declare_field(
        result_fields.read_kept_metrics, columns=KEPT_TYPES, default=None
    )
    regions: tuple[Region, ...] | None = declare_field(result_fields.read_regions, default=None)
    bound: VertexBound | None = declare_field(
        lambda file, _: read_optional_record(file, "bound", VertexBound),
        default=None,
        export="bound",
    )
    filled: tuple[int, ...] = declare_field(
        result_fields.read_filled, write=result_fields.write_list, default=()
    )
    tried: tuple[TriedStep, ...] = declare_field(
        lambda file, _: read_tried_steps(file), write=result_fields.write_list, default=()
    )
    hidden: HiddenErrors | None = declare_field(
        lambda file, _: read_hidden_errors(file), default=None, export="hidden"
    )

    @property
    def gaps(self) -> list[int]:
        """Return the skipped frames that have no cage."""
        return sorted(set(self.skipped) - set(self.filled))

    @property
    def worst_region(self) -> Region | None:
        """Return where the clip is followed worst, by far; None if there is no such region."""
        return next(iter(self.regions or ()), None)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Edit(StoredAnimation):
    """The content of an edit by `pose`, without the cages and the weights.

    Its metrics compare the meshes before the edit, v, with those after it, v̂.

    Attributes
    ----------
    edited_from : str
        The name of the result or the edit that it was made from.

    Examples
    --------
    >>> from cageik_cli import edit_to_file, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> edit_to_file(result, f"{walker}/wave.json", "waving.h5")
    <Edit: waving.h5, 48 frames of 1570 vertices in a cage of 80>
    """

    FORMAT = "cageik.edit"

    edited_from: str = declare_field(
        lambda file, _: read_text_attr(file, "edited_from"),
        write=result_fields.write_plain,
        export="edited_from",
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


def read_cages(result: StoredAnimation, size: int, first: int = 0) -> Iterator[Floats]:
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
            wrong = np.flatnonzero(~are_lengths(np.abs(block)).all(axis=(1, 2)))
            if len(wrong):
                name = result.frames[start + wrong[0]]
                raise FormatError(
                    f"the cage of {name} is not finite, or too large; extract it again"
                )
            yield block


def read_poses(result: StoredAnimation, size: int, first: int = 0) -> Iterator[Poses]:
    """Yield what the weights make meshes of, from frame `first` on, in blocks as of `read_cages`.

    Only where weights have offsets, rotations are read.
    """
    rotations = read_rotations(result)[first:] if result.has_offsets else None
    start = 0
    for cages in read_cages(result, size, first):
        stop = start + len(cages)
        yield Poses(cages, None if rotations is None else rotations[start:stop])
        start = stop


def has_weights(result: StoredAnimation) -> bool:
    """Return whether a result was written with its weights."""
    with open_checked(result.path) as file:
        return fit_fields.holds_weights(file)


def read_weights(result: StoredAnimation) -> Floats | None:
    """Read the weights of a result, (m, n); None if it was written without."""
    with open_checked(result.path) as file:
        is_held = fit_fields.holds_weights(file)
        return fit_fields.read_weights(file, *result.shape) if is_held else None


def is_result(path: Path) -> bool:
    """Return whether an HDF5 file says that it is a result of `extract`."""
    with open_checked(path) as file:
        return _find_kind(file) is Result


def is_animation(path: Path) -> bool:
    """Return whether an HDF5 file says that it is a result or an edit."""
    with open_checked(path) as file:
        return _find_kind(file) is not None


def _find_kind(file: h5py.File) -> type[Result] | type[Edit] | None:
    """Return the kind of record that a file holds; None if it is neither.

    In versions up to 0.1.0, an edit was a result that named what it was made from.
    """
    if has_format(file, Result.FORMAT):
        return Edit if "edited_from" in file.attrs else Result
    return Edit if has_format(file, Edit.FORMAT) else None


def read_result(path: Path) -> Result:
    """Read and check a result of `extract`.

    Raises
    ------
    InputError
        When it is not HDF5, not a result, of another schema, not complete, or damaged.
    """
    found = read_animation(path)
    if not isinstance(found, Result):
        raise FormatError(
            f"{path}: is an edit by cageik pose, expected a result of cageik extract; give one"
        )
    return found


def read_animation(path: Path) -> Result | Edit:
    """Read and check a result of `extract`, or an edit by `pose`.

    Raises
    ------
    InputError
        When it is not HDF5, neither of them, of another schema, not complete, or damaged.
    """
    if not path.exists():
        raise FileAccessError(f"{path}: no such file; " + _suggest_instead(path))
    if path.suffix == CHECKPOINT_SUFFIX:
        raise CheckpointError(
            f"{path}: is a checkpoint, not a result; " + say("rerun the command with `resume=True`")
        )
    with error_context(path):
        if path.is_file():
            open_content(path).close()
    if path.is_dir() or (path.is_file() and not h5py.is_hdf5(path)):
        found = "a folder" if path.is_dir() else "not an HDF5 file"
        raise FormatError(
            f"{path}: is {found}, expected the result of cageik extract, such as cages.h5; extract "
            "one from frames, or look at the file by cageik info"
        )
    with open_checked(path) as file:
        kind = _find_kind(file)
        if kind is None:
            raise FormatError("is not a result of cageik extract; give one")
        check_schema(file, ANIMATION_SCHEMA)
        complete = read_attribute(file, "complete")
        if not (isinstance(complete, np.bool_) and complete):
            raise FormatError(
                "is not complete: the run that wrote it was interrupted; extract it again"
            )
        rest, cage = read_meshes(file)
        frames = len(get_dataset(file, "verts", "f", (None, len(cage.vertices), 3)))
        skipped = result_fields.read_skipped(file, frames)
        sizes = ClipSizes(frames, len(rest.vertices), len(cage.faces), skipped)
        held = {name: one.read(file, sizes) for name, one in list_fields(kind).items()}
        return kind(path=path, rest=rest, cage=cage, **held)


def _suggest_instead(path: Path) -> Said:
    checkpoint_file = checkpoint_path(path)
    if checkpoint_file.exists():
        return f"there is a checkpoint, {checkpoint_file.name}; " + say(
            "rerun the command with `resume=True`"
        )
    if glob.has_magic(str(path)):
        return "it is a pattern; name the files, or write it without quotes"
    return "create it with cageik extract, or give another"


def read_low_rank(result: StoredAnimation) -> Correction | None:
    """Read what a fit of low rank added to the computed weights; None if there is no such fit."""
    with open_checked(result.path) as file:
        return fit_fields.read_low_rank(file, result.fit, *result.shape)


def read_baseline_errors(result: StoredAnimation) -> BaselineErrors | None:
    """Read what a result keeps of the weights before the fit; None if it keeps nothing."""
    with open_checked(result.path) as file:
        frames = len(result.frames)
        return fit_fields.read_baseline_errors(file, result.shape, frames, result.skipped)


def read_binding(result: StoredAnimation) -> Binding | None:
    """Read the binding of a result; None if it was written without weights.

    Its settings are not read.
    """
    weights = read_weights(result)
    if weights is None:
        return None
    read_low_rank(result)  # refuses weights of another form than their fit has
    return Binding(result.rest, result.cage, weights, has_offsets=result.has_offsets)


def load_binding(result: StoredAnimation, user: str) -> Binding:
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


def read_rotations(result: StoredAnimation) -> Floats:
    """Read the rotations from the rest pose to each frame, (F, 3, 3); `points @ R` turns points.

    A skipped frame that was not filled has that of the nearest frame.
    """
    count = len(result.frames)
    known = np.setdiff1d(np.arange(count), result.gaps)
    with open_checked(result.path) as file:
        rotations = read_floats(file, "rotations", (count, 3, 3))
        wrong = ~are_rotations(rotations)
        wrong[result.gaps] = False
        if wrong.any():
            name = result.frames[int(np.argmax(wrong))]
            raise FormatError(f"`rotations` of {name} are not a rotation; extract it again")
    numbers = np.arange(count)
    places = np.searchsorted(known, numbers)
    before, after = known[(places - 1).clip(0)], known[places.clip(max=len(known) - 1)]
    return np.asarray(rotations[np.where(numbers - before <= after - numbers, before, after)])


def read_key_frames(result: StoredAnimation, binding: Binding) -> KeyFrames:
    """Read the frames that are kept in full in a result with weights."""
    m, n, count = *binding.weights.shape, len(result.frames)
    rotations = read_rotations(result) if result.has_offsets else None
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
        has_missing = isinstance(result, Result) and result.kept is not None
        is_missing = np.isnan(misses) if has_missing else np.zeros(misses.shape, bool)
        if not (
            are_lengths(np.abs(posed)).all() and (are_lengths(np.abs(misses)) | is_missing).all()
        ):
            raise FormatError("`poses` are not finite, or too large; extract it again")
    poses = Poses(posed, None if rotations is None else rotations[frames])
    return KeyFrames(frames, posed, reconstruct_frames(binding, poses), misses)


class AnimationWriter:
    """Append blocks of cages and metrics to the open file of a result or an edit, in order.

    Parameters
    ----------
    kind : type
        `Result` or `Edit`.
    first : dict
        The fields that are known before the first frame is solved, by name.
    stored : StoredBinding
        The weights, and both meshes.
    frames : tuple of str
        The source of each frame.
    has_kept : bool
        Whether there are metrics over what was kept.
    """

    def __init__(
        self,
        file: h5py.File,
        sink: DeferredErrorFile,
        kind: type[StoredAnimation],
        first: Mapping[str, Any],
        *,
        stored: StoredBinding,
        frames: tuple[str, ...],
        keep_weights: bool,
        has_kept: bool,
    ) -> None:
        self._file, self._sink, self._stored = file, sink, stored
        self._fields, self._keep_weights = list_fields(kind), keep_weights
        self._frames_done, self._frame_count = 0, len(frames)
        cage, rest = stored.binding.cage, stored.binding.rest
        file.create_dataset("verts", (self._frame_count, *cage.vertices.shape), "f8")
        file.create_dataset("rotations", (self._frame_count, 3, 3), "f8")
        write_meshes(file, rest, cage)
        self._write({"frames": frames})
        for name in ("metrics", "kept") if has_kept else ("metrics",):
            for column, dtype in (self._fields[name].columns or {}).items():
                file.create_dataset(f"metrics/{column}", (self._frame_count,), dtype)
        file.attrs.update(format=kind.FORMAT, schema=ANIMATION_SCHEMA, version=__version__)
        self._write(first)
        file.attrs["complete"] = False

    def _write(self, values: Mapping[str, Any]) -> None:
        """Write fields, in the order of the values."""
        for name, value in values.items():
            self._fields[name].write(self._file, name, value)

    def append(self, poses: Poses, metrics: FrameMetrics, kept: KeptMetrics | None = None) -> None:
        """Write the poses and the metrics of the next frames, all finite but of skipped ones."""
        done = slice(self._frames_done, self._frames_done + len(poses))
        self._file["verts"][done] = poses.cages
        self._file["rotations"][done] = poses.rotations
        for name, value in (("metrics", metrics), ("kept", kept)):
            for column in (self._fields[name].columns or ()) if value is not None else ():
                self._file[f"metrics/{column}"][done] = getattr(value, column)
        self._sink.raise_deferred_error()
        self._frames_done = done.stop

    def complete(
        self,
        last: Mapping[str, Any],
        *,
        key_frames: Integers,
        key_frame_errors: Floats,
        unfitted: BaselineErrors | None = None,
    ) -> None:
        """Write the weights, the key frames and the other fields, and mark the file as complete.

        Parameters
        ----------
        last : dict
            The fields that are known after the last frame is solved, by name.
        key_frames : (3,) or (4,) int64
            Numbers of the worst, the median and the best frame, by rms; then that of the worst
            region, if it is another.
        key_frame_errors : (3 or 4, m, 3) float64
            Their v − v̂, which a report draws without reading frames.
        unfitted : BaselineErrors, optional
            The same clip with the weights before the fit, if they are fitted and both are known.
        """
        if self._frames_done != self._frame_count:
            raise ValueError(f"{self._frames_done} of {self._frame_count} frames were appended")
        file, stored = self._file, self._stored
        fit_fields.write_weights(
            file, stored.binding, stored.fit, stored.low_rank, self._keep_weights
        )
        if self._keep_weights:
            file.create_dataset("poses/frame", data=key_frames, dtype="i8")
            # In diagonals, so that they fit single precision in any units.
            misses = key_frame_errors / stored.binding.rest.diagonal
            misses = np.clip(misses, -MAX_STORED_ERROR, MAX_STORED_ERROR)
            file.create_dataset("poses/misses", data=misses, dtype="f4")
            if unfitted is not None:
                fit_fields.write_baseline_errors(file, unfitted)
        self._write(last)
        file.attrs["complete"] = True


@contextmanager
def open_animation_writer(
    path: Path,
    kind: type[StoredAnimation],
    first: Mapping[str, Any],
    *,
    stored: StoredBinding,
    frames: tuple[str, ...],
    overwrite: bool,
    keep_weights: bool = True,
    has_kept: bool = False,
    temporary_path: Path | None = None,
) -> Iterator[AnimationWriter]:
    """Write a result or an edit beside its name, renamed when the block ends without an error.

    Parameters
    ----------
    kind, first, stored, frames, has_kept
        As of `AnimationWriter`.
    temporary_path : Path, optional
        Names the file until then, if no other run can use that name.
    """
    with atomic_file(path, overwrite, temporary_path) as sink, create_hdf5(sink) as file:
        yield AnimationWriter(
            file,
            sink,
            kind,
            first,
            stored=stored,
            frames=frames,
            keep_weights=keep_weights,
            has_kept=has_kept,
        )
