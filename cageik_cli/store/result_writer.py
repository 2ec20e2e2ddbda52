"""Write result files: beside their name, renamed when complete."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from cageik_cli import __version__
from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.settings import Scene
from cageik_cli.solver.dual_laplacian import SolveQuality
from cageik_cli.solver.metrics import (
    INTEGER_METRICS,
    KEPT_COUNTS,
    KEPT_NAMES,
    METRIC_NAMES,
    FrameMetrics,
    KeptMetrics,
)
from cageik_cli.solver.regions import Region
from cageik_cli.solver.summary import VertexBound
from cageik_cli.store.fit_fields import (
    MAX_STORED_ERROR,
    UnfittedClip,
    write_unfitted,
    write_weights,
)
from cageik_cli.store.hdf5_fields import create_hdf5, to_json, write_meshes
from cageik_cli.store.regions import write_regions
from cageik_cli.store.result import FORMAT, SCHEMA
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.outputs import DeferredErrorFile, atomic_file


@dataclass(frozen=True, slots=True, eq=False)
class ResultHeader:
    """The part of a result that is known before its first frame is solved.

    Attributes
    ----------
    edited_from : str, optional
        The name of the result that was edited.
    has_kept : bool
        Whether metrics over what was kept are written too.
    """

    binding: Binding
    quality: SolveQuality
    frames: tuple[str, ...]
    scene: Scene
    settings: dict[str, Any]
    notes: tuple[str, ...]
    keep_weights: bool
    edited_from: str | None = None
    has_kept: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class RunSummary:
    """The part of a result that is known after its last frame is solved.

    Attributes
    ----------
    skipped : dict
        By number in the clip, why a frame was skipped.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) of each vertex over the frames that were not skipped; nan for missing
        data.
    key_frames : (3,) or (4,) int64
        Numbers of the worst, the median and the best frame, by rms; then that of the worst region,
        if it is another.
    key_frame_errors : (3 or 4, m, 3) float64
        Their v − v̂, which a report draws without reading frames.
    regions : tuple of Region, optional
        The worst regions; None for a result that was edited, which has no errors.
    bound : VertexBound, optional
        The error of the best possible cage animation.
    unfitted : UnfittedClip, optional
        The same clip with the weights before the fit, if they are fitted and both are known.
    filled : tuple of int
        Skipped frames whose cages were filled from those around them.
    """

    sources: dict[str, Any]
    skipped: dict[int, str]
    vertex_rms: Floats
    key_frames: Integers
    key_frame_errors: Floats
    regions: tuple[Region, ...] | None = None
    bound: VertexBound | None = None
    unfitted: UnfittedClip | None = None
    filled: tuple[int, ...] = ()


class ResultWriter:
    """Append blocks of cages and metrics to an open file, in order."""

    def __init__(self, file: h5py.File, sink: DeferredErrorFile, header: ResultHeader) -> None:
        self._file, self._sink = file, sink
        self._frames_done = 0
        self._frame_count = len(header.frames)
        self._header = header
        binding = header.binding
        cage, rest = binding.cage, binding.rest
        self._diagonal = rest.diagonal
        file.create_dataset("verts", (self._frame_count, *cage.vertices.shape), "f8")
        file.create_dataset("rotations", (self._frame_count, 3, 3), "f8")
        write_meshes(file, rest, cage)
        file.create_dataset("frames/name", data=header.frames, dtype=h5py.string_dtype())
        for name in METRIC_NAMES:
            kind = "i8" if name in INTEGER_METRICS else "f8"
            file.create_dataset(f"metrics/{name}", (self._frame_count,), kind)
        for name in KEPT_NAMES if header.has_kept else ():
            kind = "i8" if name in KEPT_COUNTS else "f8"
            file.create_dataset(f"metrics/{name}", (self._frame_count,), kind)
        file.attrs.update(format=FORMAT, schema=SCHEMA, version=__version__)
        file.attrs.update(asdict(header.scene))
        file.attrs["settings"] = to_json(header.settings)
        file.attrs["notes"] = to_json(header.notes)
        file.attrs["quality"] = to_json(asdict(header.quality))
        if header.edited_from is not None:
            file.attrs["edited_from"] = header.edited_from
        file.attrs["complete"] = False

    def append(
        self,
        cages: Floats,
        rotations: Floats,
        metrics: FrameMetrics,
        kept: KeptMetrics | None = None,
    ) -> None:
        """Write the next k frames: cages (k, n, 3), rotations (k, 3, 3) and metrics, all finite."""
        done = slice(self._frames_done, self._frames_done + len(cages))
        self._file["verts"][done] = cages
        self._file["rotations"][done] = rotations
        for name in METRIC_NAMES:
            self._file[f"metrics/{name}"][done] = getattr(metrics, name)
        for name in KEPT_NAMES if kept is not None else ():
            self._file[f"metrics/{name}"][done] = getattr(kept, name)
        self._sink.raise_deferred_error()
        self._frames_done = done.stop

    def complete(self, summary: RunSummary) -> None:
        """Write the weights, the key frames and the summary, and mark the file as complete."""
        if self._frames_done != self._frame_count:
            raise ValueError(f"{self._frames_done} of {self._frame_count} frames were appended")
        header = self._header
        write_weights(self._file, header.binding, header.keep_weights)
        if header.keep_weights:
            self._file.create_dataset("poses/frame", data=summary.key_frames, dtype="i8")
            # In diagonals, so that they fit single precision in any units.
            misses = np.clip(
                summary.key_frame_errors / self._diagonal, -MAX_STORED_ERROR, MAX_STORED_ERROR
            )
            self._file.create_dataset("poses/misses", data=misses, dtype="f4")
            if summary.unfitted is not None:
                write_unfitted(self._file, summary.unfitted)
        self._file.create_dataset("metrics/vertex_rms", data=summary.vertex_rms, dtype="f8")
        if summary.regions is not None:
            write_regions(self._file, summary.regions)
        skipped = {str(k): text for k, text in summary.skipped.items()}
        if summary.bound is not None:
            self._file.attrs["bound"] = to_json(asdict(summary.bound))
        if summary.filled:
            self._file.attrs["filled"] = to_json(summary.filled)
        self._file.attrs["sources"] = to_json(summary.sources)
        self._file.attrs["skipped"] = to_json(skipped)
        self._file.attrs["complete"] = True


@contextmanager
def open_result_writer(
    path: Path, header: ResultHeader, overwrite: bool, temporary_path: Path | None = None
) -> Iterator[ResultWriter]:
    """Write a result beside its name, and rename it when the block ends without an error.

    `temporary_path` names the file until then, if no other run can use that name.
    """
    with atomic_file(path, overwrite, temporary_path) as sink, create_hdf5(sink) as file:
        yield ResultWriter(file, sink, header)
