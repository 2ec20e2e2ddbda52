"""The checkpoint of a run: a file of solved blocks beside the result, to which blocks are appended.

The first line names the format, the second holds the digest and the length of a JSON spec; then
follow the spec and the blocks, each behind its length and its checksum. Whenever a run is killed,
the blocks before the first damaged one are valid, and a run can continue after them. The result is
composed of the checkpoint in one pass, so it does not depend on how often the run was interrupted.

A block is held as a header, then one array after another. Digests tell damage, not intent: what a
checkpoint says is checked before it is used, as in a file of any other origin.
"""

import hashlib
import io
import json
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, get_origin

import numpy as np

from cageik_cli.geometry.rotations import are_rotations
from cageik_cli.method.solve.blocks import KeptBlock, SolvedBlock
from cageik_cli.method.solve.metrics import (
    KEPT_TYPES,
    METRIC_TYPES,
    DeviationPeaks,
    FrameMetrics,
    KeptMetrics,
    are_lengths,
    find_impossible_kept,
    find_invalid_metric,
    map_columns,
)
from cageik_cli.method.solve.summary import ClipSummary
from cageik_cli.store.result_fields import pack_reasons, unpack_reasons
from cageik_cli.util.arrays import Mask
from cageik_cli.util.errors import CheckpointError, FormatError, error_context, make_write_error
from cageik_cli.util.files import open_input, open_locked, remove_locked, set_size
from cageik_cli.util.json_files import parse_json
from cageik_cli.util.messages import Hint, Said, Text, join_texts, say
from cageik_cli.util.text import format_count
from cageik_cli.util.version import __version__

CHECKPOINT_START = b"cageik.partial "


CHECKPOINT_MAGIC = CHECKPOINT_START + b"10\n"
"""Raise its number when the spec, the bytes of blocks or the solve change, so that older ones are
refused."""

_RECORD_HEADER = struct.Struct("<QI")  # length and checksum of what follows


class UnknownFieldsError(Exception):
    """A spec has other fields than those of this version."""


@dataclass(frozen=True, slots=True)
class RunSpec:
    """What a run has to do, and what its numbers depend on.

    Attributes
    ----------
    settings, sources : dict
        The recorded settings; name and digest of each file that was read, all but the frames.
    key : str
        Digest of meshes, vertex weights and weights, before the fit if the run fits them.
    fit : str
        Digest of the weights that the run fits to its frames; empty if it fits none. If frames have
        changed, a continued run fits others, and solves all frames again.
    block_frames : int
        Frames of each block but the last.
    sampled_vertices : int
        Vertices whose displacements the blocks hold.
    weighs_frames : bool
        Whether the blocks hold what was kept.
    """

    frames: list[str]
    settings: dict[str, Any]
    sources: dict[str, Any]
    key: str
    fit: str
    vertices: int
    cage_vertices: int
    block_frames: int
    sampled_vertices: int
    weighs_frames: bool
    version: str = __version__

    @staticmethod
    def parse(text: bytes) -> "RunSpec":
        """Return the spec of JSON.

        Raises
        ------
        ValueError
            When it is not JSON, or holds something else than a spec.
        UnknownFieldsError
            When it holds other fields.
        """
        held = _parse_object(text)
        kinds = {field.name: field.type for field in fields(RunSpec)}
        if held.keys() != kinds.keys():
            raise UnknownFieldsError
        for name, value in held.items():
            kind = get_origin(kinds[name]) or kinds[name]
            if type(value) is not kind:
                raise ValueError(f"`{name}` is no {kind}")
            if kind is int and value < (name != "sampled_vertices"):
                raise ValueError(f"`{name}` is too small")
        if not held["frames"] or not all(type(name) is str for name in held["frames"]):
            raise ValueError("`frames` are no names")
        return RunSpec(**held)

    def describe_difference(self, other: "RunSpec") -> Said:
        """Say what differs from the run `other` that is to be continued; nothing if it can be.

        Settings are named as parameters, so that a reader can type what the other run was given.
        """
        if self.frames != other.frames:
            count = format_count(len(other.frames), "other frame")
            return f"it was of {count}, {other.frames[0]} to {other.frames[-1]}"
        differing: list[Said] = [
            _describe_setting(name, other.settings.get(name))
            for name in self.settings | other.settings
            if self.settings.get(name) != other.settings.get(name)
        ]
        differing += [
            f"with another {name.replace('_', ' ')}"
            for name in self.sources | other.sources
            if self.sources.get(name) != other.sources.get(name)
        ]
        if differing:
            return "it was run " + join_texts(", ", differing)
        if self.version != other.version:
            return f"it was of cageik {other.version}"
        if replace(self, fit=other.fit) != other:
            return "its weights were others, or frames on which tolerances are measured"
        return ""


