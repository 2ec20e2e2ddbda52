"""What a run has done so far: a log of solved blocks beside the result, only ever appended to.

The first line says what it is, the second the digest and the length of a JSON plan; then the plan
and the blocks, each behind its length and its checksum. Whatever moment a run is killed at, what
the log holds up to the first block that is not whole is sound, and the run can go on from there.
The result is composed of the log in one pass, so that it does not tell how often it was
interrupted.
"""

import hashlib
import io
import json
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli import __version__
from cageik_cli.solver.blocks import SolvedBlock
from cageik_cli.solver.metrics import INTEGER_METRICS, METRIC_NAMES, FrameMetrics
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import open_locked, remove_locked

DIGEST_BYTES = hashlib.sha256().digest_size
_BLOCK_HEADER = struct.Struct("<QQQ")  # first frame, frames, bytes of the faults
MAGIC = b"cageik.partial 1\n"

MAX_HEAD_BYTES = 128
"""More than the line with the digest and the length of a plan takes."""

_RECORD_HEADER = struct.Struct("<QI")  # length and checksum of what follows


@dataclass(frozen=True, slots=True)
class RunSpec:
    """What a run is to do, and what its numbers depend on.

    Attributes
    ----------
    frames : list of str
        Where each frame comes from.
    settings, sources : dict
        What is asked; name and digest of what was read beside the frames.
    key : str
        Digest of weights, meshes and vertex weights.
    vertices, cage_vertices : int
    block : int
        Frames solved together; it changes the last digits, so a run that goes on keeps it.
    version : str
        Of the program.
    """

    frames: list[str]
    settings: dict[str, Any]
    sources: dict[str, Any]
    key: str
    vertices: int
    cage_vertices: int
    block: int
    version: str = __version__

    def describe_difference(self, other: "RunSpec") -> str:
        """What differs from the plan of a run that can go on where `other` ended; may be empty."""
        if self.frames != other.frames:
            return f"it was of {len(other.frames)} other frames"
        for name in self.settings | other.settings:
            mine, theirs = self.settings.get(name), other.settings.get(name)
            if mine != theirs:
                return f"its {name} was {theirs}, not {mine}"
        for name in self.sources | other.sources:
            if self.sources.get(name) != other.sources.get(name):
                return f"its {name.replace('_', ' ')} was another"
        if self.version != other.version:
            return f"it was of cageik {other.version}"
        if replace(self, block=other.block) != other:
            return "its weights were others"
        return ""


class Checkpoint:
    """The log of one run, which no other run has while it is open.

    Attributes
    ----------
    path : Path
    spec : RunSpec
    frames_done : int
        How many frames it holds.
    """

    def __init__(
        self, path: Path, file: io.FileIO, spec: RunSpec, block_offsets: list[int]
    ) -> None:
        self.path, self.spec = path, spec
        self._file = file
        self._block_offsets = block_offsets  # where each block begins, and where the next will
        self.frames_done = min((len(block_offsets) - 1) * spec.block, len(spec.frames))

    @staticmethod
    def open(path: Path, spec: RunSpec, resume: bool, overwrite: bool = False) -> "Checkpoint":
        """Begin a log, or go on with the one of an interrupted run of the same plan.

        One that is there and cannot be gone on with is begun anew only to `overwrite` it.

        What is not whole at the end of one is cut off. One whose run was killed before it had
        written its plan is begun again.

        Raises
        ------
        InputError
            When it cannot be written, another run has it, or it is of another plan.
        """
        try:
            file = open_locked(path)
        except OSError as error:
            raise _make_write_error(path, error) from error
        if file is None:
            raise InputError(f"{path}: another run is writing it; wait for it, or stop it")
        try:
            if not (resume or overwrite or os.fstat(file.fileno()).st_size == 0):
                raise InputError(
                    f"{path}: another run has left it meanwhile; go on with --resume, or begin "
                    "again with --overwrite"
                )
            held = _read_spec(path, file) if resume else None
            if held is None:
                return _start_checkpoint(path, file, spec)
            difference = spec.describe_difference(held)
            if difference and overwrite:
                return _start_checkpoint(path, file, spec)
            if difference:
                raise InputError(
                    f"{path}: is of another run: {difference}; give the same files and options, "
                    "or begin again with --overwrite"
                )
            block_offsets = [file.tell()]
            block_offsets += [file.tell() for _ in _read_blocks(file, held)]
            file.truncate(block_offsets[-1])
        except BaseException:
            file.close()
            raise
        return Checkpoint(path, file, held, block_offsets)

    def append(self, block: SolvedBlock) -> None:
        """Add the next block, of as many frames as the plan says but for the last.

        Raises
        ------
        InputError
            When it cannot be written; the log then ends with the block before.
        """
        data = to_bytes(block)
        try:
            self._file.seek(self._block_offsets[-1])
            _write_all(self._file, _RECORD_HEADER.pack(len(data), zlib.crc32(data)) + data)
        except OSError as error:
            self._file.truncate(self._block_offsets[-1])
            raise _make_write_error(self.path, error) from error
        self._block_offsets.append(self._file.tell())
        self.frames_done = block.stop

    def blocks(self) -> Iterator[SolvedBlock]:
        """All blocks, in order."""
        self._file.seek(self._block_offsets[0])
        yield from _read_blocks(self._file, self.spec)

    def truncate(self, frame: int) -> None:
        """Forget the block that holds `frame`, and those after it."""
        kept = frame // self.spec.block
        del self._block_offsets[kept + 1 :]
        self._file.truncate(self._block_offsets[-1])
        self.frames_done = kept * self.spec.block

    def close(self) -> None:
        """Let other runs have it."""
        self._file.close()

    def discard(self) -> None:
        """Delete the log; other runs may have its name from then on."""
        remove_locked(self.path, self._file)


