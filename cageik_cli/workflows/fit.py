"""Weights fitted to clips: from the cache of fits, or computed."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.solver.fitting.record import FitRecord, FittedClip
from cageik_cli.solver.settings import FitSettings, SolveSettings
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.fit_cache import FitCache, FitInputs, FittedBinding
from cageik_cli.store.fit_fields import StoredFit
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.progress import ProgressListener


@dataclass(frozen=True, slots=True, eq=False)
class FitRequest:
    """How weights are fitted to clips.

    Attributes
    ----------
    settings : FitSettings
    solve : SolveSettings
    vertex_weights : (m,) float64, optional
        Of mean one; a vertex of weight 0 is missing data.
    memory : int
        Bytes for the weights and the frames that they are fitted to.
    jobs : int
        Threads.
    skips_bad_frames : bool
        Whether frames that cannot be read are left out; otherwise they are refused.
    cache : Path, optional
        The folder of the cache; none is used if absent.
    """

    settings: FitSettings
    solve: SolveSettings
    vertex_weights: Floats | None = None
    memory: int = 1 << 30
    jobs: int = 1
    skips_bad_frames: bool = False
    cache: Path | None = None


def fit_binding(
    stored: StoredBinding,
    clips: Sequence[MeshSequence],
    request: FitRequest,
    progress: ProgressListener,
) -> StoredBinding:
    """Fit the weights of a binding to clips, or take them from the cache of fits.

    Parameters
    ----------
    stored : StoredBinding
    clips : sequence of MeshSequence
        Of the rest pose's connectivity.
    request : FitRequest
    progress : ProgressListener

    Raises
    ------
    InputError
        When a frame cannot be read or has changed meanwhile, or the cage is flat.
    NumericalError
        When the system of the cages is singular.
    """
    digests = _hash_frames(clips, request.jobs)
    fitted_clips = tuple(map(_describe_clip, clips))
    inputs = FitInputs(
        binding=stored.binding,
        settings=request.settings,
        solve=request.solve,
        vertex_weights=request.vertex_weights,
        memory=request.memory,
        skips_bad_frames=request.skips_bad_frames,
        frames=digests,
    )

    def compute() -> FittedBinding:
        fitted = _fit(inputs, clips, fitted_clips, request.jobs)
        _check_unchanged(clips, digests)
        return fitted

    if request.cache is None:
        binding, fit = compute()
    else:
        cache = FitCache(request.cache, partial(progress.note, "fit"))
        binding, fit = cache.get_or_fit(inputs, fitted_clips, compute)
    return replace(stored, binding=binding, fit=fit, unfitted=stored.binding)


def _fit(
    inputs: FitInputs,
    clips: Sequence[MeshSequence],
    fitted_clips: tuple[FittedClip, ...],
    jobs: int,
) -> FittedBinding:
    from cageik_cli.solver.fitting.fit import FitConditions, fit_weights
    from cageik_cli.solver.fitting.sample import SampleSettings

    sampling = SampleSettings(inputs.memory, jobs, inputs.skips_bad_frames)
    conditions = FitConditions(inputs.solve, inputs.vertex_weights, sampling)
    found = fit_weights(inputs.binding, clips, inputs.settings, conditions)
    record = FitRecord(inputs.settings, fitted_clips, found.report)
    return found.binding, StoredFit(record, found.model.low_rank, found.model.sparse_weights)


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
