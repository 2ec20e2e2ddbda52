"""Built cages, kept under a key of the model and of how they are built."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from cageik_cli import __version__
from cageik_cli.cages.settings import BUILDER_VERSION, BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store.entry_cache import DEFAULT_MAX_BYTES, EntryCache, EntryFormat, as_bytes


@dataclass(frozen=True, slots=True, eq=False)
class CageEntry:
    """A cage that was built, without its candidates.

    Attributes
    ----------
    vertices : (n, 3) float64
        File units.
    faces : (f, 3) int64
    description : str
        What was built, in a line.
    notes : tuple of str
        What the user should know of it, one sentence each.
    seconds : float
        The time that it took to build.
    """

    vertices: np.ndarray
    faces: np.ndarray
    description: str
    notes: tuple[str, ...]
    seconds: float = 0.0


CAGES = EntryFormat("cage", "the cage is", CageEntry, {"vertices": "<f8", "faces": "<i8"})
"""How cages are kept."""


class CageCache(EntryCache[CageEntry]):
    """The built cages in a folder of entries; parameters as of `EntryCache`."""

    def __init__(
        self, folder: Path, note: Callable[[str], None], max_bytes: int = DEFAULT_MAX_BYTES
    ) -> None:
        super().__init__(CAGES, folder, note, max_bytes)

    def get_or_build(
        self, model: TriMesh, settings: BuildSettings, build: Callable[[], CageEntry]
    ) -> CageEntry:
        """Return the cage that `build` gives, from the cache if it is there."""
        key = compute_cage_key(model, settings)
        return self.find_or_compute(key, build, _set_seconds, lambda entry: entry)


def compute_cage_key(model: TriMesh, settings: BuildSettings) -> str:
    """Return the key of a cage: a digest of all that it and its notes depend on."""
    recorded = {
        "version": __version__,
        "builder": BUILDER_VERSION,
        **asdict(settings),
        "model": (len(model.vertices), len(model.faces)),
    }
    digest = hashlib.sha256(json.dumps(recorded, sort_keys=True).encode() + b"\n")
    digest.update(as_bytes(model.vertices, "<f8"))
    digest.update(as_bytes(model.faces, "<i8"))
    return digest.hexdigest()


def _set_seconds(entry: CageEntry, seconds: float) -> CageEntry:
    return replace(entry, seconds=seconds)
