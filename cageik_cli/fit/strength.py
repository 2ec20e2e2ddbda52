"""How strongly weights are pulled to those before the fit: chosen by measurement.

A weaker pull follows the frames more closely, also most that were never seen, and takes no longer.
It has two prices: from some strength on other motion is followed worse, and edits of the cage move
the surface less smoothly. How soon depends on the clip, so both are measured on the way down a
ladder of strengths. A fit takes a few rounds at each, from the weights that it has. Two trials go
down first, fitted to every second block of frames and to the first two thirds of each clip. Then
the fit to all frames takes the same rounds, as far as they were worth it.

Rounds until nothing changes would not be better: the error falls by a few percent more, but edits
become two to three times as much rougher as they are by then.

How rough edits are is the norm of the surface's Laplacian of the displacements, |Λ W e|, relative
to |Λ H e| with the weights before. The edits e are bumps exp(-(d/r)²) over the distance d from some
vertices of the cage.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cageik_cli.fit.alternate import Alternator
from cageik_cli.fit.norm import TRIAL_ROUNDS, lower_deviations
from cageik_cli.fit.problem import Displacements, WeightProblem
from cageik_cli.fit.sample import Sample, spread_points
from cageik_cli.fit.settings import (
    DEFAULT_STRENGTH,
    MAX_EDIT_ROUGHNESS,
    MIN_DISTINCT_FRAMES,
    EditRoughness,
    FitSettings,
    Strength,
    StrengthLimit,
    TriedStrength,
    Use,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Correction
from cageik_cli.util.arrays import Floats, Mask


class Rung(NamedTuple):
    """A strength, and the rounds that a fit takes at it."""

    strength: Strength
    rounds: int = 2


LADDER = (
    Rung(Strength(1.0, 1.0), rounds=1),
    Rung(Strength(0.1, 1.0)),
    Rung(Strength(0.01, 1.0)),
    Rung(Strength(0.003, 0.3)),
    Rung(Strength(0.003, 0.1)),
    Rung(Strength(0.003, 0.03)),
    Rung(Strength(0.001, 0.001)),
)
"""Strengths, the strongest first, with two rounds at each but that.