def _describe_setting(name: str, value: Any) -> Text:
    """Say what a run was given for a setting."""
    if value is None or value is False:
        return "without " + Hint(name)
    if isinstance(value, dict | list):
        return "with another " + Hint(name)
    return "with " + Hint(name, value)


class Checkpoint:
    """The checkpoint of one run; no other run can open it meanwhile.

    The blocks of an interrupted run count from `recover` on.

    Attributes
    ----------
    spec : RunSpec
        That of the interrupted run, if it is continued.
    has_other_fit : bool
        Whether it held blocks of weights that were fitted to other frames, which are cut off.
    summary : ClipSummary
        Of the blocks that were recovered and appended so far.
    """

    def __init__(
        self, path: Path, file: io.FileIO, spec: RunSpec, has_other_fit: bool = False
    ) -> None:
        self.path, self.spec, self.summary = path, spec, ClipSummary()
        self.has_other_fit = has_other_fit
        self._file = file
        self._start = self._end = file.tell()  # of the first block, and behind the last

    @property
    def frames_done(self) -> int:
        """Return the number of frames that were recovered and appended so far."""
        return self.summary.frames_done

    @staticmethod
    def open(path: Path, spec: RunSpec, resume: bool, overwrite: bool = False) -> "Checkpoint":
        """Start a checkpoint, or open that of an interrupted run of the same spec.

        One of another spec is replaced only with `overwrite`, and what is no checkpoint never. One
        whose run was killed before its spec was written is started again.

        Raises
        ------
        InputError
            When it cannot be written, another run is writing it, or it is of another spec.
        """
        file = _open_own(path)
        if file is None:
            raise CheckpointError(f"{path}: another run is writing it; wait for it, or stop it")
        try:
            if not (resume or overwrite or os.fstat(file.fileno()).st_size == 0):
                raise CheckpointError(
                    f"{path}: another run has written it meanwhile; "
                    + say("continue with `resume=True` or start over with `overwrite=True`")
                )
            held = _read_spec(path, file) if resume else None
            difference = spec.describe_difference(held) if held is not None else ""
            if difference and not overwrite:
                raise CheckpointError(
                    f"{path}: is of another run: "
                    + difference
                    + "; "
                    + say("give the same files and options, or start over with `overwrite=True`")
                )
            has_other_fit = held is not None and not difference and held.fit != spec.fit
            if held is None or difference or has_other_fit:
                _write_spec(path, file, spec)
                held = spec
        except BaseException:
            file.close()
            raise
        return Checkpoint(path, file, held, has_other_fit)

    def recover(self, is_current: Callable[[SolvedBlock], bool]) -> None:
        """Take over the blocks of an interrupted run up to the first damaged or outdated one.

        That one and all behind it are cut off. Nothing is if `is_current` raises an error.
        """
        self._file.seek(self._end)
        for block in _read_blocks(self._file, self.spec, self.frames_done):
            if not is_current(block):
                break
            self.summary.update(block)
            self._end = self._file.tell()
        set_size(self._file, self._end)

    def append(self, block: SolvedBlock) -> None:
        """Add the next block, which has as many frames as the spec says, or is the last.

        Raises
        ------
        InputError
            When it cannot be written; the checkpoint then ends with the block before.
        """
        data = to_bytes(block)
        try:
            set_size(self._file, self._end)
            self._file.seek(self._end)
            _write_all(self._file, _RECORD_HEADER.pack(len(data), zlib.crc32(data)) + data)
        except OSError as error:
            set_size(self._file, self._end)
            raise make_write_error(self.path, error) from error
        self._end = self._file.tell()
        self.summary.update(block)

    def blocks(self) -> Iterator[SolvedBlock]:
        """Yield all blocks, in order."""
        self._file.seek(self._start)
        yield from _read_blocks(self._file, self.spec)

    def count_frames(self) -> int:
        """Return how many frames the file holds, those included that were not recovered."""
        self._file.seek(self._end)
        rest = _read_blocks(self._file, self.spec, self.frames_done)
        return max((block.stop for block in rest), default=self.frames_done)

    def close(self) -> None:
        """Close the file, so that other runs can open it."""
        self._file.close()

    def discard(self) -> None:
        """Delete the file; other runs can use its name from then on."""
        remove_locked(self.path, self._file)