def delete_checkpoint(path: Path) -> None:
    """Delete the log of a run that has ended, if there is one and no other run has it.

    Raises
    ------
    InputError
        When what is there is no log.
    """
    if not path.exists():
        return
    checkpoint_progress(path)
    file = open_locked(path)
    if file is not None:
        remove_locked(path, file)


def is_checkpoint(path: Path) -> bool:
    """Whether a file begins as a log does."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def checkpoint_progress(path: Path) -> tuple[int, int]:
    """How many frames a log holds, and how many its run was to solve; zeros if it holds no plan.

    Raises
    ------
    InputError
        When it is no log.
    """
    with io.FileIO(path) as file:
        spec = _read_spec(path, file)
        if spec is None:
            return 0, 0
        return max((block.stop for block in _read_blocks(file, spec)), default=0), len(spec.frames)


def _start_checkpoint(path: Path, file: io.FileIO, spec: RunSpec) -> Checkpoint:
    text = json.dumps(asdict(spec), sort_keys=True, allow_nan=False).encode()
    head = MAGIC + f"{hashlib.sha256(text).hexdigest()} {len(text)}\n".encode() + text
    try:
        file.truncate(0)
        file.seek(0)
        _write_all(file, head)
    except OSError as error:
        remove_locked(path, file)
        raise _make_write_error(path, error) from error
    return Checkpoint(path, file, spec, [len(head)])


def _read_spec(path: Path, file: io.FileIO) -> RunSpec | None:
    """The plan of a log, which is then at its first block; None if the plan is not whole."""
    begin = file.read(len(MAGIC))
    if not MAGIC.startswith(begin):
        raise InputError(f"{path}: is not what an interrupted run leaves; move it away")
    digest, _, size = file.read(MAX_HEAD_BYTES).partition(b"\n")[0].partition(b" ")
    length = int(size) if size.isdigit() else 0
    file.seek(len(begin) + len(digest) + len(size) + 2)
    text = file.read(length) if length <= os.fstat(file.fileno()).st_size else b""
    if hashlib.sha256(text).hexdigest().encode() != digest:
        return None
    held = json.loads(text)
    if set(held) != {field.name for field in fields(RunSpec)}:
        raise InputError(f"{path}: is of another version of cageik; begin again with --overwrite")
    return RunSpec(**held)


def _read_blocks(file: io.FileIO, spec: RunSpec) -> Iterator[SolvedBlock]:
    """The blocks from here on, as far as they are whole and follow each other."""
    done = 0
    while True:
        head = file.read(_RECORD_HEADER.size)
        if len(head) < _RECORD_HEADER.size:
            return
        length, checksum = _RECORD_HEADER.unpack(head)
        left = os.fstat(file.fileno()).st_size - file.tell()
        data = file.read(length) if length <= left else b""
        if len(data) < length or zlib.crc32(data) != checksum:
            return
        block = from_bytes(data, spec.vertices, spec.cage_vertices)
        if block.start != done:
            return
        done = block.stop
        yield block


def _write_all(file: io.FileIO, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[file.write(view) or 0 :]


def _make_write_error(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written ({error.strerror or error})")


def to_bytes(block: SolvedBlock) -> bytes:
    """The bytes of a block."""
    faults = json.dumps({str(k): text for k, text in block.skipped.items()}).encode()
    columns = [_cast_column(name, getattr(block.metrics, name)) for name in METRIC_NAMES]
    return b"".join(
        [
            _BLOCK_HEADER.pack(block.start, len(block.cages), len(faults)),
            *block.digests,
            np.ascontiguousarray(block.cages, "<f8").tobytes(),
            *(column.tobytes() for column in columns),
            np.ascontiguousarray(block.squared_errors, "<f8").tobytes(),
            faults,
        ]
    )


def from_bytes(data: bytes, vertices: int, cage_vertices: int) -> SolvedBlock:
    """The block whose bytes `data` are."""
    stream = io.BytesIO(data)
    start, count, length = _BLOCK_HEADER.unpack(stream.read(_BLOCK_HEADER.size))
    digests = tuple(stream.read(DIGEST_BYTES) for _ in range(count))
    cages = np.frombuffer(stream.read(24 * count * cage_vertices), "<f8")
    columns = {
        name: np.frombuffer(stream.read(8 * count), _cast_column(name, np.empty(0)).dtype)
        for name in METRIC_NAMES
    }
    squares = np.frombuffer(stream.read(8 * vertices), "<f8")
    faults = {int(k): text for k, text in json.loads(stream.read(length)).items()}
    cages = cages.reshape(count, cage_vertices, 3)
    return SolvedBlock(start, cages, FrameMetrics(**columns), squares, digests, faults)


def _cast_column(name: str, column: np.ndarray) -> np.ndarray:
    return column.astype("<i8" if name in INTEGER_METRICS else "<f8")
