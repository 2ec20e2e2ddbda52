"""The figures of a result file, read with every check."""

from typing import Any

import h5py
import numpy as np

from cageik_cli.formats.base.hdf5 import numbers
from cageik_cli.solver.metrics import FIGURES, WHOLE_FIGURES, FrameFigures, are_lengths, fault_of
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError


def read_figures(file: h5py.File, frames: int, vertices: int, skipped: list[int]) -> FrameFigures:
    """The figures of all frames; those that were skipped have none."""
    columns = {name: _column(file, name, frames) for name in FIGURES}
    figures = FrameFigures(**columns)
    held = FrameFigures(**{name: np.delete(column, skipped) for name, column in columns.items()})
    fault = fault_of(held)
    if fault is not None:
        raise InputError(f"holds {fault}; extract it again")
    if not np.isnan(figures.rms[skipped]).all():
        raise InputError("`metrics/rms` has figures of frames that were skipped; extract it again")
    if not ((held.worst_vertex >= 0) & (held.worst_vertex < vertices)).all():
        raise InputError(f"`metrics/worst_vertex` names more than {vertices} vertices")
    return figures


def read_vertex_rms(file: h5py.File, vertices: int) -> Floats:
    """The rms of every vertex, (m,); nan for missing data."""
    values = numbers(file, "metrics/vertex_rms", "f", (vertices,)).astype(np.float64)
    is_missing = np.isnan(values)
    if is_missing.all() or not (is_missing | are_lengths(values)).all():
        raise InputError("holds `metrics/vertex_rms` that is no length; extract it again")
    return values


def _column(file: h5py.File, name: str, frames: int) -> Any:
    if name in WHOLE_FIGURES:
        return numbers(file, f"metrics/{name}", "iu", (frames,))
    with np.errstate(over="ignore", invalid="ignore"):  # what does not fit is found later
        return numbers(file, f"metrics/{name}", "f", (frames,)).astype(np.float64)
