"""Build a cage around any model: a ladder of candidates, each judged by exact tests."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.building.decimate import euler_characteristic
from cageik_cli.cages.building.distance_grid import DistanceGrid, measure_grid
from cageik_cli.cages.building.hull import wrap_convex
from cageik_cli.cages.building.judge import Demand, Verdict, judge
from cageik_cli.cages.building.refine import refine_shell
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


Measure = Callable[[TriMesh], float]


def build_cage(
    model: TriMesh,
    settings: BuildSettings | None = None,
    measure: Measure | None = None,
    progress: Callable[[int, int], None] = no_progress,
) -> BuiltCage:
    """Build the best cage of a ladder of candidates.

    Parameters
    ----------
    model : TriMesh
        Any triangles: open, in pieces, crossing themselves, without area.
    settings : BuildSettings, optional
    measure : callable, optional
        The error of a cage on an animation. All rungs are then tried, and the least error wins;
        without it the tightest of the first few valid ones does.
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
    unit = normalize_model(model)
    demand = _demand(unit, settings)
    grids = _Grids(unit)
    tried: list[Candidate] = []
    for rung, recipe in enumerate(LADDER):
        candidate = _try_shell(unit, demand, recipe, grids)
        if candidate is not None:
            tried.append(_measured(candidate, measure))
        progress(rung + 1, len(LADDER) + 1)
        valid = [known for known in tried if known.verdict.is_valid]
        if measure is None and len(valid) >= ENOUGH:
            break
    if not any(known.verdict.is_valid for known in tried):
        tried.append(_measured(_try_hull(unit, demand), measure))
    progress(len(LADDER) + 1, len(LADDER) + 1)
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


class _Grids:
    """The distance grids of a model, measured when they are first needed."""

    def __init__(self, unit: UnitModel) -> None:
        self._unit = unit
        self._grids: dict[bool, DistanceGrid] = {}

    def grid_for(self, recipe: ShellRecipe) -> DistanceGrid:
        """The grid on which a shell is made."""
        coarse = recipe.offset >= COARSE_OFFSET
        if coarse not in self._grids:
            cell, reach = (COARSE_CELL, COARSE_REACH) if coarse else (FINE_CELL, FINE_REACH)
            self._grids[coarse] = measure_grid(self._unit.surface, cell, reach)
        return self._grids[coarse]


def _demand(unit: UnitModel, settings: BuildSettings) -> Demand:
    fewest = int(np.ceil(FEWEST_SHARE * settings.vertices))
    return Demand(unit.surface, unit.samples, settings.clearance, fewest, settings.vertices)


def _try_shell(
    unit: UnitModel, demand: Demand, recipe: ShellRecipe, grids: _Grids
) -> Candidate | None:
    """A candidate from a shell, None where the shell cannot be had."""
    shell = make_shell(grids.grid_for(recipe), recipe)
    if shell is None:
        return None
    cage = refine_shell(shell.surface, demand)
    name = f"shell {100 * recipe.offset:.2g} % closed by {100 * recipe.closing:.2g} %"
    return _judged(name, cage, unit, demand, _shell_notes(shell, unit))


def _try_hull(unit: UnitModel, demand: Demand) -> Candidate:
    """The convex candidate."""
    cage = wrap_convex(unit.samples, 1.1 * demand.clearance, demand.most)
    notes = (
        "no cage that follows the model passed the tests; this one is convex, and expresses less: "
        "more --vertices or a smaller --clearance may help",
    )
    return _judged("convex", cage, unit, demand, notes)


def _judged(
    recipe: str, cage: TriMesh, unit: UnitModel, demand: Demand, notes: tuple[str, ...]
) -> Candidate:
    """Judge a cage as it is after rounding to file units."""
    placed = TriMesh(unit.to_file_units(cage.vertices), cage.faces)
    back = TriMesh((placed.vertices - unit.centre) / unit.scale, cage.faces)
    verdict = judge(back, demand)
    return Candidate(recipe, placed, verdict, notes=notes)


def _measured(candidate: Candidate, measure: Measure | None) -> Candidate:
    if measure is None or not candidate.verdict.is_valid:
        return candidate
    return replace(candidate, error=measure(candidate.cage))


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
