"""A solved block as the bytes that a checkpoint holds: a header, then one array after another."""

import hashlib
import io
import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from cageik_cli.captured.frames import KeptBlock
from cageik_cli.method.solve.blocks import SolvedBlock
from cageik_cli.method.solve.metrics import KEPT_TYPES, METRIC_TYPES, FrameMetrics, KeptMetrics
from cageik_cli.method.solve.summary import DeviationPeaks

_BLOCK_HEADER = struct.Struct("<QQQQQ")
"""First frame, frames, sampled vertices, bytes of the faults, and of what was kept."""


def to_bytes(block: SolvedBlock) -> bytes:
    """Return the bytes of a block."""
    faults = json.dumps({str(k): text for k, text in block.skipped.items()}).encode()
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


def from_bytes(data: bytes, vertices: int, cage_vertices: int) -> SolvedBlock:
    """Return the block of these bytes."""
    stream = io.BytesIO(data)
    start, count, rows, length, kept_length = _BLOCK_HEADER.unpack(stream.read(_BLOCK_HEADER.size))
    digests = tuple(stream.read(hashlib.sha256().digest_size) for _ in range(count))
    cages = np.frombuffer(stream.read(24 * count * cage_vertices), "<f8")
    rotations = np.frombuffer(stream.read(72 * count), "<f8")
    columns = _unpack_columns(stream, count, METRIC_TYPES)
    squares, deviations, peak_frames = (
        np.frombuffer(stream.read(8 * vertices), kind) for kind in ("<f8", "<f8", "<i8")
    )
    sampled = np.frombuffer(stream.read(12 * rows * count), "<f4")
    faults = {int(k): text for k, text in json.loads(stream.read(length)).items()}
    return SolvedBlock(
        start=start,
        cages=cages.reshape(count, cage_vertices, 3),
        rotations=rotations.reshape(count, 3, 3),
        metrics=FrameMetrics(**columns),
        squared_errors=squares,
        peaks=DeviationPeaks(deviations, peak_frames),
        digests=digests,
        skipped=faults,
        sampled=sampled.reshape(rows, 3 * count),
        kept=_unpack_kept(stream, count, vertices) if kept_length else None,
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


def _unpack_kept(stream: io.BytesIO, count: int, vertices: int) -> KeptBlock:
    columns = _unpack_columns(stream, count, KEPT_TYPES)
    counts = np.frombuffer(stream.read(8 * vertices), "<i8")
    starts = np.frombuffer(stream.read(8 * (count + 1)), "<i8")
    entries = int(starts[-1])
    places = np.frombuffer(stream.read(8 * entries), "<i8")
    values = np.frombuffer(stream.read(8 * entries), "<f8")
    return KeptBlock(KeptMetrics(**columns), starts, places, values, counts)


def _pack_columns(metrics: FrameMetrics | KeptMetrics, types: Mapping[str, str]) -> bytes:
    """Return the columns of metrics, one after another."""
    columns = (getattr(metrics, name).astype(f"<{kind}") for name, kind in types.items())
    return b"".join(column.tobytes() for column in columns)


def _unpack_columns(stream: io.BytesIO, count: int, types: Mapping[str, str]) -> dict[str, Any]:
    return {name: np.frombuffer(stream.read(8 * count), f"<{kind}") for name, kind in types.items()}
