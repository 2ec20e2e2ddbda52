"""Build a cage around any model: candidates from tight to loose, each judged by exact tests."""

from collections.abc import Callable, Iterator

from cageik_cli.cages.building.job import Job
from cageik_cli.cages.building.records import BuildSettings, BuiltCage, Candidate, Clip
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import NumericalError
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.threads import limit_blas_threads

__all__ = ["BuildSettings", "BuiltCage", "Candidate", "Clip", "build_cage"]

GOOD_ANGLE = 10.0
"""A smallest angle below this, degrees, makes a candidate rank lower."""

MIN_GOOD_ANGLE = 5.0
"""Smaller angles of a cage that is built, degrees, are noted."""

HANDLE_COST = 0.1
"""The cost of a handle: a candidate without it may have a shell looser by this share."""

SHIFTED = 3
"""The best candidates whose vertices are shifted to where they miss an animation."""

ENOUGH = 2
"""Valid candidates after which the ladder ends, when none is measured or flawless."""


def build_cage(
    model: TriMesh,
    settings: BuildSettings | None = None,
    clip: Clip | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
) -> BuiltCage:
    """Build the best cage of a ladder of candidates.

    Parameters
    ----------
    model : TriMesh
        Any triangles: open, in pieces, crossing themselves, without area.
    clip : Clip, optional
        An animation of the model that the cage is for. The tightest shells are then tried, without
        and with its poses, and looser ones if all of them fail; vertices of the best cages are
        shifted to where the error is; the smallest error wins.
        Without a clip, the first flawless candidate is taken, or the better of the first two.
    progress : callable
        Called with (candidates done, candidates) after every one.

    Raises
    ------
    FormatError
        When the model is one point.
    NumericalError
        When no candidate passes; no such model is known.
    """
    # Sums of several threads are rounded otherwise, and a choice may hang on that.
    with limit_blas_threads(1):
        job = Job.start(model, settings or BuildSettings(), clip)
        shifts = 0 if clip is None else SHIFTED
        rungs, total = len(job.ladder), len(job.ladder) + shifts
        tried = _try_shells(job, lambda done: progress(done, total))
        if not _list_valid(tried):
            tried += [job.measure(loose) for loose in job.try_ellipsoids()]
        for step, candidate in enumerate(sorted(_list_valid(tried), key=rank)[:shifts]):
            tried.append(job.measure(job.try_shift(candidate)))
            progress(rungs + step + 1, total)
    progress(total, total)
    return choose_best(tried)


def _try_shells(job: Job, progress: Callable[[int], None]) -> list[Candidate]:
    """Return the candidates of the ladder, and of the reserve while none of them is valid."""
    tried: list[Candidate] = []
    for step, (recipe, poses) in enumerate((*job.ladder, *job.reserve)):
        if step >= len(job.ladder) and _list_valid(tried):
            break
        candidate = job.try_shell(recipe, poses)
        if candidate is not None:
            tried.append(job.measure(candidate))
        progress(min(step + 1, len(job.ladder)))
        if job.clip is None and _is_enough(tried):
            break
    return tried


def _list_valid(tried: list[Candidate]) -> list[Candidate]:
    """Return the candidates that may be handed out."""
    return [candidate for candidate in tried if candidate.verdict.is_valid]


def _is_enough(tried: list[Candidate]) -> bool:
    """Return whether the ladder can end, as the rungs that follow are looser."""
    valid = [candidate.verdict for candidate in _list_valid(tried)]
    flawless = any(v.smallest_angle >= GOOD_ANGLE and v.genus == 0 for v in valid)
    return flawless or len(valid) >= ENOUGH


def choose_best(tried: list[Candidate]) -> BuiltCage:
    """Take the valid candidate of the least error, or else from the tightest shell.

    Raises
    ------
    NumericalError
        When none is valid.
    """
    valid = _list_valid(tried)
    if not valid:
        reason = tried[-1].verdict.faults[0] if tried else "nothing could be made of the model"
        raise NumericalError(f"no cage passes the tests, the last one {reason}; please report it")
    best = min(valid, key=rank)
    return BuiltCage(best.cage, best, tuple(tried), (*best.notes, *_note_angle(best)))


def _note_angle(candidate: Candidate) -> Iterator[str]:
    """Yield a sentence on the smallest angle, if it is small."""
    angle = candidate.verdict.smallest_angle
    if angle < MIN_GOOD_ANGLE:
        yield (
            f"the smallest angle is {angle:.2g} degrees, expected {MIN_GOOD_ANGLE:g} or more; "
            "weights nearby are less accurate"
        )


def rank(candidate: Candidate) -> float:
    """Return the cost of a candidate: the best one has the lowest."""
    if candidate.error is not None:
        return candidate.error
    verdict = candidate.verdict
    poor = max(0.0, GOOD_ANGLE - verdict.smallest_angle) / GOOD_ANGLE
    return candidate.offset * (1 + poor + HANDLE_COST * verdict.genus)
