"""The weight cache: weights are kept under a key of all that they depend on."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from cageik_cli import __version__
from cageik_cli.coordinates.binding import ALGORITHM_VERSIONS, Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store.entry_cache import DEFAULT_MAX_BYTES, EntryCache, EntryFormat, as_bytes
from cageik_cli.util import compiled


@dataclass(frozen=True, slots=True, eq=False)
class CacheEntry:
    """A binding without the arrays that its key stands for.

    Attributes
    ----------
    faces : (f, 3) int64
        Of the cage, outward.
    weights : (m, n) float64
    notes, cage_warnings : tuple of str
        As in `Binding`.
    has_loose_cage : bool, optional
        As in `Binding`: a run with bad regions asks for it.
    seconds : float
        The time that it took to compute.
    """

    faces: np.ndarray
    weights: np.ndarray
    panels: int
    estimated_error: float
    projected: int
    notes: tuple[str, ...]
    cage_warnings: tuple[str, ...]
    has_loose_cage: bool | None
    seconds: float


WEIGHTS = EntryFormat("weights", "the weights are", CacheEntry, {"faces": "<i8", "weights": "<f8"})
"""How weights are kept."""


class WeightCache(EntryCache[CacheEntry]):
    """The weights in a folder of entries; parameters as of `EntryCache`."""

    def __init__(
        self, folder: Path, note: Callable[[str], None], max_bytes: int = DEFAULT_MAX_BYTES
    ) -> None:
        super().__init__(WEIGHTS, folder, note, max_bytes)

    def get_or_compute(
        self, rest: TriMesh, cage: TriMesh, settings: BindSettings, compute: Callable[[], Binding]
    ) -> Binding:
        """Return the binding that `compute` gives, from the cache if it is there."""

        def from_entry(entry: CacheEntry) -> Binding:
            return Binding(
                rest=rest,
                cage=cage if np.array_equal(cage.faces, entry.faces) else cage.flip(),
                weights=entry.weights,
                settings=settings,
                panels=entry.panels,
                estimated_error=entry.estimated_error,
                projected=entry.projected,
                notes=entry.notes,
                cage_warnings=entry.cage_warnings,
                has_loose_cage=entry.has_loose_cage,
            )

        key = compute_key(rest, cage, settings)
        return self.find_or_compute(key, compute, _make_entry, from_entry)


def compute_key(rest: TriMesh, cage: TriMesh, settings: BindSettings) -> str:
    """Return the key of a binding: a digest of all that its weights, notes and figures depend on.

    It covers the faces of the rest pose, on which warnings depend; not the number of threads, which
    does not change weights. The compiled core does, in the eighth digit: the equations are solved
    in single precision, which enlarges differences in the last bit.
    """
    recorded = {
        "version": __version__,
        "algorithm": ALGORITHM_VERSIONS[settings.coordinates],
        "compiled": compiled.kernel is not None,
        **asdict(settings),
        "rest": len(rest.vertices),
        "cage": len(cage.vertices),
        "faces": [len(rest.faces), len(cage.faces)],
    }
    digest = hashlib.sha256(json.dumps(recorded, sort_keys=True).encode() + b"\n")
    for array in (rest.vertices, cage.vertices):
        digest.update(as_bytes(array, "<f8"))
    for faces in (rest.faces, cage.faces):
        digest.update(as_bytes(faces, "<i8"))
    return digest.hexdigest()


def _make_entry(binding: Binding, seconds: float) -> CacheEntry:
    return CacheEntry(
        faces=binding.cage.faces,
        weights=binding.weights,
        panels=binding.panels,
        estimated_error=binding.estimated_error,
        projected=binding.projected,
        notes=binding.notes,
        cage_warnings=binding.cage_warnings,
        has_loose_cage=binding.has_loose_cage,
        seconds=seconds,
    )