def delete_checkpoint(path: Path) -> None:
    """Delete the checkpoint of a run that has ended, if there is one and no run is writing it."""
    file = _open_own(path) if os.path.lexists(path) else None
    if file is not None:
        try:
            _read_spec(path, file)
        except BaseException:
            file.close()
            raise
        remove_locked(path, file)


def check_checkpoint_path(path: Path) -> None:
    """Refuse, before any work, what is not a checkpoint under the name of one.

    Raises
    ------
    InputError
        When there is a link, a file of another kind, or one that cannot be opened.
    """
    if os.path.lexists(path):
        file = _open_own(path)
        if file is not None:
            file.close()


def is_checkpoint(path: Path) -> bool:
    """Return whether a file starts as a checkpoint does, of this or of another version."""
    if not path.is_file():
        return False
    with open_input(path) as file:
        return file.read(len(CHECKPOINT_START)) == CHECKPOINT_START


def checkpoint_progress(path: Path) -> tuple[int, int]:
    """Return how many frames a checkpoint holds, and of how many; zeros if it holds no spec."""
    with error_context(path):
        file = open_input(path)
    with file:
        spec = _read_spec(path, file)
        if spec is None:
            return 0, 0
        return max((block.stop for block in _read_blocks(file, spec)), default=0), len(spec.frames)


def _open_own(path: Path) -> io.FileIO | None:
    """Open and lock a file that is empty or begins as a checkpoint does; None if it is locked.

    Links are not followed: who can write to the folder would choose the file that is replaced.
    """
    try:
        file = open_locked(path)
    except OSError as error:
        raise make_write_error(path, error) from error
    if file is not None:
        begin = file.read(len(CHECKPOINT_START))
        file.seek(0)
        if not CHECKPOINT_START.startswith(begin):
            file.close()
            raise _make_foreign_error(path)
    return file


def _make_foreign_error(path: Path) -> FormatError:
    return FormatError(f"{path}: is not a checkpoint; move it away")


def _write_spec(path: Path, file: io.FileIO, spec: RunSpec) -> None:
    """Empty the file and write the spec; delete the file when that fails."""
    text = json.dumps(asdict(spec), sort_keys=True, allow_nan=False).encode()
    head = CHECKPOINT_MAGIC + f"{hashlib.sha256(text).hexdigest()} {len(text)}\n".encode() + text
    try:
        set_size(file, 0)
        file.seek(0)
        _write_all(file, head)
    except OSError as error:
        remove_locked(path, file)
        raise make_write_error(path, error) from error


def _read_spec(path: Path, file: io.FileIO) -> RunSpec | None:
    """Read the spec, which leaves the file at its first block; None if the spec is cut short."""
    begin = file.read(len(CHECKPOINT_MAGIC))
    if not CHECKPOINT_MAGIC.startswith(begin):
        if begin.startswith(CHECKPOINT_START):
            raise _make_version_error(path)
        raise _make_foreign_error(path)
    line = file.read(128).partition(b"\n")[0]  # with the digest and the length it is shorter
    digest, _, size = line.partition(b" ")
    length = int(size) if size.isdigit() else 0
    file.seek(len(begin) + len(digest) + len(size) + 2)
    text = file.read(length) if length <= os.fstat(file.fileno()).st_size else b""
    if hashlib.sha256(text).hexdigest().encode() != digest:
        return None
    try:
        return RunSpec.parse(text)
    except UnknownFieldsError as error:
        raise _make_version_error(path) from error
    except ValueError as error:
        raise _make_foreign_error(path) from error


def _make_version_error(path: Path) -> CheckpointError:
    return CheckpointError(
        f"{path}: is of another version of cageik; " + say("start over with `overwrite=True`")
    )


