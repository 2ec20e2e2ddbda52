"""Weights fitted to clips: from the cache of fits, or computed; and compared with those before.

The algorithm is imported when weights are fitted: other runs start without it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.captured.robust import has_outlier_vertices
from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import FitSettings, FittedClip
from cageik_cli.formats.base.sequence import MeshSequence, as_sequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.seams import Seams
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.metrics import check_finite, measure
from cageik_cli.method.solve.settings import FITTED_NORM, SolveSettings
from cageik_cli.method.solve.vertex_weights import make_vertex_weights
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.keywords import read_jobs
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.cache import EntryCache, compute_fit_key, find_fit
from cageik_cli.store.fit_fields import BaselineErrors
from cageik_cli.util.arrays import Floats, Integers, Workspace, spread_evenly
from cageik_cli.util.calls import check_call
from cageik_cli.util.errors import FileAccessError, InputError
from cageik_cli.util.messages import Note, Said, say
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.settings import DEFAULT_MEMORY
from cageik_cli.util.text import format_bytes, format_count

MIN_FRAMES_BY_DEFAULT = 3
"""Shorter clips have one pose beside that at rest: weights are fitted to it only if asked for."""

MAX_PROBED_FRAMES = 100
"""Evenly spread frames in which outlier vertices are sought before what they would spoil, and
vertices that come apart."""

MAX_COMPARED_FIT_FRAMES = 64
"""Evenly spread frames on which a fit is compared; key frames are measured beside them."""


@check_call
def fit_weights(
    binding: Binding,
    clips: Sequence[MeshSequence | ArrayLike],
    settings: FitSettings | None = None,
    *,
    solve: SolveSettings | None = None,
    vertex_weights: ArrayLike | Literal["area"] | None = None,
    memory: int = DEFAULT_MEMORY,
    jobs: int | None = None,
) -> FittedWeights:
    """Fit the weights of a binding to one or several clips.

    The fitted binding reproduces the rest pose as the given one does, and the frames of the clips
    several times more closely. The report tells how close it is on frames that were held out.

    Parameters
    ----------
    binding : Binding
        Its weights, harmonic or not, are what the fitted ones are pulled to.
    clips : sequence of MeshSequence or (F, m, 3) arrays
        Frames with the vertices of `binding.rest`, in the same order.
    settings : FitSettings, optional
        How closely to fit, and with how many numbers.
    solve : SolveSettings, optional
        How the cages are solved. By default the largest deviations of clips without outliers are
        lowered, by weights and cages: extract with `norm=6`, too.
    vertex_weights : (m,) or "area", optional
        Weights of the vertices; 0 marks missing data. Or each vertex counts by its area.
    memory : int
        Limit in bytes for the weights and the frames that they are fitted to, at most 200.
    jobs : int, optional
        Threads; as many as there are processors by default. They do not change the weights.

    Raises
    ------
    CageikError
        When a frame cannot be read or does not fit the binding, the cage is flat, or the solve
        fails.

    Examples
    --------
    >>> from cageik_cli import bind, extract, fit_weights, load_clip, load_mesh
    >>> clip = load_clip("data_fixtures/walker/frames", selection=slice(0, 12))
    >>> binding = bind(clip.first, load_mesh("data_fixtures/walker/cage.obj"), accuracy="preview")
    >>> fitted = fit_weights(binding, [clip])
    >>> before, after = (extract(clip, one).rms_percent for one in (binding, fitted.binding))
    >>> after < 0.5 * before
    True
    """
    sequences = [as_sequence(clip, binding.rest) for clip in clips]
    settings = settings or FitSettings()
    return _fit_welded(
        binding,
        sequences,
        settings,
        find_seams(binding.rest, sequences),
        solve=choose_norm(solve or SolveSettings(), settings, sequences),
        vertex_weights=make_vertex_weights(vertex_weights, binding.rest),
        memory=memory,
        jobs=read_jobs(jobs),
    )


def find_seams(rest: TriMesh, clips: Sequence[MeshSequence]) -> Seams | None:
    """Find the vertices of a rest pose that never come apart in evenly spread frames of clips."""
    count = max(1, MAX_PROBED_FRAMES // max(1, len(clips)))
    return Seams.find(rest, (frame for clip in clips for frame in _read_probed_frames(clip, count)))


class _WeldedClip:
    """The frames of a clip with one vertex for those that never come apart."""

    def __init__(self, clip: MeshSequence, seams: Seams) -> None:
        self._clip, self._firsts = clip, seams.firsts

    def __len__(self) -> int:
        return len(self._clip)

    def read_frame(self, index: int) -> Floats:
        """Read the vertices of a frame, (k, 3)."""
        return self._clip.read_frame(index)[self._firsts]


def _fit_welded(
    binding: Binding,
    clips: Sequence[MeshSequence],
    settings: FitSettings | None,
    seams: Seams | None,
    *,
    solve: SolveSettings | None,
    vertex_weights: Floats | None,
    memory: int,
    jobs: int,
    skips_bad_frames: bool = False,
) -> FittedWeights:
    """Fit weights, the same for vertices that never come apart: one of them is fitted."""
    from cageik_cli.fit.fit import Fitter

    welded = binding
    frames: Sequence[MeshSequence | _WeldedClip] = clips
    if seams is not None:
        welded = replace(binding, rest=seams.weld(), weights=binding.weights[seams.firsts])
        frames = [_WeldedClip(clip, seams) for clip in clips]
        if vertex_weights is not None:
            vertex_weights = seams.sum_weights(vertex_weights)
    fitter = Fitter(
        welded, settings, solve=solve, vertex_weights=vertex_weights, memory=memory, jobs=jobs
    )
    fitted = fitter.fit(frames, skips_bad_frames)
    if seams is None:
        return fitted
    found, change = fitted.binding, fitted.low_rank
    whole = replace(binding, weights=found.weights[seams.places], has_offsets=found.has_offsets)
    if change is not None:
        change = replace(change, columns=change.columns[seams.places])
    return replace(fitted, binding=whole, low_rank=change, unfitted=binding)


def choose_fit(
    settings: ExtractSettings, clip: MeshSequence, weighs_frames: bool = False
) -> tuple[FitSettings | None, tuple[Note, ...]]:
    """Choose how weights are fitted to a clip: as asked; else they are if a cage is built.

    A fit that was not asked for is left out where it would be refused, or follow data that says
    nothing of the model. A given cage keeps the weights that it defines.

    Parameters
    ----------
    weighs_frames : bool
        Whether vertices may be missing, or count less in some frames.

    Returns
    -------
    FitSettings or None
    tuple of Note
        The note on why weights are not fitted; none if they are, or nobody expects it.
    """
    if settings.fit is not None or not settings.builds_cage:
        return settings.fit or None, ()  # type: ignore[return-value]  # True is made to settings
    reason = _find_fit_obstacle(settings, clip, weighs_frames)
    return (None, (Note("weights are not fitted: " + reason),)) if reason else (FitSettings(), ())


def choose_norm(
    solve: SolveSettings,
    fit: FitSettings | None,
    clips: Sequence[MeshSequence],
    *,
    is_clean: bool | None = None,
) -> SolveSettings:
    """Choose the norm of the cages: as asked; else `FITTED_NORM` for fitted weights.

    That is for weights all of which are fitted: their rows lower the largest deviations, too, and
    the error does not rise. Vertices that are outliers would win, so clips with any are left out.

    Parameters
    ----------
    fit : FitSettings or None
        How the weights are fitted, or were.
    is_clean : bool, optional
        Whether the clips have no outliers; looked for by default, where that counts.
    """
    if solve.norm is not None:
        return solve
    if fit is None or fit.rank is not None or fit.influences is not None:
        return solve
    if is_clean is None:
        is_clean = not any(_has_outliers(clip) for clip in clips)
    return replace(solve, norm=FITTED_NORM) if is_clean else solve


def _find_fit_obstacle(settings: ExtractSettings, clip: MeshSequence, weighs_frames: bool) -> Said:
    """Say what stands against a fit that nobody asked for; nothing if it can be made."""
    frames = len(clip) - len(clip.missing)
    if weighs_frames:
        return say(
            "the data may be noisy or missing; fit a clean clip of the same model by "
            "cageik bind `fit=`, and extract by `binding=`"
        )
    if not settings.keep_weights:
        return "the result does not hold weights, and fitted ones cannot be computed again"
    if frames < MIN_FRAMES_BY_DEFAULT:
        return f"the clip has {format_count(frames, 'frame')}; " + say(
            "fit them all the same by `fit=`"
        )
    from cageik_cli.fit.sample import estimate_least_memory

    needed = estimate_least_memory(len(clip.first.vertices), settings.build.vertices, frames)
    if needed > settings.memory:
        return (
            f"that takes at least {format_bytes(needed)}, more than the limit of "
            f"{format_bytes(settings.memory)}; " + say("raise it by `memory=`")
        )
    if _has_outliers(clip):
        return say(
            "single vertices are outliers among their neighbours; fitted weights would "
            "follow them; reject them by `robust=True`"
        )
    return ""


def _has_outliers(clip: MeshSequence) -> bool:
    """Return whether single vertices are outliers in some of a few frames of a clip."""
    return has_outlier_vertices(clip.first, _read_probed_frames(clip))


def _read_probed_frames(clip: MeshSequence, count: int = MAX_PROBED_FRAMES) -> Iterator[Floats]:
    """Read evenly spread frames of a clip; those that cannot be read are dealt with later."""
    for k in spread_evenly(len(clip), count).tolist():
        with suppress(InputError):
            yield clip.read_frame(k)


def fit_to_clips(
    binding: Binding,
    clips: Sequence[MeshSequence],
    settings: FitSettings,
    progress: ProgressListener,
    *,
    solve: SolveSettings,
    vertex_weights: Floats | None,
    memory: int,
    jobs: int,
    skips_bad_frames: bool = False,
    cache: Path | None = None,
) -> tuple[FittedWeights, list[Note]]:
    """Fit the weights of a binding to clips, or take them from the cache; and say what is welded.

    Parameters
    ----------
    clips : sequence of MeshSequence
        Of the rest pose's connectivity.
    vertex_weights : (m,) float64 or None
        Of mean one.
    """
    with ThreadPoolExecutor(jobs) as pool:  # zeros of frames that cannot be read
        digests = [list(pool.map(clip.content_digest, range(len(clip)))) for clip in clips]
    described = tuple(map(_describe_clip, clips))

    seams = find_seams(binding.rest, clips)
    notes = [] if seams is None else [Note(seams.note)]

    def compute() -> FittedWeights:
        fitted = _fit_welded(
            binding,
            clips,
            settings,
            seams,
            solve=solve,
            vertex_weights=vertex_weights,
            memory=memory,
            jobs=jobs,
            skips_bad_frames=skips_bad_frames,
        )
        _check_unchanged(clips, digests)
        return replace(fitted, fit=replace(fitted.fit, clips=described))

    if cache is None:
        return compute(), notes
    key = compute_fit_key(
        binding,
        settings,
        digests,
        solve=solve,
        vertex_weights=vertex_weights,
        memory=memory,
        skips_bad_frames=skips_bad_frames,
        places=None if seams is None else seams.places,
    )
    entries = EntryCache(cache, partial(progress.note, "fit"))
    return find_fit(entries, key, binding, described, compute), notes


def _describe_clip(clip: MeshSequence) -> FittedClip:
    source = clip.describe_source()
    return FittedClip(source["name"], source["sha256"], len(clip))


def _check_unchanged(clips: Sequence[MeshSequence], digests: list[list[bytes]]) -> None:
    """Refuse frames that were other ones when they were fitted than when they were hashed."""
    for clip, before in zip(clips, digests, strict=True):
        for k, digest in enumerate(before):
            if clip.content_digest(k) != digest:
                raise FileAccessError(f"{clip.location(k)}: changed during the run; run again")


def measure_baseline_weights(
    solver: DualLaplacianSolver,
    fitted: Binding,
    frames: Sequence[int],
    key_frames: Sequence[int],
    read: Callable[[int], Floats],
) -> BaselineErrors:
    """Measure frames with the weights before the fit, one by one.

    Parameters
    ----------
    solver : DualLaplacianSolver
        With the weights before the fit.
    frames : sequence of int
        From `choose_compared_frames`.
    key_frames : sequence of int
        Those of them that the result keeps in full.
    read : callable
        Reads a frame, (m, 3), by its number.
    """
    rest, workspace, misses = solver.binding.rest, Workspace(), {}
    rms = np.empty(len(frames))
    for place, k in enumerate(frames):
        frame = read(k)[None]
        solution = solver.solve(frame, workspace)
        rebuilt = solution.reconstructions
        metrics, _ = measure(rest, frame, rebuilt, solver.data_vertices, workspace)
        check_finite([k], solution.cages, metrics)
        rms[place] = metrics.rms[0]
        if k in key_frames:
            misses[k] = (frame[0] - rebuilt[0]) / rest.diagonal
    vertex = find_changed_vertex(solver.binding.weights, fitted.weights)
    return BaselineErrors(
        frames=np.array(frames, np.int64),
        rms=rms,
        misses=np.stack([misses[k] for k in key_frames]),
        cage_vertex=vertex,
        influence=solver.binding.weights[:, vertex].copy(),
    )


def choose_compared_frames(known: Integers, key_frames: Sequence[int]) -> list[int]:
    """Return evenly spread ones of the known frames, and the key frames."""
    places = spread_evenly(len(known), MAX_COMPARED_FIT_FRAMES)
    return sorted({*known[places].tolist(), *key_frames})


def find_changed_vertex(before: Floats, after: Floats) -> int:
    """Return the cage vertex whose weights differ most, by the norm of its column of (m, n)."""
    changes = [np.linalg.norm(new - old) for old, new in zip(before.T, after.T, strict=True)]
    return int(np.argmax(changes))