The pull falls first, and the smoothness from 0.003 on: on four clips, that has the smallest error
for edits that are as rough. Below 0.003, motion that was not seen is followed worse on some. With
one round at each, errors are 2 % larger for edits that are as rough; with three, edits are rougher.
Two strengths more, at (0.003, 1) and (0.003, 0.01), lower errors by 2 to 6 % and take a third more.
"""

PLAYED_TIMES, PLAYED_ROUNDS = 3, 6
"""For weights that are only played, the last strength is taken on so many times with so many rounds
each, as long as they help."""

STEPS_PER_ROUND = 3
"""Steps of conjugate gradients in a round: enough, as each strength is near to the one before."""

MAX_RISE = 1.02
"""A strength is refused whose held-out error is more than this times that of the one before."""

MIN_GAIN = 0.005
"""It is left out, too, if it lowers no held-out error by this share."""

ENOUGH_FRAMES = 16
"""Distinct frames from which on the default strength is strong enough, if there are too few to
choose. Weights fitted to 8 consecutive frames of a dance are worse than harmonic ones elsewhere."""

BLENDED_SHARES = (1.0, 0.75, 0.5, 0.25)
"""Shares of what lowers the largest deviations that are tried, as it makes edits rougher."""

EDIT_RADII = (0.3, 0.15)
"""Radii r of smooth and of local edits, in diagonals of the cage."""

MAX_EDITS = 20
"""Edits of each kind."""


class EditMeter:
    """Measures how rough edits of the cage are with changed weights.

    Parameters
    ----------
    problem : WeightProblem
        With the weights before, H, and the surface.
    cage : TriMesh
    """

    def __init__(self, problem: WeightProblem, cage: TriMesh) -> None:
        self._problem = problem
        places = cage.vertices
        chosen = places[spread_points(places - places.mean(axis=0), MAX_EDITS)]
        squares = np.square(places[:, None] - chosen).sum(axis=2) / cage.diagonal**2
        self._edits = np.hstack([np.exp(-squares / radius**2) for radius in EDIT_RADII])
        self._before = problem.rest_weights @ self._edits
        self._own = self._measure(self._before)

    def measure(self, change: Correction) -> EditRoughness:
        """Measure the weights before with a change."""
        moved = self._before + change.express(self._edits)
        return self._compare(self._measure(moved))

    def measure_weights(self, weights: Floats) -> EditRoughness:
        """Measure weights (m, n)."""
        return self._compare(self._measure(weights @ self._edits))

    def blend(self, smooth: Floats, rough: Floats) -> Floats:
        """Return weights between both, (m, n), as near to `rough` as edits may be rough.

        They are `smooth` if edits are too rough with any other.
        """
        for share in BLENDED_SHARES:
            weights = smooth + share * (rough - smooth)
            if self.measure_weights(weights).largest <= MAX_EDIT_ROUGHNESS:
                return weights
        return smooth

    def _measure(self, displaced: Floats) -> Floats:
        return np.asarray(np.linalg.norm(self._problem.surface.forward @ displaced, axis=0))

    def _compare(self, norms: Floats) -> EditRoughness:
        ratios = np.divide(norms, self._own, out=np.ones_like(norms), where=self._own > 0)
        smooth, local = np.split(ratios, len(EDIT_RADII))
        return EditRoughness(float(smooth.mean()), float(local.mean()))


class Trial:
    """A fit to the frames of a sample that are not held out, strength by strength.

    Attributes
    ----------
    seen, held_out : Displacements
        The frames that are fitted, in fewer columns as long as that serves, and the others.
    change : Correction
        What the fit has changed so far.
    """

    def __init__(self, sample: Sample, is_held: Mask, problem: WeightProblem) -> None:
        self._frames = sample.target.take(sample.target.frames[~is_held])
        self.seen = self._frames.compress(problem.vertex_weights)
        self.held_out = sample.target.take(sample.target.frames[is_held])
        self.change = Correction.none(*problem.rest_weights.shape)
        self._before = self.change

    def advance(self, alternator: Alternator, rounds: int) -> float:
        """Go on at the strength of `alternator`; return the error of the frames held out.

        It is the root mean square, in percent of the diagonal.
        """
        self._before = self.change
        self.change = take_rounds(alternator, rounds, self.seen, self.change)
        weights = alternator.problem.add_change(self.change)
        solve = alternator.cage_solve
        _, rms = solve.solve(weights, self.held_out, alternator.problem.jobs)
        return 100 * rms / solve.binding.rest.diagonal

    def lower_deviations(self, alternator: Alternator, norm: float) -> None:
        """Lower the largest deviations of the frames seen, which must not be compressed for it."""
        self.seen = self._frames
        problem, solve = alternator.problem, alternator.cage_solve
        self.change = lower_deviations(problem, solve, self.seen, self.change, norm, TRIAL_ROUNDS)

    def go_back(self) -> None:
        """Take the last step back."""
        self.change = self._before


def take_rounds(
    alternator: Alternator, rounds: int, target: Displacements, change: Correction | None
) -> Correction:
    """Return a change of the weights, fitted to `target`, after some rounds at a strength."""
    problem = replace(alternator.problem, max_steps=STEPS_PER_ROUND)
    short = replace(alternator, problem=problem, max_rounds=rounds)
    return short.fit_full_rank(target, change)


def choose_ladder(
    settings: FitSettings,
    distinct_frames: int,
    *,
    can_hold_out: bool = True,
    has_memory: bool = True,
) -> tuple[tuple[Rung, ...], StrengthLimit]:
    """Return the strengths to try; or the only one, and why.

    Parameters
    ----------
    can_hold_out : bool
        Whether frames can be held out.
    has_memory : bool
        Whether there is memory for two trials.
    """
    if settings.strength is not None:
        return (Rung(settings.strength),), StrengthLimit.GIVEN
    only, limit = (Rung(DEFAULT_STRENGTH),), StrengthLimit.LADDER
    if settings.influences is not None:  # a weaker pull makes them rougher, and hardly closer
        limit = StrengthLimit.INFLUENCES
    elif settings.use == "edit" and distinct_frames < MIN_DISTINCT_FRAMES:
        pull, smoothness = DEFAULT_STRENGTH
        missing = max(1.0, ENOUGH_FRAMES / max(1, distinct_frames))
        only, limit = (Rung(Strength(pull * missing**2, smoothness)),), StrengthLimit.FRAMES
    elif not can_hold_out:
        limit = StrengthLimit.NONE_ASIDE
    elif not has_memory:
        limit = StrengthLimit.MEMORY
    ladder: tuple[Rung, ...] = LADDER if limit is StrengthLimit.LADDER else only
    if settings.smoothness is not None:
        pulls = dict.fromkeys((one.strength.regularization, one.rounds) for one in ladder)
        ladder = tuple(Rung(Strength(pull, settings.smoothness), k) for pull, k in pulls)
    if settings.use == "play" and limit is StrengthLimit.LADDER:
        ladder = (*ladder, *PLAYED_TIMES * [ladder[-1]._replace(rounds=PLAYED_ROUNDS)])
    return ladder, limit


def climb(
    ladder: Sequence[Rung],
    advance: Callable[[Rung], tuple[float, float | None]],
    measure_edits: Callable[[], EditRoughness],
    use: Use,
) -> tuple[int, StrengthLimit, list[TriedStrength]]:
    """Try strengths in their order, until one is worse than that before it.

    Parameters
    ----------
    advance : callable
        Fits with a strength, and returns the errors of frames held out: of blocks, and of the last
        third if there is one.
    measure_edits : callable
        Measures the fitted weights, the rougher of both trials.

    Returns
    -------
    int
        How many strengths are worth their rounds, at least one.
    StrengthLimit
        What is against the next one.
    list of TriedStrength
        Those, and the one that was worse.
    """
    tried: list[TriedStrength] = []
    for rung in ladder:
        found = TriedStrength(*rung.strength, *advance(rung), measure_edits())
        limit = _find_limit(found, tried[-1], use) if tried else None
        tried.append(found)
        if limit is not None:
            return len(tried) - 1, limit, tried
    return len(tried), StrengthLimit.LADDER, tried


def _find_limit(found: TriedStrength, before: TriedStrength, use: Use) -> StrengthLimit | None:
    """Return what is against a strength, compared with the one before; None if nothing is."""
    pairs = [(found.held_out_blocks, before.held_out_blocks)]
    if found.last_third is not None and before.last_third is not None:
        pairs.append((found.last_third, before.last_third))
    if any(error > MAX_RISE * known for error, known in pairs):
        return StrengthLimit.KEPT_ASIDE
    if all(error > (1 - MIN_GAIN) * known for error, known in pairs):
        return StrengthLimit.GAIN
    if use == "edit" and found.edits.largest > MAX_EDIT_ROUGHNESS:
        return StrengthLimit.EDITS
    return None
