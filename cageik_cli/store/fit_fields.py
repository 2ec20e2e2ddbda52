"""Weights in the HDF5 files of cageik, in any form, and the fit that they come from.

The form says how few numbers must be stored: a matrix; a matrix that is the computed one and a
change of low rank; or a sparse matrix. A result of fitted weights also keeps what a report
compares: receivers do not have the weights before the fit, and computing them takes longer than a
report.
"""

from collections.abc import Collection
from dataclasses import asdict, dataclass

import h5py
import numpy as np

from cageik_cli.fit.settings import FitRecord
from cageik_cli.formats.base.hdf5 import get_dataset, read_array, read_attribute
from cageik_cli.method.solve.metrics import are_lengths
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.store.hdf5_fields import (
    parse_record,
    read_floats,
    read_json_attr,
    to_json,
    write_deflated,
)
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError, error_context
from cageik_cli.util.text import group_digits

MAX_STORED_ERROR = float(np.finfo(np.float32).max)
"""Longer errors of vertices, in diagonals, are stored as this."""


def write_weights(
    file: h5py.File,
    binding: Binding,
    fit: FitRecord | None,
    low_rank: Correction | None,
    keep_weights: bool = True,
) -> None:
    """Write the weights in their form, and the record of their fit if there is one.

    Without `keep_weights`, only a change of low rank is written: what can be computed is not.
    """
    file.attrs["has_offsets"] = binding.has_offsets
    if fit is not None:
        file.attrs["fit"] = to_json(asdict(fit))
    if low_rank is not None:
        write_deflated(file, "fit/columns", low_rank.columns)
        write_deflated(file, "fit/basis", low_rank.basis)
    if not keep_weights:
        return
    if fit is None or fit.settings.influences is None:
        write_deflated(file, "weights", binding.weights)
        return
    rows, places = np.nonzero(binding.weights)
    bounds = np.searchsorted(rows, np.arange(len(binding.weights) + 1))
    file.create_dataset("weights_csr/data", data=binding.weights[rows, places], dtype="f8")
    file.create_dataset("weights_csr/indices", data=places, dtype="i4")
    file.create_dataset("weights_csr/indptr", data=bounds, dtype="i8")


def holds_weights(file: h5py.File) -> bool:
    """Return whether a file holds weights, in any form that needs nothing else."""
    return "weights" in file or "weights_csr" in file


def read_weights(file: h5py.File, m: int, n: int) -> Floats:
    """Read the weights, (m, n) float64, whatever their form."""
    if "weights_csr" in file:
        return _read_sparse_weights(file, m, n)
    weights = read_floats(file, "weights", (m, n))
    _check_sizes("weights", weights)
    return weights


def _read_sparse_weights(file: h5py.File, m: int, n: int) -> Floats:
    """Read weights with few influences; what they name is checked before it is used."""
    data = read_floats(file, "weights_csr/data", (None,))
    indices = read_array(file, "weights_csr/indices", "iu", data.shape)
    bounds = read_array(file, "weights_csr/indptr", "iu", (m + 1,))
    if not ((indices >= 0) & (indices < n)).all():
        raise FormatError(
            f"`weights_csr/indices` name vertices that the cage does not have ({group_digits(n)} "
            "vertices); "
            "write it again"
        )
    ascends = (bounds[1:] >= bounds[:-1]).all()
    if bounds[0] != 0 or bounds[-1] != len(data) or not ascends:
        raise FormatError(
            f"`weights_csr/indptr` does not divide {len(data)} entries into {m} rows; write it "
            "again"
        )
    starts: Integers = bounds.astype(np.int64)
    rows = np.repeat(np.arange(m), starts[1:] - starts[:-1])
    places = rows * n + indices.astype(np.int64)
    if not (np.diff(places) > 0).all():
        raise FormatError("`weights_csr/indices` do not ascend in each row; write it again")
    is_length = are_lengths(np.abs(data))
    if not is_length.all():
        raise FormatError(
            f"`weights_csr/data` are not finite, or too large, at vertex "
            f"{rows[np.argmin(is_length)]}; write it again"
        )
    weights = np.zeros((m, n))
    weights.ravel()[places] = data
    return weights


def read_offset_mark(file: h5py.File) -> bool:
    """Read whether the weights do not reproduce the rest pose; files without the mark do."""
    mark = read_attribute(file, "has_offsets", np.False_)
    if not isinstance(mark, np.bool_):
        raise FormatError(f"attribute `has_offsets` is {mark!r}, expected a truth value")
    if "weights_csr" in file and not mark:
        raise FormatError(
            "attribute `has_offsets` is false, but the weights are sparse (`weights_csr`); write "
            "it again"
        )
    return bool(mark)


