"""The ladder of candidates for one model, and how each is made."""

from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.building.carry import Poses, align_poses, choose_poses
from cageik_cli.cages.building.decimate import euler_characteristic
from cageik_cli.cages.building.distance_grid import DistanceGrid, measure_grid
from cageik_cli.cages.building.judge import Demand, judge
from cageik_cli.cages.building.motion import Motion
from cageik_cli.cages.building.records import BuildSettings, Candidate, Clip
from cageik_cli.cages.building.refine import refine_shell, replace_weak_vertices, wrap_ellipsoid
from cageik_cli.cages.building.shell import Shell, ShellRecipe, make_shell
from cageik_cli.cages.building.shift import shift_vertices
from cageik_cli.cages.building.unit import UnitModel, normalize_model
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import join_truncated

FEWEST_SHARE = 0.9
"""A cage has at least this share of the vertices asked for."""

POSED_RUNGS = 3
"""Rungs of the ladder that are tried for an animation; the others only if all of them fail."""

FINE_CELL, COARSE_CELL = 0.007, 0.014
"""Cells of the grids, in diagonals."""

COARSE_OFFSET = 0.016
"""Shells with this offset or more are made on the coarse grid: it is twice a cell's half."""

FINE_REACH, COARSE_REACH = 0.04, 0.13
"""Distances are exact up to here: offset and closing of every shell, and some cells."""

LADDER = (
    ShellRecipe(0.006, 0.010),
    ShellRecipe(0.008, 0.014),
    ShellRecipe(0.010, 0.020),
    ShellRecipe(0.012, 0.015),
    ShellRecipe(0.016, 0.020),
    ShellRecipe(0.016, 0.035),
    ShellRecipe(0.025, 0.050),
    ShellRecipe(0.040, 0.080),
)
"""The shells, tight to loose."""


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """The data that all candidates of a model share.

    Attributes
    ----------
    ladder : tuple
        The shells to try, and the poses that decide which of their vertices are kept.
    reserve : tuple
        The same, to try one after another while no cage passes.
    motion : Motion, optional
        That of the clip.
    grids : dict
        Grids by their cells, filled as they are needed.
    """

    unit: UnitModel
    demand: Demand
    ladder: tuple[tuple[ShellRecipe, Poses], ...]
    reserve: tuple[tuple[ShellRecipe, Poses], ...]
    clip: Clip | None
    motion: Motion | None
    grids: dict[float, DistanceGrid]

    @staticmethod
    def start(model: TriMesh, settings: BuildSettings, clip: Clip | None) -> "Job":
        """Prepare a model."""
        unit = normalize_model(model)
        fewest = int(np.ceil(FEWEST_SHARE * settings.vertices))
        still, motion = Poses.none(), None
        ladder = tuple((recipe, still) for recipe in LADDER)
        reserve = ladder[:0]
        if clip is not None:
            used = model.used_vertices
            rest = unit.to_units(model.vertices[used])
            frames = unit.to_units(clip.frames[:, used])
            aligned = align_poses(rest, frames)
            poses, motion = choose_poses(rest, aligned), Motion.reduce(rest, aligned)
            reserve = ladder[POSED_RUNGS:]
            ladder = tuple((recipe, p) for recipe in LADDER[:POSED_RUNGS] for p in (poses, still))
        demand = Demand(unit.surface, unit.samples, settings.clearance, fewest, settings.vertices)
        return Job(unit, demand, ladder, reserve, clip, motion, {})

    def try_shell(self, recipe: ShellRecipe, poses: Poses) -> Candidate | None:
        """Return a candidate from a shell; None if the grid carries no such shell."""
        shell = make_shell(self._grid_for(recipe), recipe)
        if shell is None:
            return None
        cage = refine_shell(shell.surface, self.demand, poses)
        name = f"shell {100 * recipe.offset:.2g} % closed by {100 * recipe.closing:.2g} %"
        if len(poses.posed):
            name += f", {len(poses.posed)} poses"
        notes = _shell_notes(shell, self.unit)
        candidate = self._make_candidate(name, cage, notes, recipe.offset)
        if not candidate.verdict.is_valid:
            return candidate
        stronger = replace_weak_vertices(cage, self.demand)
        if stronger is cage:
            return candidate
        replaced = self._make_candidate(name, stronger, notes, recipe.offset)
        return replaced if replaced.verdict.is_valid else candidate

    def try_ellipsoids(self) -> list[Candidate]:
        """Return loose candidates: an ellipsoid drawn in, and where that fails, as it is."""
        notes = (
            "no cage that follows the model passed the tests; this is an ellipsoid drawn in, which "
            "expresses less: more vertices or another clearance may help",
        )
        tried: list[Candidate] = []
        for name, draws in (("ellipsoid drawn in", 12), ("ellipsoid", 0)):
            cage = wrap_ellipsoid(self.demand, draws)
            tried.append(self._make_candidate(name, cage, notes, np.inf))
            if tried[-1].verdict.is_valid:
                break
        return tried

    def try_shift(self, candidate: Candidate) -> Candidate:
        """Return a candidate with some vertices of another moved to where it misses the clip."""
        assert self.motion is not None
        cage = TriMesh(self.unit.to_units(candidate.cage.vertices), candidate.cage.faces)
        cage, moved = shift_vertices(cage, self.demand, self.motion)
        recipe = f"{candidate.recipe}, {moved} vertices shifted"
        return self._make_candidate(recipe, cage, candidate.notes, candidate.offset)

    def measure(self, candidate: Candidate) -> Candidate:
        """Return the candidate with its error, if it is valid and there is a clip."""
        if self.clip is None or not candidate.verdict.is_valid:
            return candidate
        return replace(candidate, error=self.clip.measure(candidate.cage))

    def _make_candidate(
        self, recipe: str, cage: TriMesh, notes: tuple[str, ...], offset: float
    ) -> Candidate:
        """Judge a cage as it is after rounding to file units."""
        placed = TriMesh(self.unit.to_file_units(cage.vertices), cage.faces)
        back = TriMesh(self.unit.to_units(placed.vertices), cage.faces)
        return Candidate(recipe, placed, judge(back, self.demand), offset, notes=notes)

    def _grid_for(self, recipe: ShellRecipe) -> DistanceGrid:
        """Return the grid on which a shell is made, measured when it is first needed."""
        fine = recipe.offset < COARSE_OFFSET
        cell, reach = (FINE_CELL, FINE_REACH) if fine else (COARSE_CELL, COARSE_REACH)
        if cell not in self.grids:
            self.grids[cell] = measure_grid(self.unit.surface, cell, reach)
        return self.grids[cell]


def _shell_notes(shell: Shell, unit: UnitModel) -> tuple[str, ...]:
    """Return notes on what the shell closed, and where."""
    notes = []
    handles = 1 - euler_characteristic(shell.surface) // 2
    for count, what, places in (
        (len(shell.bridges), "parts of the model that lie apart were joined", shell.bridges),
        (len(shell.hollows), "hollows with a narrow opening were filled", shell.hollows),
        (handles, "handles are left where parts touch: they move together", shell.webs),
    ):
        if count:
            notes.append(f"{what} ({count}), at {_format_places(unit.to_file_units(places))}")
    return tuple(notes)


def _format_places(points: Floats) -> str:
    """Return some places, such as (1, 2, 3)."""
    return join_truncated((f"({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in points), limit=3)
