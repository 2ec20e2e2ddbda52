"""Weights in the HDF5 files of cageik in any form, and the record of their fit.

The form says how few numbers must be stored: a matrix; a matrix that is the harmonic one and a
change of low rank; or a sparse matrix.
"""

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import h5py
import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.problem import Correction
from cageik_cli.formats.base.hdf5 import read_array, read_attribute
from cageik_cli.solver.fitting.record import FitRecord
from cageik_cli.solver.metrics import are_lengths
from cageik_cli.store.hdf5_fields import read_json_attr, to_json, write_deflated
from cageik_cli.store.json_records import parse_record
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError, error_context

if TYPE_CHECKING:
    from scipy import sparse

CSR = "weights_csr"
LOW_RANK = "fit"


@dataclass(frozen=True, slots=True, eq=False)
class StoredFit:
    """A fit as files hold it, beside the weights.

    Attributes
    ----------
    low_rank : Correction or None
        The change of the binding's own weights, if it is of low rank.
    sparse_weights : (m, n) csr_array or None
        The weights, if they have few influences.
    """

    record: FitRecord
    low_rank: Correction | None = None
    sparse_weights: "sparse.csr_array | None" = None


def write_weights(
    file: h5py.File, binding: Binding, fit: StoredFit | None, keep_weights: bool = True
) -> None:
    """Write the weights in their form, and the record of their fit if there is one.

    Without `keep_weights`, only a change of low rank is written: what can be computed is not.
    """
    file.attrs["has_offsets"] = binding.has_offsets
    if fit is not None:
        file.attrs["fit"] = to_json(asdict(fit.record))
        if fit.low_rank is not None:
            write_deflated(file, f"{LOW_RANK}/columns", fit.low_rank.columns)
            write_deflated(file, f"{LOW_RANK}/basis", fit.low_rank.basis)
    if not keep_weights:
        return
    if fit is None or fit.sparse_weights is None:
        write_deflated(file, "weights", binding.weights)
        return
    matrix = fit.sparse_weights
    file.create_dataset(f"{CSR}/data", data=matrix.data, dtype="f8")
    file.create_dataset(f"{CSR}/indices", data=matrix.indices, dtype="i4")
    file.create_dataset(f"{CSR}/indptr", data=matrix.indptr, dtype="i8")


def holds_weights(file: h5py.File) -> bool:
    """Return whether a file holds weights, in any form that needs nothing else."""
    return "weights" in file or CSR in file


def read_weights(file: h5py.File, m: int, n: int) -> Floats:
    """Read the weights, (m, n) float64, whatever their form.

    Raises
    ------
    FormatError
        When they are damaged, do not fit the meshes, or are not finite.
    """
    if CSR in file:
        return np.asarray(read_sparse_weights(file, m, n).toarray())
    weights = read_array(file, "weights", "f", (m, n)).astype(np.float64, copy=False)
    _check_sizes("weights", weights)
    return weights


def read_sparse_weights(file: h5py.File, m: int, n: int) -> "sparse.csr_array":
    """Read weights with few influences; what they name is checked before it is used.

    Raises
    ------
    FormatError
        When they are damaged, do not fit the meshes, or are not finite.
    """
    from scipy import sparse

    data = read_array(file, f"{CSR}/data", "f", (None,)).astype(np.float64, copy=False)
    indices = read_array(file, f"{CSR}/indices", "iu", data.shape)
    bounds = read_array(file, f"{CSR}/indptr", "iu", (m + 1,))
    if not ((indices >= 0) & (indices < n)).all():
        raise FormatError(
            f"`{CSR}/indices` name vertices that the cage does not have ({n} vertices); write it "
            "again"
        )
    ascends = (bounds[1:] >= bounds[:-1]).all()
    if bounds[0] != 0 or bounds[-1] != len(data) or not ascends:
        raise FormatError(
            f"`{CSR}/indptr` does not divide {len(data)} entries into {m} rows; write it again"
        )
    starts: Integers = bounds.astype(np.int64)
    rows = np.repeat(np.arange(m), starts[1:] - starts[:-1])
    places = rows * n + indices.astype(np.int64)
    if not (np.diff(places) > 0).all():
        raise FormatError(f"`{CSR}/indices` do not ascend in each row; write it again")
    matrix = sparse.csr_array((data, (rows, indices.astype(np.int64))), shape=(m, n))
    if not are_lengths(np.abs(data)).all():
        row = int(rows[np.argmin(are_lengths(np.abs(data)))])
        raise FormatError(
            f"`{CSR}/data` are not finite, or too large, at vertex {row}; write it again"
        )
    return matrix


