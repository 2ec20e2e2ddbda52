"""Build a cage around any model: candidates from tight to loose, each judged by exact tests."""

from collections.abc import Callable

from cageik_cli.cages.building.job import Job
from cageik_cli.cages.building.records import BuildSettings, BuiltCage, Candidate, Clip
from cageik_cli.coordinates.weights import ignore_progress
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import NumericalError

__all__ = ["BuildSettings", "BuiltCage", "Candidate", "Clip", "build_cage"]

GOOD_ANGLE = 10.0
"""A smallest angle below this, degrees, makes a candidate rank lower."""

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
    settings : BuildSettings, optional
    clip : Clip, optional
        An animation of the model that the cage is for. All shells are then tried, without and with
        its poses; vertices of the best are shifted to where its error is; the smallest error wins.
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
    settings = settings or BuildSettings()
    job = Job.start(model, settings, clip)
    tried: list[Candidate] = []
    shifts = 0 if clip is None else SHIFTED
    total = len(job.ladder) + shifts
    for step, (recipe, poses) in enumerate(job.ladder):
        candidate = job.try_shell(recipe, poses)
        if candidate is not None:
            tried.append(job.measured(candidate))
        progress(step + 1, total)
        if clip is None and _is_enough(tried):
            break
    if not any(known.verdict.is_valid for known in tried):
        tried += [job.measured(loose) for loose in job.try_ellipsoids()]
    valid = sorted((known for known in tried if known.verdict.is_valid), key=rank)
    for step, candidate in enumerate(valid[:shifts]):
        tried.append(job.measured(job.try_shift(candidate)))
        progress(len(job.ladder) + step + 1, total)
    progress(total, total)
    return choose_best(tried)


def _is_enough(tried: list[Candidate]) -> bool:
    """Return whether the ladder can end, as the rungs that follow are looser."""
    valid = [candidate.verdict for candidate in tried if candidate.verdict.is_valid]
    flawless = any(v.smallest_angle >= GOOD_ANGLE and v.genus == 0 for v in valid)
    return flawless or len(valid) >= ENOUGH


def choose_best(tried: list[Candidate]) -> BuiltCage:
    """Take the valid candidate of the least error, or else from the tightest shell.

    Raises
    ------
    NumericalError
        When none is valid.
    """
    valid = [candidate for candidate in tried if candidate.verdict.is_valid]
    if not valid:
        reason = tried[-1].verdict.faults[0] if tried else "nothing could be made of the model"
        raise NumericalError(f"no cage passes the tests, the last one {reason}; please report it")
    best = min(valid, key=rank)
    return BuiltCage(best.cage, best, tuple(tried), best.notes)


def rank(candidate: Candidate) -> float:
    """Return the cost of a candidate: the best one has the lowest."""
    if candidate.error is not None:
        return candidate.error
    verdict = candidate.verdict
    poor = max(0.0, GOOD_ANGLE - verdict.smallest_angle) / GOOD_ANGLE
    return candidate.offset * (1 + poor + HANDLE_COST * verdict.genus)
