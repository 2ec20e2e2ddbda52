"""Build a cage around any model: a ladder of candidates, each judged by exact tests."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.building.carry import Poses, choose_poses
from cageik_cli.cages.building.decimate import euler_characteristic
from cageik_cli.cages.building.distance_grid import DistanceGrid, measure_grid
from cageik_cli.cages.building.egg import DRAWS, wrap_ellipsoid
from cageik_cli.cages.building.judge import Demand, Verdict, judge
from cageik_cli.cages.building.refine import COMPLETIONS, complete_clearance, refine_shell
from cageik_cli.cages.building.shell import Shell, ShellRecipe, make_shell
from cageik_cli.cages.building.unit import UnitModel, normalize_model
from cageik_cli.coordinates.weights import no_progress
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, NumericalError, first_few

MIN_VERTICES = 8
"""Fewer vertices make no cage worth the name."""

FEWEST_SHARE = 0.9
"""A cage has at least this share of the vertices asked for."""

MAX_CLEARANCE = 0.2
"""The largest clearance, in diagonals."""

GOOD_ANGLE = 10.0
"""Degrees below which a cage ranks behind."""

HANDLE_COST = 0.1
"""How much a handle costs, over the looseness."""

POSED_RUNGS = 6
"""Rungs of the ladder that are tried for an animation."""

ENOUGH = 2
"""Valid candidates after which the ladder ends when none is measured."""

FINE_CELL, COARSE_CELL = 0.007, 0.014
"""Cells of the grids, in diagonals."""

COARSE_OFFSET = 0.016
"""Shells with this offset or more are made on the coarse grid: it is twice a cell's half."""

FINE_REACH, COARSE_REACH = 0.04, 0.13
"""Distances are exact up to here: offset and closing of every shell, and some cells."""

LADDER = (
    ShellRecipe(0.006, 0.010),
    ShellRecipe(0.010, 0.020),
    ShellRecipe(0.008, 0.014),
    ShellRecipe(0.012, 0.015),
    ShellRecipe(0.016, 0.020),
    ShellRecipe(0.016, 0.035),
    ShellRecipe(0.025, 0.050),
    ShellRecipe(0.040, 0.080),
)
"""The shells, tight to loose."""


