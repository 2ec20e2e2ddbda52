"""The cache of fitted weights, kept under a key of all that they depend on, the frames included."""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli import __version__
from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.problem import Correction
from cageik_cli.solver.fitting.fit import FitConditions
from cageik_cli.solver.fitting.record import FitRecord, FittedClip
from cageik_cli.solver.settings import FIT_VERSION, FitSettings
from cageik_cli.store.entry_cache import DEFAULT_MAX_BYTES, EntryCache, EntryFormat, as_bytes
from cageik_cli.store.fit_fields import StoredFit
from cageik_cli.store.json_records import parse_record


@dataclass(frozen=True, slots=True, eq=False)
class FitEntry:
    """Fitted weights without what the key stands for; arrays of other forms are empty.

    Attributes
    ----------
    weights : (m, n) float64
        Empty if they are sparse.
    columns, basis : (m, R) and (n, R) float64
        The change of low rank.
    data, indices, indptr : (z,) float64, (z,) int64, (m + 1,) int64
        Weights with few influences.
    record : str
        The record of the fit, without its clips, as JSON.
    seconds : float
        The time that the fit took.
    """

    weights: np.ndarray
    columns: np.ndarray
    basis: np.ndarray
    data: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray
    record: str
    seconds: float


FITS = EntryFormat(
    "fit",
    "the weights are",
    FitEntry,
    {
        "weights": "<f8",
        "columns": "<f8",
        "basis": "<f8",
        "data": "<f8",
        "indices": "<i8",
        "indptr": "<i8",
    },
)
"""How fitted weights are kept."""

FittedBinding = tuple[Binding, StoredFit]


def compute_fit_key(
    binding: Binding,
    settings: FitSettings,
    conditions: FitConditions,
    frames: Sequence[Sequence[bytes]],
) -> str:
    """Return the key of a fit: a digest of all that the fitted weights depend on.

    Threads are not in it; memory is, since fewer frames are fitted with little of it.

    Parameters
    ----------
    binding : Binding
        The weights that they are fitted from.
    frames : sequence of sequence of bytes
        For each clip, the digest of each frame.
    """
    sampling, effort = conditions.sampling, conditions.effort
    recorded: dict[str, Any] = {
        "version": __version__,
        "algorithm": FIT_VERSION,
        "settings": asdict(settings),
        "solve": asdict(conditions.solve),
        "sampling": asdict(replace(sampling, jobs=0)),
        "effort": (effort.max_rounds, effort.min_gain),
        "weighted": conditions.vertex_weights is not None,
        "shape": binding.weights.shape,
        "faces": (len(binding.rest.faces), len(binding.cage.faces)),
        "frames": list(map(len, frames)),
    }
    digest = hashlib.sha256(json.dumps(recorded, sort_keys=True).encode() + b"\n")
    weights = [] if conditions.vertex_weights is None else [conditions.vertex_weights]
    meshes = (binding.rest, binding.cage)
    for array in (binding.weights, *(mesh.vertices for mesh in meshes), *weights):
        digest.update(as_bytes(array, "<f8"))
    for mesh in meshes:
        digest.update(as_bytes(mesh.faces, "<i8"))
    for clip in frames:
        digest.update(b"".join(clip))
    return digest.hexdigest()


class FitCache(EntryCache[FitEntry]):
    """The fitted weights in a folder of entries; parameters as of `EntryCache`."""

    def __init__(
        self, folder: Path, note: Callable[[str], None], max_bytes: int = DEFAULT_MAX_BYTES
    ) -> None:
        super().__init__(FITS, folder, note, max_bytes)

    def get_or_fit(
        self,
        key: str,
        binding: Binding,
        clips: tuple[FittedClip, ...],
        fit: Callable[[], FittedBinding],
    ) -> FittedBinding:
        """Return what `fit` makes of a binding, from the cache if it is there.

        The key is of `compute_fit_key`. The record names `clips`, whose files may have had other
        names when they were fitted.
        """
        return self.find_or_compute(
            key, fit, _make_entry, lambda entry: _restore(entry, binding, clips)
        )


def _make_entry(fitted: FittedBinding, seconds: float) -> FitEntry:
    binding, fit = fitted
    none = np.empty((0, 0))
    change, matrix = fit.low_rank, fit.sparse_weights
    return FitEntry(
        weights=binding.weights if matrix is None else none,
        columns=none if change is None else change.columns,
        basis=none if change is None else change.basis,
        data=none if matrix is None else matrix.data,
        indices=none if matrix is None else matrix.indices,
        indptr=none if matrix is None else matrix.indptr,
        record=json.dumps(asdict(replace(fit.record, clips=()))),
        seconds=seconds,
    )


def _restore(entry: FitEntry, binding: Binding, clips: tuple[FittedClip, ...]) -> FittedBinding:
    record: FitRecord = parse_record(FitRecord, json.loads(entry.record), "fit")
    change = Correction(entry.columns, entry.basis) if record.settings.rank is not None else None
    matrix, weights = None, entry.weights
    if record.settings.influences is not None:
        from scipy import sparse

        places = (entry.data, entry.indices, entry.indptr)
        matrix = sparse.csr_array(places, shape=binding.weights.shape)
        weights = np.asarray(matrix.toarray())
    fitted = replace(binding, weights=weights, has_offsets=matrix is not None)
    return fitted, StoredFit(replace(record, clips=clips), change, matrix)
