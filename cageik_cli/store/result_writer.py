"""Write result files: beside their name, renamed when complete."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np

from cageik_cli.method.solve.metrics import KEPT_TYPES, METRIC_TYPES, FrameMetrics, KeptMetrics
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.fit_fields import (
    MAX_STORED_ERROR,
    BaselineErrors,
    write_baseline_errors,
    write_weights,
)
from cageik_cli.store.hdf5_fields import create_hdf5, write_meshes
from cageik_cli.store.result import RESULT_FORMAT, RESULT_SCHEMA
from cageik_cli.store.result_fields import (
    ResultHeader,
    ResultSummary,
    create_columns,
    write_columns,
    write_fields,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.outputs import DeferredErrorFile, atomic_file
from cageik_cli.util.version import __version__


class ResultWriter:
    """Append blocks of cages and metrics to an open file, in order."""

    def __init__(
        self,
        file: h5py.File,
        sink: DeferredErrorFile,
        header: ResultHeader,
        *,
        stored: StoredBinding,
        frames: tuple[str, ...],
        keep_weights: bool,
        has_kept: bool,
    ) -> None:
        self._file, self._sink, self._stored = file, sink, stored
        self._keep_weights = keep_weights
        self._frames_done, self._frame_count = 0, len(frames)
        cage, rest = stored.binding.cage, stored.binding.rest
        file.create_dataset("verts", (len(frames), *cage.vertices.shape), "f8")
        file.create_dataset("rotations", (len(frames), 3, 3), "f8")
        write_meshes(file, rest, cage)
        file.create_dataset("frames/name", data=frames, dtype=h5py.string_dtype())
        create_columns(file, len(frames), METRIC_TYPES | (KEPT_TYPES if has_kept else {}))
        file.attrs.update(format=RESULT_FORMAT, schema=RESULT_SCHEMA, version=__version__)
        write_fields(file, header)
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
        write_columns(self._file, done, metrics, METRIC_TYPES)
        if kept is not None:
            write_columns(self._file, done, kept, KEPT_TYPES)
        self._sink.raise_deferred_error()
        self._frames_done = done.stop

    def complete(
        self,
        summary: ResultSummary,
        *,
        key_frames: Integers,
        key_frame_errors: Floats,
        unfitted: BaselineErrors | None = None,
    ) -> None:
        """Write the weights, the key frames and the summary, and mark the file as complete.

        Parameters
        ----------
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
        write_weights(file, stored.binding, stored.fit, stored.low_rank, self._keep_weights)
        if self._keep_weights:
            file.create_dataset("poses/frame", data=key_frames, dtype="i8")
            # In diagonals, so that they fit single precision in any units.
            misses = key_frame_errors / stored.binding.rest.diagonal
            misses = np.clip(misses, -MAX_STORED_ERROR, MAX_STORED_ERROR)
            file.create_dataset("poses/misses", data=misses, dtype="f4")
            if unfitted is not None:
                write_baseline_errors(file, unfitted)
        write_fields(file, summary)
        file.attrs["complete"] = True


@contextmanager
def open_result_writer(
    path: Path,
    header: ResultHeader,
    *,
    stored: StoredBinding,
    frames: tuple[str, ...],
    overwrite: bool,
    keep_weights: bool = True,
    has_kept: bool = False,
    temporary_path: Path | None = None,
) -> Iterator[ResultWriter]:
    """Write a result beside its name, and rename it when the block ends without an error.

    Parameters
    ----------
    temporary_path : Path, optional
        Names the file until then, if no other run can use that name.
    """
    with atomic_file(path, overwrite, temporary_path) as sink, create_hdf5(sink) as file:
        yield ResultWriter(
            file,
            sink,
            header,
            stored=stored,
            frames=frames,
            keep_weights=keep_weights,
            has_kept=has_kept,
        )
