"""What the cache keeps: weights, fits and built cages, each under a key of all they depend on."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.cages.bind import JudgedBinding
from cageik_cli.cages.settings import BUILDER_VERSION, BuildSettings
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import FIT_VERSION, FitRecord, FitSettings, FittedClip
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding, Correction
from cageik_cli.method.weights.settings import COORDINATES, BindSettings
from cageik_cli.store.cache import CorruptEntry, Entry, EntryCache, EntryFormat, compute_key
from cageik_cli.store.hdf5_fields import parse_record
from cageik_cli.util import compiled
from cageik_cli.util.arrays import Floats
from cageik_cli.util.messages import Note
from cageik_cli.util.version import __version__

WEIGHTS = EntryFormat(
    "weights",
    "the weights are",
    {"faces": "<i8", "weights": "<f8"},
    {
        "panels": int,
        "estimated_error": float,
        "projected": int,
        "notes": tuple,
        "cage_warnings": tuple,
        "has_loose_cage": bool | None,
    },
)
"""How a binding is kept: the faces of its cage, outward, its weights, and what is known of them."""

FITS = EntryFormat(
    "fit", "the weights are", {"weights": "<f8", "columns": "<f8", "basis": "<f8"}, {"record": str}
)
"""How fitted weights are kept: with their change of low rank, empty for other forms, and the record
of the fit without its clips, as JSON.
"""

CAGES = EntryFormat(
    "cage",
    "the cage is",
    {"vertices": "<f8", "faces": "<i8"},
    {"description": str, "notes": tuple},
)
"""How a built cage is kept: vertices (n, 3) in file units and faces, what was built in a line, and
what the user should know of it, a sentence each.
"""


def find_binding(
    cache: EntryCache,
    rest: TriMesh,
    cage: TriMesh,
    settings: BindSettings,
    compute: Callable[[], JudgedBinding],
) -> JudgedBinding:
    """Return the binding that `compute` gives, from the cache if it is there."""

    def to_entry(judged: JudgedBinding) -> Entry:
        binding = judged.binding
        return {
            "faces": binding.cage.faces,
            "weights": binding.weights,
            "panels": binding.panels,
            "estimated_error": binding.estimated_error,
            "projected": binding.projected,
            "notes": tuple(note.pack() for note in binding.notes),
            "cage_warnings": tuple(note.pack() for note in judged.cage_warnings),
            "has_loose_cage": judged.has_loose_cage,
        }

    def from_entry(entry: Entry) -> JudgedBinding:
        _check_shape(entry["weights"], len(rest.vertices), len(cage.vertices))
        is_outward = np.array_equal(cage.faces, entry.pop("faces"))
        warnings, entry["notes"] = (
            tuple(map(Note.unpack, entry.pop(name))) for name in ("cage_warnings", "notes")
        )
        is_loose = entry.pop("has_loose_cage")
        outward = cage if is_outward else cage.flip()
        return JudgedBinding(Binding(rest, outward, settings=settings, **entry), warnings, is_loose)

    key = compute_weight_key(rest, cage, settings)
    return cache.find_or_compute(WEIGHTS, key, compute, to_entry, from_entry)


def compute_weight_key(rest: TriMesh, cage: TriMesh, settings: BindSettings) -> str:
    """Return the key of a binding: a digest of all that its weights, notes and figures depend on.

    It covers the faces of the rest pose, on which warnings depend; not the number of threads, which
    does not change weights. The compiled core does, in the eighth digit: the equations are solved
    in single precision, which enlarges differences in the last bit.
    """
    recorded = {
        "version": __version__,
        "algorithm": COORDINATES[settings.coordinates].version,
        "compiled": compiled.kernel is not None,
        **asdict(settings),
    }
    return compute_key(recorded, rest.vertices, cage.vertices, rest.faces, cage.faces)


def find_fit(
    cache: EntryCache,
    key: str,
    binding: Binding,
    clips: tuple[FittedClip, ...],
    fit: Callable[[], FittedWeights],
) -> FittedWeights:
    """Return what `fit` makes of a binding, from the cache if it is there.

    The key is of `compute_fit_key`. The record names `clips`, whose files may have had other names
    when they were fitted.
    """

    def to_entry(fitted: FittedWeights) -> Entry:
        change = fitted.low_rank or Correction.none(0, 0)
        record = json.dumps(asdict(replace(fitted.fit, clips=())))
        weights = fitted.binding.weights
        arrays = {"weights": weights, "columns": change.columns, "basis": change.basis}
        return {**arrays, "record": record}

    def from_entry(entry: Entry) -> FittedWeights:
        record: FitRecord = parse_record(FitRecord, json.loads(entry["record"]), "fit")
        change = Correction(entry["columns"], entry["basis"])
        rows, columns = binding.weights.shape
        _check_shape(entry["weights"], rows, columns)
        if record.settings.rank is not None:
            _check_shape(change.columns, rows, change.basis.shape[1])
            _check_shape(change.basis, columns, change.basis.shape[1])
        has_offsets = record.settings.influences is not None
        return FittedWeights(
            replace(binding, weights=entry["weights"], has_offsets=has_offsets),
            fit=replace(record, clips=clips),
            low_rank=None if record.settings.rank is None else change,
            unfitted=binding,
        )

    return cache.find_or_compute(FITS, key, fit, to_entry, from_entry)


def compute_fit_key(
    binding: Binding,
    settings: FitSettings,
    frames: Sequence[Sequence[bytes]],
    *,
    solve: SolveSettings,
    vertex_weights: Floats | None,
    memory: int,
    skips_bad_frames: bool,
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
    recorded = {
        "version": __version__,
        "algorithm": FIT_VERSION,
        "settings": asdict(settings),
        "solve": asdict(solve),
        "memory": memory,
        "skips": skips_bad_frames,
        "frames": [[digest.hex() for digest in clip] for clip in frames],
    }
    weights = [] if vertex_weights is None else [vertex_weights]
    meshes = [
        array for mesh in (binding.rest, binding.cage) for array in (mesh.vertices, mesh.faces)
    ]
    return compute_key(recorded, binding.weights, *meshes, *weights)


def find_cage(
    cache: EntryCache, model: TriMesh, settings: BuildSettings, build: Callable[[], Entry]
) -> Entry:
    """Return the entry of the cage that `build` gives, from the cache if it is there."""

    def from_entry(entry: Entry) -> Entry:
        TriMesh(entry["vertices"], entry["faces"])  # refuses arrays that are none
        return entry

    return cache.find_or_compute(CAGES, compute_cage_key(model, settings), build, dict, from_entry)


def _check_shape(array: NDArray[Any], rows: int, columns: int) -> None:
    if array.shape != (rows, columns):
        raise CorruptEntry(f"has an array of shape {array.shape}, expected ({rows}, {columns})")


def compute_cage_key(model: TriMesh, settings: BuildSettings) -> str:
    """Return the key of a cage: a digest of all that it and its notes depend on."""
    recorded = {"version": __version__, "builder": BUILDER_VERSION, **asdict(settings)}
    return compute_key(recorded, model.vertices, model.faces)
