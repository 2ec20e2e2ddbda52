"""Weights fitted to clips: from the cache of fits, or computed."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.solver.fitting.fit import FitConditions, fit_weights
from cageik_cli.solver.fitting.record import FitRecord, FittedClip
from cageik_cli.solver.settings import FitSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.cache import EntryCache
from cageik_cli.store.fit_cache import FittedBinding, compute_fit_key, find_fit
from cageik_cli.store.fit_fields import StoredFit
from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.progress import ProgressListener


def fit_binding(
    stored: StoredBinding,
    clips: Sequence[MeshSequence],
    settings: FitSettings,
    conditions: FitConditions,
    cache: EntryCache | None,
) -> StoredBinding:
    """Fit the weights of a binding to clips, or take them from the cache of fits.

    Parameters
    ----------
    clips : sequence of MeshSequence
        Of the rest pose's connectivity.

    Raises
    ------
    InputError
        When a frame cannot be read or has changed meanwhile, or the cage is flat.
    NumericalError
        When the system of the cages is singular.
    """
    digests = _hash_frames(clips, conditions.sampling.jobs)
    fitted_clips = tuple(map(_describe_clip, clips))

    def compute() -> FittedBinding:
        found = fit_weights(stored.binding, clips, settings, conditions)
        _check_unchanged(clips, digests)
        record = FitRecord(settings, conditions.solve, fitted_clips, found.report)
        return found.binding, StoredFit(record, found.model.low_rank, found.model.sparse_weights)

    if cache is None:
        binding, fit = compute()
    else:
        key = compute_fit_key(stored.binding, settings, conditions, digests)
        binding, fit = find_fit(cache, key, stored.binding, fitted_clips, compute)
    return replace(stored, binding=binding, fit=fit, unfitted=stored.binding)


def open_fit_cache(folder: Path | None, progress: ProgressListener) -> EntryCache | None:
    """Return the cache of fits in a folder, which notes what it finds; None without a folder."""
    return None if folder is None else EntryCache(folder, partial(progress.note, "fit"))


def _hash_frames(clips: Sequence[MeshSequence], jobs: int) -> list[list[bytes]]:
    """Return the digests of all frames; zeros of those that cannot be read."""
    with ThreadPoolExecutor(jobs) as pool:
        return [list(pool.map(clip.content_digest, range(len(clip)))) for clip in clips]


def _describe_clip(clip: MeshSequence) -> FittedClip:
    source = clip.describe_source()
    return FittedClip(source["name"], source["sha256"], len(clip))


def _check_unchanged(clips: Sequence[MeshSequence], digests: list[list[bytes]]) -> None:
    """Refuse frames that were other ones when they were fitted than when they were hashed."""
    for clip, before in zip(clips, digests, strict=True):
        for k, digest in enumerate(before):
            if clip.content_digest(k) != digest:
                raise FileAccessError(f"{clip.location(k)}: changed during the run; run again")