def read_fit_record(file: h5py.File) -> FitRecord | None:
    """Read the record of a fit; None if the weights are not fitted."""
    if "fit" not in file.attrs:
        return None
    held = read_json_attr(file, "fit", dict)
    report = held.get("report")
    if isinstance(report, dict):
        report.pop("curve", None)  # what the version before 0.2 had tried
    with error_context("attribute `fit`"):
        record: FitRecord = parse_record(FitRecord, held, "fit")
    if not record.clips:
        raise FormatError("attribute `fit` names no clip that the weights were fitted to")
    return record


def read_low_rank(file: h5py.File, record: FitRecord | None, m: int, n: int) -> Correction | None:
    """Read the change of low rank of fitted weights; None if they have another form."""
    if record is None:
        return None
    settings = record.settings
    _check_form("rank", settings.rank, "fit", is_stored="fit" in file)
    if holds_weights(file):
        is_sparse = "weights_csr" in file
        _check_form("influences", settings.influences, "weights_csr", is_stored=is_sparse)
    if settings.rank is None:
        return None
    columns = read_floats(file, "fit/columns", (m, None))
    basis = read_floats(file, "fit/basis", (n, columns.shape[1]))
    _check_sizes("fit/columns", columns)
    _check_sizes("fit/basis", basis)
    return Correction(columns, basis)


def _check_form(setting: str, value: int | None, group: str, is_stored: bool) -> None:
    """Refuse weights that are not in the form that the settings of the fit ask for."""
    if is_stored and value is None:
        raise FormatError(
            f"attribute `fit` has no {setting}, but there is `{group}`; write it again"
        )
    if not is_stored and value is not None:
        raise FormatError(
            f"attribute `fit` has {setting} {value}, but there is no `{group}`; write it again"
        )


def _check_sizes(name: str, matrix: Floats) -> None:
    """Refuse numbers that are not finite, or larger than lengths are."""
    largest = np.maximum(matrix.max(axis=1, initial=0), -matrix.min(axis=1, initial=0))
    wrong = np.flatnonzero(~are_lengths(largest))
    if len(wrong):
        raise FormatError(
            f"`{name}` are not finite, or too large, at vertex {wrong[0]}; write it again"
        )


@dataclass(frozen=True, slots=True, eq=False)
class BaselineErrors:
    """What is compared of a clip with the weights before the fit.

    Attributes
    ----------
    frames : (k,) int64
        Numbers of some frames in the clip; ascending.
    rms : (k,) float64
        Their errors, in file units.
    misses : (3 or 4, m, 3) float64
        v − v̂ of the frames that are kept in full, in diagonals of the rest model.
    cage_vertex : int
        The cage vertex whose weights the fit changed most.
    influence : (m,) float64
        Its weights before the fit.
    """

    frames: Integers
    rms: Floats
    misses: Floats
    cage_vertex: int
    influence: Floats


def write_baseline_errors(file: h5py.File, clip: BaselineErrors) -> None:
    """Write what is kept of the weights before the fit."""
    file.create_dataset("unfitted/frame", data=clip.frames, dtype="i8")
    file.create_dataset("unfitted/rms", data=clip.rms, dtype="f8")
    misses = np.clip(clip.misses, -MAX_STORED_ERROR, MAX_STORED_ERROR)
    file.create_dataset("unfitted/misses", data=misses, dtype="f4")
    file.create_dataset("unfitted/cage_vertex", data=[clip.cage_vertex], dtype="i8")
    file.create_dataset("unfitted/influence", data=clip.influence, dtype="f8")


def read_baseline_errors(
    file: h5py.File, shape: tuple[int, int], frames: int, skipped: Collection[int]
) -> BaselineErrors | None:
    """Read what a result keeps of the weights before the fit; None if it keeps nothing."""
    (m, n), again = shape, "extract it again"
    if "unfitted" not in file:
        return None
    numbers = read_array(file, "unfitted/frame", "iu", (None,)).astype(np.int64)
    rms = read_floats(file, "unfitted/rms", numbers.shape)
    count = len(get_dataset(file, "poses/frame", "iu", (None,)))
    misses = read_floats(file, "unfitted/misses", (count, m, 3))
    vertex = int(read_array(file, "unfitted/cage_vertex", "iu", (1,))[0])
    influence = read_floats(file, "unfitted/influence", (m,))
    inside = ((numbers >= 0) & (numbers < frames)).all()
    ascends = (np.diff(numbers) > 0).all()
    if not inside or not ascends or np.isin(numbers, list(skipped)).any():
        raise FormatError(
            "`unfitted/frame` are not ascending numbers of frames that were solved "
            f"({frames} frames); {again}"
        )
    if not are_lengths(rms).all():
        raise FormatError(f"`unfitted/rms` is not a length everywhere; {again}")
    for name, values in (("misses", misses), ("influence", influence)):
        if not are_lengths(np.abs(values)).all():
            raise FormatError(f"`unfitted/{name}` are not finite, or too large; {again}")
    if not 0 <= vertex < n:
        raise FormatError(
            f"`unfitted/cage_vertex` is {vertex}, expected a vertex of the cage ({n} "
            f"vertices); {again}"
        )
    return BaselineErrors(numbers, rms, misses, vertex, influence)