def read_offset_mark(file: h5py.File) -> bool:
    """Read whether the weights do not reproduce the rest pose; files without the mark do."""
    mark = read_attribute(file, "has_offsets", np.False_)
    if not isinstance(mark, np.bool_):
        raise FormatError(f"attribute `has_offsets` is {mark!r}, expected a truth value")
    if CSR in file and not mark:
        raise FormatError(
            f"attribute `has_offsets` is false, but the weights are sparse (`{CSR}`); write it "
            "again"
        )
    return bool(mark)


def read_fit_record(file: h5py.File) -> FitRecord | None:
    """Read the record of a fit; None if the weights are not fitted.

    Raises
    ------
    FormatError
        When it is not the record of a fit.
    """
    if "fit" not in file.attrs:
        return None
    held = read_json_attr(file, "fit", dict)
    with error_context("attribute `fit`"):
        record: FitRecord = parse_record(FitRecord, held, "fit")
    if not record.clips:
        raise FormatError("attribute `fit` names no clip that the weights were fitted to")
    return record


def read_fit(file: h5py.File, m: int, n: int) -> StoredFit | None:
    """Read a fit and the form of its weights; None if the weights are not fitted.

    Raises
    ------
    FormatError
        When the record or the form is damaged, or the form is not the recorded one.
    """
    record = read_fit_record(file)
    if record is None:
        return None
    matrix = read_sparse_weights(file, m, n) if CSR in file else None
    low_rank = _read_low_rank(file, m, n) if LOW_RANK in file else None
    rank, influences = record.settings.rank, record.settings.influences
    _check_form("rank", rank, LOW_RANK, is_stored=low_rank is not None)
    if holds_weights(file):
        _check_form("influences", influences, CSR, is_stored=matrix is not None)
    return StoredFit(record, low_rank, matrix)


def _check_form(option: str, value: int | None, group: str, is_stored: bool) -> None:
    """Refuse weights that are not in the form that the settings of the fit ask for."""
    if is_stored and value is None:
        raise FormatError(
            f"attribute `fit` has no {option}, but there is `{group}`; write it again"
        )
    if not is_stored and value is not None:
        raise FormatError(
            f"attribute `fit` has {option} {value}, but there is no `{group}`; write it again"
        )


def _read_low_rank(file: h5py.File, m: int, n: int) -> Correction:
    columns = read_array(file, f"{LOW_RANK}/columns", "f", (m, None)).astype(np.float64, copy=False)
    basis = read_array(file, f"{LOW_RANK}/basis", "f", (n, columns.shape[1]))
    basis = basis.astype(np.float64, copy=False)
    _check_sizes(f"{LOW_RANK}/columns", columns)
    _check_sizes(f"{LOW_RANK}/basis", basis)
    return Correction(columns, basis)


def _check_sizes(name: str, matrix: Floats) -> None:
    """Refuse numbers that are not finite, or larger than lengths are."""
    largest = np.maximum(matrix.max(axis=1, initial=0), -matrix.min(axis=1, initial=0))
    wrong = np.flatnonzero(~are_lengths(largest))
    if len(wrong):
        raise FormatError(
            f"`{name}` are not finite, or too large, at vertex {wrong[0]}; write it again"
        )
