"""The cache of fitted weights, kept under a key of all that they depend on, the frames included."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from cageik_cli import __version__
from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.fitting.problem import Correction
from cageik_cli.solver.fitting.fit import FitConditions
from cageik_cli.solver.fitting.record import FitRecord, FittedClip
from cageik_cli.solver.settings import FIT_VERSION, FitSettings
from cageik_cli.store.cache import Entry, EntryCache, EntryFormat, compute_key
from cageik_cli.store.fit_fields import StoredFit
from cageik_cli.store.json_records import parse_record

FITS = EntryFormat(
    "fit",
    "the weights are",
    {
        "weights": "<f8",
        "columns": "<f8",
        "basis": "<f8",
        "data": "<f8",
        "indices": "<i8",
        "indptr": "<i8",
    },
    ("record",),
)
"""How fitted weights are kept; arrays of other forms than theirs are empty.

Weights (m, n) that are not sparse; their change of low rank, columns (m, R) and basis (n, R); and
weights with few influences, data (z,), indices (z,) and indptr (m + 1,). The record of the fit is
JSON, without its clips.
"""

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
        "frames": [[digest.hex() for digest in clip] for clip in frames],
    }
    weights = [] if conditions.vertex_weights is None else [conditions.vertex_weights]
    meshes = [
        array for mesh in (binding.rest, binding.cage) for array in (mesh.vertices, mesh.faces)
    ]
    return compute_key(recorded, binding.weights, *meshes, *weights)


def find_fit(
    cache: EntryCache,
    key: str,
    binding: Binding,
    clips: tuple[FittedClip, ...],
    fit: Callable[[], FittedBinding],
) -> FittedBinding:
    """Return what `fit` makes of a binding, from the cache if it is there.

    The key is of `compute_fit_key`. The record names `clips`, whose files may have had other names
    when they were fitted.
    """
    return cache.find_or_compute(
        FITS, key, fit, _make_entry, lambda entry: _restore(entry, binding, clips)
    )


def _make_entry(fitted: FittedBinding) -> Entry:
    binding, fit = fitted
    none = np.empty((0, 0))
    change, matrix = fit.low_rank, fit.sparse_weights
    return {
        "weights": binding.weights if matrix is None else none,
        "columns": none if change is None else change.columns,
        "basis": none if change is None else change.basis,
        "data": none if matrix is None else matrix.data,
        "indices": none if matrix is None else matrix.indices,
        "indptr": none if matrix is None else matrix.indptr,
        "record": json.dumps(asdict(replace(fit.record, clips=()))),
    }


def _restore(entry: Entry, binding: Binding, clips: tuple[FittedClip, ...]) -> FittedBinding:
    record: FitRecord = parse_record(FitRecord, json.loads(entry["record"]), "fit")
    change = (
        Correction(entry["columns"], entry["basis"]) if record.settings.rank is not None else None
    )
    matrix, weights = None, entry["weights"]
    if record.settings.influences is not None:
        from scipy import sparse

        places = (entry["data"], entry["indices"], entry["indptr"])
        matrix = sparse.csr_array(places, shape=binding.weights.shape)
        weights = np.asarray(matrix.toarray())
    fitted = replace(binding, weights=weights, has_offsets=matrix is not None)
    return fitted, StoredFit(replace(record, clips=clips), change, matrix)