@dataclass(frozen=True, slots=True)
class BuildSettings:
    """What is asked of a cage.

    Attributes
    ----------
    vertices : int
        At most; the cage has at least nine tenths of them.
    clearance : float
        How far it keeps off the model, in diagonals of the model.
    """

    vertices: int = 100
    clearance: float = 0.004

    def __post_init__(self) -> None:
        if self.vertices < MIN_VERTICES:
            raise InputError(
                f"a cage of {self.vertices} vertices was asked for, expected {MIN_VERTICES} or more"
            )
        if not 0 < self.clearance <= MAX_CLEARANCE:
            raise InputError(
                f"the clearance is {self.clearance:g} diagonals, expected more than 0 and at most "
                f"{MAX_CLEARANCE:g}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A cage that was tried.

    Attributes
    ----------
    recipe : str
        How it was made.
    cage : TriMesh
        In file units; fit to be handed out only if the verdict says so.
    verdict : Verdict
        Lengths in diagonals of the model.
    error : float or None
        What `measure` gave, None where nothing was measured.
    notes : tuple of str
        What had to be done to the model's surface, a sentence each.
    """

    recipe: str
    cage: TriMesh
    verdict: Verdict
    error: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class BuiltCage:
    """A cage around a model, and how it was come by.

    Attributes
    ----------
    cage : TriMesh
        Closed, manifold, outward, of one component, around the whole surface; file units.
    chosen : Candidate
        The one it is.
    candidates : tuple of Candidate
        All that were tried, in order.
    notes : tuple of str
        What the user should know, a sentence each, places in file units.
    """

    cage: TriMesh
    chosen: Candidate
    candidates: tuple[Candidate, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """What a cage is built for.

    Attributes
    ----------
    frames : (k, m, 3) float64
        Poses of the model's vertices, file units; rigid motions between them do not matter.
    measure : callable
        The error of a cage on the animation, the less the better.
    """

    frames: Floats
    measure: Callable[[TriMesh], float]


def build_cage(
    model: TriMesh,
    settings: BuildSettings | None = None,
    clip: Clip | None = None,
    progress: Callable[[int, int], None] = no_progress,
) -> BuiltCage:
    """Build the best cage of a ladder of candidates.

    Parameters
    ----------
    model : TriMesh
        Any triangles: open, in pieces, crossing themselves, without area.
    settings : BuildSettings, optional
    clip : Clip, optional
        An animation of the model that the cage is for: all rungs are then tried, without and with
        its poses, and the least error wins. Without it the tightest of the first few valid ones
        does.
    progress : callable
        Told (candidates done, candidates) after every one.

    Raises
    ------
    InputError
        When the model is one point.
    NumericalError
        When no cage passes, which no model is known to bring about.
    """
    settings = settings or BuildSettings()
    job = _Job.start(model, settings, clip)
    tried: list[Candidate] = []
    for step, (recipe, poses) in enumerate(job.ladder):
        candidate = job.try_shell(recipe, poses)
        if candidate is not None:
            tried.append(job.measured(candidate))
        progress(step + 1, len(job.ladder) + 1)
        if clip is None and sum(known.verdict.is_valid for known in tried) >= ENOUGH:
            break
    if not any(known.verdict.is_valid for known in tried):
        tried += [job.measured(loose) for loose in job.try_ellipsoids()]
    progress(len(job.ladder) + 1, len(job.ladder) + 1)
    return choose_best(tried)


def choose_best(tried: list[Candidate]) -> BuiltCage:
    """Take the valid candidate of the least error, or else the tightest.

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
    """What is least for the best candidate."""
    if candidate.error is not None:
        return candidate.error
    verdict = candidate.verdict
    poor = max(0.0, GOOD_ANGLE - verdict.smallest_angle) / GOOD_ANGLE
    return verdict.looseness * (1 + poor + HANDLE_COST * verdict.genus)


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    """What all candidates of a model share."""

    unit: UnitModel
    demand: Demand
    ladder: tuple[tuple[ShellRecipe, Poses], ...]
    clip: Clip | None
    grids: dict[float, DistanceGrid]

    @staticmethod
    def start(model: TriMesh, settings: BuildSettings, clip: Clip | None) -> "_Job":
        """Prepare a model."""
        unit = normalize_model(model)
        fewest = int(np.ceil(FEWEST_SHARE * settings.vertices))
        still = Poses.none()
        ladder = tuple((recipe, still) for recipe in LADDER)
        if clip is not None:
            rest, frames = (unit.to_units(points) for points in (model.vertices, clip.frames))
            poses = choose_poses(rest, frames)
            ladder = tuple((recipe, p) for recipe in LADDER[:POSED_RUNGS] for p in (poses, still))
        demand = Demand(
            unit.surface, unit.samples, settings.clearance, fewest, settings.vertices
        )
        return _Job(unit, demand, ladder, clip, {})

    def try_shell(self, recipe: ShellRecipe, poses: Poses) -> Candidate | None:
        """A candidate from a shell, None where the shell cannot be had."""
        shell = make_shell(self._grid_for(recipe), recipe)
        if shell is None:
            return None
        cage = refine_shell(shell.surface, self.demand, poses)
        name = f"shell {100 * recipe.offset:.2g} % closed by {100 * recipe.closing:.2g} %"
        if len(poses.posed):
            name += f", {len(poses.posed)} poses"
        return self._judged(name, cage, _shell_notes(shell, self.unit))

    def try_ellipsoids(self) -> list[Candidate]:
        """Loose candidates: an ellipsoid drawn in, and where that fails, as it is."""
        notes = (
            "no cage that follows the model passed the tests; this is an ellipsoid drawn in, which "
            "expresses less: more vertices or a smaller clearance may help",
        )
        tried: list[Candidate] = []
        for name, draws in (("ellipsoid drawn in", DRAWS), ("ellipsoid", 0)):
            cage = wrap_ellipsoid(self.demand, draws)
            cage, _ = complete_clearance(cage, self.demand, self.demand.samples, COMPLETIONS)
            tried.append(self._judged(name, cage, notes))
            if tried[-1].verdict.is_valid:
                break
        return tried

    def measured(self, candidate: Candidate) -> Candidate:
        """The candidate with its error, if it is valid and there is a clip."""
        if self.clip is None or not candidate.verdict.is_valid:
            return candidate
        return replace(candidate, error=float(self.clip.measure(candidate.cage)))

    def _judged(self, recipe: str, cage: TriMesh, notes: tuple[str, ...]) -> Candidate:
        """Judge a cage as it is after rounding to file units."""
        placed = TriMesh(self.unit.to_file_units(cage.vertices), cage.faces)
        back = TriMesh(self.unit.to_units(placed.vertices), cage.faces)
        return Candidate(recipe, placed, judge(back, self.demand), notes=notes)

    def _grid_for(self, recipe: ShellRecipe) -> DistanceGrid:
        """The grid on which a shell is made, measured when it is first needed."""
        fine = recipe.offset < COARSE_OFFSET
        cell, reach = (FINE_CELL, FINE_REACH) if fine else (COARSE_CELL, COARSE_REACH)
        if cell not in self.grids:
            self.grids[cell] = measure_grid(self.unit.surface, cell, reach)
        return self.grids[cell]


def _shell_notes(shell: Shell, unit: UnitModel) -> tuple[str, ...]:
    """What the shell had to close, where."""
    notes = []
    handles = 1 - euler_characteristic(shell.surface) // 2
    for count, what, places in (
        (len(shell.bridges), "parts of the model that lie apart were joined", shell.bridges),
        (len(shell.hollows), "hollows with a narrow opening were filled", shell.hollows),
        (handles, "handles are left where parts touch: they move together", shell.webs),
    ):
        if count:
            notes.append(f"{what} ({count}), at {_places(unit.to_file_units(places))}")
    return tuple(notes)


def _places(points: Floats) -> str:
    """Some places, such as (1, 2, 3)."""
    return first_few((f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in points), limit=3)