def _read_blocks(file: io.FileIO, spec: RunSpec, done: int = 0) -> Iterator[SolvedBlock]:
    """Yield the blocks from here, and from frame `done`, on; stop at a damaged or misplaced one.

    Others may read the file between two blocks.
    """
    place = file.tell()
    while True:
        file.seek(place)
        head = file.read(_RECORD_HEADER.size + _BLOCK_HEADER.size)
        if len(head) < _RECORD_HEADER.size + _BLOCK_HEADER.size:
            return
        length, checksum = _RECORD_HEADER.unpack(head[: _RECORD_HEADER.size])
        begin = head[_RECORD_HEADER.size :]
        left = os.fstat(file.fileno()).st_size - file.tell() + len(begin)
        if length > left or not _is_next_block(begin, spec, done, length):
            return
        data = begin + file.read(length - len(begin))
        if len(data) < length or zlib.crc32(data) != checksum:
            return
        try:
            block = from_bytes(data, spec)
        except ValueError:
            return
        done, place = block.stop, file.tell()
        yield block


def _write_all(file: io.FileIO, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[file.write(view) or 0 :]


_BLOCK_HEADER = struct.Struct("<QQQQQ")
"""First frame, frames, sampled vertices, bytes of the faults, and of what was kept."""

_DIGEST_SIZE = hashlib.sha256().digest_size


def to_bytes(block: SolvedBlock) -> bytes:
    """Return the bytes of a block."""
    faults = json.dumps(pack_reasons(block.skipped)).encode()
    kept = b"" if block.kept is None else _pack_kept(block.kept)
    counts = (block.start, len(block.cages), len(block.sampled), len(faults), len(kept))
    return b"".join(
        [
            _BLOCK_HEADER.pack(*counts),
            *block.digests,
            np.ascontiguousarray(block.cages, "<f8").tobytes(),
            np.ascontiguousarray(block.rotations, "<f8").tobytes(),
            _pack_columns(block.metrics, METRIC_TYPES),
            np.ascontiguousarray(block.squared_errors, "<f8").tobytes(),
            np.ascontiguousarray(block.peaks.deviations, "<f8").tobytes(),
            np.ascontiguousarray(block.peaks.frames, "<i8").tobytes(),
            np.ascontiguousarray(block.sampled, "<f4").tobytes(),
            faults,
            kept,
        ]
    )


def _is_next_block(head: bytes, spec: RunSpec, done: int, length: int) -> bool:
    """Return whether a header of a block is that of the frames from `done` on, in so many bytes."""
    start, count, rows, faults, kept = _BLOCK_HEADER.unpack(head)
    expected = min(spec.block_frames, len(spec.frames) - done)
    if (start, count, rows) != (done, expected, spec.sampled_vertices) or count < 1:
        return False
    if (kept > 0) != spec.weighs_frames:
        return False
    numbers = 3 * spec.cage_vertices + 9 + len(METRIC_TYPES)
    arrays = 8 * (count * numbers + 3 * spec.vertices) + 12 * rows * count
    least_kept = 8 * (count * len(KEPT_TYPES) + spec.vertices + count + 1)
    whole = len(head) + _DIGEST_SIZE * count + arrays + faults + kept
    return bool(whole == length and (not kept or kept >= least_kept))


def from_bytes(data: bytes, spec: RunSpec) -> SolvedBlock:
    """Return the block of bytes whose header is one of this spec.

    Raises
    ------
    ValueError
        When they hold what no run has solved.
    """
    stream, vertices, cage_vertices = io.BytesIO(data), spec.vertices, spec.cage_vertices
    start, count, rows, length, kept_length = _BLOCK_HEADER.unpack(stream.read(_BLOCK_HEADER.size))
    digests = tuple(stream.read(_DIGEST_SIZE) for _ in range(count))
    cages = np.frombuffer(stream.read(24 * count * cage_vertices), "<f8")
    rotations = np.frombuffer(stream.read(72 * count), "<f8")
    columns = _unpack_columns(stream, count, METRIC_TYPES)
    squares, deviations, peak_frames = (
        np.frombuffer(stream.read(8 * vertices), kind) for kind in ("<f8", "<f8", "<i8")
    )
    sampled = np.frombuffer(stream.read(12 * rows * count), "<f4")
    reasons = _parse_object(stream.read(length))
    block = SolvedBlock(
        start=start,
        cages=cages.reshape(count, cage_vertices, 3),
        rotations=rotations.reshape(count, 3, 3),
        metrics=FrameMetrics(**columns),
        squared_errors=squares,
        peaks=DeviationPeaks(deviations, peak_frames),
        digests=digests,
        skipped=unpack_reasons(reasons),
        sampled=sampled.reshape(rows, 3 * count),
        kept=_unpack_kept(stream.read(kept_length), count, vertices) if kept_length else None,
    )
    _check_block(block, vertices)
    return block


def _check_block(block: SolvedBlock, vertices: int) -> None:
    """Refuse what no run has solved, of a model of so many vertices."""
    frames = range(block.start, block.stop)
    known = np.array([frame not in block.skipped for frame in frames])
    poses = np.concatenate([block.cages.reshape(len(known), -1), block.rotations.reshape(-1, 9)], 1)
    is_gap = np.isnan(poses).all(axis=1) & ~known  # those that were filled have a pose
    figures = map_columns(block.metrics, lambda column: column[known])
    worst, squares, peaks = figures.worst_vertex, block.squared_errors, block.peaks
    is_peak = (peaks.frames >= block.start) & (peaks.frames < block.stop)
    is_sound = [
        all(frame in frames for frame in block.skipped),
        (are_lengths(np.abs(block.cages)).all(axis=(1, 2)) | is_gap).all(),
        (are_rotations(block.rotations) | is_gap).all(),
        find_invalid_metric(figures) is None,
        np.isnan(block.metrics.rms[~known]).all(),
        ((worst >= 0) & (worst < vertices)).all(),
        (np.isnan(squares) | ((squares >= 0) & (squares < np.inf))).all(),
        (are_lengths(peaks.deviations) & (is_peak | (peaks.frames == -1))).all(),
        np.isfinite(block.sampled).all(),
        block.kept is None or _is_sound(block.kept, known, vertices),
    ]
    if not all(is_sound):
        raise ValueError("no solved block")


def _is_sound(kept: KeptBlock, known: Mask, vertices: int) -> bool:
    """Return whether a run can have kept this of frames, (k,), that are known or skipped."""
    return bool(
        find_impossible_kept(kept.metrics, vertices, np.flatnonzero(~known)) is None
        and ((kept.vertices >= 0) & (kept.vertices < vertices)).all()
        and ((kept.counts >= 0) & (kept.counts <= len(known))).all()
        and are_lengths(kept.weights).all()
    )


def _pack_kept(kept: KeptBlock) -> bytes:
    return b"".join(
        [
            _pack_columns(kept.metrics, KEPT_TYPES),
            np.ascontiguousarray(kept.counts, "<i8").tobytes(),
            np.ascontiguousarray(kept.starts, "<i8").tobytes(),
            np.ascontiguousarray(kept.vertices, "<i8").tobytes(),
            np.ascontiguousarray(kept.weights, "<f8").tobytes(),
        ]
    )


def _unpack_kept(data: bytes, count: int, vertices: int) -> KeptBlock:
    stream = io.BytesIO(data)
    columns = _unpack_columns(stream, count, KEPT_TYPES)
    counts = np.frombuffer(stream.read(8 * vertices), "<i8")
    starts = np.frombuffer(stream.read(8 * (count + 1)), "<i8")
    entries = (len(data) - stream.tell()) // 16
    places = np.frombuffer(stream.read(8 * entries), "<i8")
    values = np.frombuffer(stream.read(), "<f8")
    is_whole = (starts[0], starts[-1], len(values)) == (0, entries, entries)
    if not is_whole or (starts[1:] < starts[:-1]).any():
        raise ValueError(f"{entries} entries, expected those that their starts tell")
    return KeptBlock(KeptMetrics(**columns), starts, places, values, counts)


def _pack_columns(metrics: FrameMetrics | KeptMetrics, types: Mapping[str, str]) -> bytes:
    """Return the columns of metrics, one after another."""
    columns = (getattr(metrics, name).astype(f"<{kind}") for name, kind in types.items())
    return b"".join(column.tobytes() for column in columns)


def _unpack_columns(stream: io.BytesIO, count: int, types: Mapping[str, str]) -> dict[str, Any]:
    return {name: np.frombuffer(stream.read(8 * count), f"<{kind}") for name, kind in types.items()}


def _parse_object(text: bytes) -> dict[str, Any]:
    """Return an object of JSON; raises ValueError for anything else."""
    try:
        held = parse_json(text)
    except FormatError as error:
        raise ValueError(str(error)) from error
    if not isinstance(held, dict):
        raise ValueError("not an object")
    return held
