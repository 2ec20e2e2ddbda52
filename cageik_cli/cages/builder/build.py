"""Build a cage around any model: candidates from tight to loose, each judged by exact tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from cageik_cli.cages.builder.collapse import Motion
from cageik_cli.cages.builder.frame import find_symmetry, pair_exactly
from cageik_cli.cages.builder.judge import Demand, Verdict, judge
from cageik_cli.cages.builder.loops import NO_LOOPS, Loops
from cageik_cli.cages.builder.quads import describe_few_quads, make_quads
from cageik_cli.cages.builder.refine import refine_shell, replace_weak_vertices, wrap_ellipsoid
from cageik_cli.cages.builder.shell import DistanceGrid, describe_closings, joins_parts, make_shell
from cageik_cli.cages.builder.shift import shift_vertices
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import NumericalError
from cageik_cli.util.processes import call_in_subprocesses
from cageik_cli.util.progress import ignore_progress
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.threads import limit_blas_threads

SHELL_CANDIDATES = (
    (0.006, 0.010),
    (0.008, 0.014),
    (0.010, 0.020),
    (0.012, 0.015),
    (0.016, 0.020),
    (0.016, 0.035),
    (0.025, 0.050),
    (0.040, 0.080),
)
"""Offset and closing of the shells that are tried, in diagonals, tight to loose."""

FINE_GRID, COARSE_GRID = (0.007, 0.04), (0.014, 0.13)
"""Cells of the grids, and how far their distances are exact, in diagonals: as far as the offset and
the closing of the shells that are made on them, and some cells."""

MIN_LOOSER_REACH, MAX_EXTRA_HOLES = 1.4, 2
"""After a shell that tangled, or gave no sound cage and has more holes beside the model's own, the
next one is tried if the sum of its offset and its closing is so many times as large: what is nearly
as tight fails, too. Soups of triangles and cracked boxes fail so, four or five shells in a row."""

MAX_SHIFTED = 2
"""The best candidates whose vertices are shifted to where they miss an animation."""

MAX_LOOPED_SHELLS = 4
"""Shells that are tried with loops, at most, before shells are tried without."""

NO_LIMBS = "the cage has no loops: no limbs were found that loops fit around"

NO_LOOPED_CAGE = "no cage with loops passed the tests: this one has none"

NO_QUADS = "no cage with quads passed the tests: this one is of triangles"

MIN_GOOD_ANGLE = 5.0
"""Smaller angles of a cage that is built, degrees, are noted."""

MIN_FLAWLESS_ANGLE = 10.0
"""A smallest angle below this, degrees, makes a candidate rank lower."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A cage that was tried.

    Attributes
    ----------
    recipe : str
        The shell it was made from, and the changes since.
    cage : TriMesh
        File units; usable only if the verdict is valid.
    verdict : Verdict
        Lengths in diagonals of the model.
    offset : float
        Of the shell it was made from, diagonals of the model; infinite without a shell.
    error : float, optional
        On the animation; None where nothing was measured.
    notes : tuple of str
        Changes to the surface of the model, a sentence each.
    loops : Loops
        Around its limbs.
    joined_holes : int
        Holes through it between parts that lie near each other, beside the model's own.
    """

    recipe: str
    cage: TriMesh
    verdict: Verdict
    offset: float
    error: float | None = None
    notes: tuple[str, ...] = ()
    loops: Loops = NO_LOOPS
    joined_holes: int = 0

    @property
    def cost(self) -> float:
        """What speaks against it: the best candidate has the lowest.

        It is the error, or else the offset; a hole between parts costs as much as a tenth of that.
        """
        if self.error is not None:
            return self.error
        return self.offset * (1 + self._flaws)

    @property
    def is_flawless(self) -> bool:
        """Return whether it is valid, with good angles and no holes but the model's own."""
        return self.verdict.is_valid and self._flaws == 0

    @property
    def _flaws(self) -> float:
        poor = max(0.0, MIN_FLAWLESS_ANGLE - self.verdict.smallest_angle) / MIN_FLAWLESS_ANGLE
        return poor + 0.1 * self.joined_holes


@dataclass(frozen=True, slots=True, eq=False)
class BuiltCage:
    """A cage that was built around a model.

    Attributes
    ----------
    cage : TriMesh
        Closed, manifold, outward, of one component, around the whole surface; file units.
    chosen : Candidate
        The candidate that was taken.
    candidates : tuple of Candidate
        All candidates, in the order in which they were tried.
    notes : tuple of str
        Warnings, a sentence each, with places in file units.
    mirror : Mirror, optional
        The plane across which it is its own mirror image.

    Examples
    --------
    >>> from cageik_cli import build_cage, load_mesh
    >>> build_cage(load_mesh("data_fixtures/walker/frames/walker_1.obj"), vertices=40)
    <BuiltCage: 40 vertices, 76 triangles, best of 1 candidate, 0 notes>
    """

    cage: TriMesh
    chosen: Candidate
    candidates: tuple[Candidate, ...]
    notes: tuple[str, ...]
    mirror: Mirror | None = None

    @property
    def reason(self) -> str:
        """Return why the candidate was taken."""
        if self.chosen.error is not None:
            return "the smallest error on the animation"
        if np.isinf(self.chosen.offset):
            return "no shell gave a valid cage"
        if self.chosen.is_flawless:
            return "the tightest shell whose cage has good angles and no holes between parts"
        return "the tightest shell, with small angles and holes between parts counted against it"

    def __repr__(self) -> str:
        tried = format_count(len(self.candidates), "candidate")
        return (
            f"<BuiltCage: {len(self.cage.vertices)} vertices, {len(self.cage.faces)} triangles, "
            f"best of {tried}, {format_count(len(self.notes), 'note')}>"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """The animation that a cage is built for.

    Attributes
    ----------
    frames : (k, m, 3) float64
        Poses of the model's vertices, file units; rigid motions between them do not matter.
    measure : callable
        Of a cage in file units: its error on the animation, the less the better, in any unit.
    """

    frames: Floats
    measure: Callable[[TriMesh], float]


def build_cage(
    model: TriMesh,
    settings: BuildSettings | None = None,
    clip: Clip | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
    processes: int = 1,
    note: Callable[[str], object] = str,
) -> BuiltCage:
    """Build the best cage of a ladder of candidates.

    Parameters
    ----------
    model : TriMesh
        Any triangles: open, in pieces, crossing themselves, without area.
    clip : Clip, optional
        An animation of the model that the cage is for. Shells are then tried with its poses, from
        tight to loose, until two cages are valid; their vertices are shifted to where the error is;
        the smallest error wins.
        Without a clip, the first flawless candidate is taken, or the better of the first two.
    progress : callable
        Called with (candidates done, candidates) after every one.
    processes : int
        How many shift vertices side by side, with a clip; the cage is the same for any number.
    note : callable
        Takes a sentence on one of them that has failed, whose work is done again.

    Raises
    ------
    FormatError
        When the model is one point.
    NumericalError
        When no candidate passes; no such model is known.
    """
    settings = settings or BuildSettings()
    # Sums of several threads are rounded otherwise, and a choice may hang on that.
    with limit_blas_threads(1):
        mirror, lost = find_symmetry(model, settings.symmetric)
        if mirror is not None:
            try:
                return _Builder(model, settings, clip, mirror).run(progress)
            except NumericalError:
                lost = f"no cage that is symmetric about {mirror} passed the tests: this one is not"
        free = _Builder(model, settings, clip, processes=processes, note=note)
        built = free.run(progress)
        return built if lost is None else replace(built, notes=(lost, *built.notes))


class _Builder:
    """The candidates for one model, and what they share."""

    def __init__(
        self,
        model: TriMesh,
        settings: BuildSettings,
        clip: Clip | None,
        mirror: Mirror | None = None,
        processes: int = 1,
        note: Callable[[str], object] = str,
    ) -> None:
        self._demand, self._clip, self._mirror = Demand(model, settings, mirror), clip, mirror
        self._settings, self._processes, self._note = settings, processes, note
        self._has_loops = settings.loops
        self._motion: Motion | None = None
        if clip is not None and mirror is None:  # poses would make a cage lopsided
            used = model.used_vertices
            rest = self._demand.frame.to_units(model.vertices[used])
            self._motion = Motion(rest, self._demand.frame.to_units(clip.frames[:, used]))
        self._grids: dict[float, DistanceGrid] = {}  # by their cells, measured as they are needed
        self._tried: list[Candidate] = []

    @property
    def _valid(self) -> list[Candidate]:
        """The candidates that may be handed out."""
        return [candidate for candidate in self._tried if candidate.verdict.is_valid]

    @property
    def _ranked(self) -> list[Candidate]:
        """The valid candidates, the best first; if loops are wanted, those with loops."""

        def rank(candidate: Candidate) -> tuple[bool, float]:
            return self._settings.loops and not candidate.loops.count, candidate.cost

        return sorted(self._valid, key=rank)

    def run(self, progress: Callable[[int, int], None]) -> BuiltCage:
        """Try the shells, ellipsoids if no shell passes, and shifts for a clip; take the best."""
        rungs, shifts = len(SHELL_CANDIDATES), 0 if self._motion is None else MAX_SHIFTED

        def report(done: int) -> None:
            progress(done, rungs + shifts)

        first = 0
        if self._has_loops:
            self._try_shells(range(min(MAX_LOOPED_SHELLS, rungs)), report)
            # Where no limb was found, the shells need not be tried again.
            first = 0 if any(c.loops.count for c in self._tried) else MAX_LOOPED_SHELLS
            self._has_loops = False
        if not self._valid:
            self._try_shells(range(first, rungs), report)
        if not self._valid and self._mirror is None:
            self._try_ellipsoids()
        best = self._ranked[:shifts]
        for step in self._try_shifts(best):
            report(rungs + step)
        if self._settings.quads and self._valid:
            self._make_quads()
        report(rungs + shifts)
        return self._choose_best()

    def _try_shells(self, rungs: range, progress: Callable[[int], None]) -> None:
        """Try rungs of the ladder until no other can be better, or two cages are valid."""
        least = 0.0
        for step in rungs:
            offset, closing = SHELL_CANDIDATES[step]
            is_tightest = self._clip is None and any(c.cost <= offset for c in self._valid)
            if is_tightest or len(self._valid) == 2:
                break
            is_tried = offset + closing >= least
            is_too_tight = is_tried and self._try_shell(offset, closing)
            least = MIN_LOOSER_REACH * (offset + closing) if is_too_tight else 0.0
            progress(step + 1)

    def _try_shell(self, offset: float, closing: float) -> bool:
        """Try a cage made of a shell, if the grid carries it; a motion keeps vertices it needs.

        Returned is whether shells that are nearly as tight need not be tried.
        """
        # A shell on the coarse grid is further away than a cell, so that the grid resolves it.
        cell, reach = COARSE_GRID if offset > COARSE_GRID[0] else FINE_GRID
        if cell not in self._grids:
            self._grids[cell] = DistanceGrid(self._demand.surface, cell, reach)
        shell = make_shell(self._grids[cell], offset, closing)
        if shell is None:
            return False
        cage, loops = refine_shell(
            shell.surface, self._demand, self._motion, has_loops=self._has_loops
        )
        name = f"shell {100 * offset:.2g} % closed by {100 * closing:.2g} %"
        if self._motion is not None and len(self._motion.poses):
            name += f", {len(self._motion.poses)} poses"
        if loops.count:
            name += f", {loops.count} loops around {format_count(len(loops.tubes), 'limb')}"
        notes = describe_closings(
            shell,
            self._demand.frame.to_file_units,
            self._demand.holes,
            is_closed=self._demand.is_closed,
        )
        candidate = self._make_candidate(name, cage, offset, notes)
        if candidate.verdict.is_valid:
            stronger = replace_weak_vertices(cage, self._demand, loops)
            if stronger is not cage:
                replaced = self._make_candidate(name, stronger, offset, notes)
                candidate = replaced if replaced.verdict.is_valid else candidate
        holes = max(0, candidate.verdict.genus - self._demand.holes)
        joined = joins_parts(shell, self._demand.is_closed) * holes
        self._add(candidate, loops=loops, joined_holes=joined)
        tangled = len(cage.vertices) > self._demand.most
        return tangled or (not candidate.verdict.is_valid and holes > MAX_EXTRA_HOLES)

    def _try_ellipsoids(self) -> None:
        """Try loose cages: an ellipsoid drawn in, and where that fails, as it is."""
        note = (
            "no cage that follows the model passed the tests; this is an ellipsoid drawn in, which "
            "expresses less: more vertices or another clearance may help"
        )
        for name, draws in (("ellipsoid drawn in", 12), ("ellipsoid", 0)):
            cage = wrap_ellipsoid(self._demand, draws)
            self._add(self._make_candidate(name, cage, np.inf, (note,)))
            if self._valid:
                break

    def _try_shifts(self, candidates: list[Candidate]) -> Iterator[int]:
        """Try candidates with vertices moved to where they miss the clip; yield how many so far."""
        frame = self._demand.frame
        placed = [c.cage.move(frame.to_units(c.cage.vertices)) for c in candidates]
        calls = [
            (cage, self._demand, self._motion, candidate.loops)
            for cage, candidate in zip(placed, candidates, strict=True)
        ]
        shifted = call_in_subprocesses(shift_vertices, calls, self._processes, self._note)
        for step, (candidate, (cage, moved)) in enumerate(zip(candidates, shifted, strict=True)):
            recipe = f"{candidate.recipe}, {group_digits(moved)} vertices shifted"
            made = self._make_candidate(recipe, cage, candidate.offset, candidate.notes)
            self._add(made, loops=candidate.loops)
            yield step + 1

    def _make_quads(self) -> None:
        """Leave the best candidate alone, with quads in the place of its triangles."""
        best = self._ranked[0]
        vertices = self._demand.frame.to_units(best.cage.vertices)
        if self._demand.axis is not None:
            vertices = pair_exactly(vertices, self._demand.axis)
        cage = make_quads(TriMesh(vertices, best.cage.faces), self._demand, best.loops)
        notes = (*best.notes, *describe_few_quads(cage))
        made = self._make_candidate(f"{best.recipe}, quads", cage, best.offset, notes)
        if made.verdict.is_valid:
            self._tried = [c for c in self._tried if not c.verdict.is_valid]
        else:
            kept = replace(best, notes=(*best.notes, NO_QUADS))
            self._tried = [kept if c is best else c for c in self._tried]
        self._add(made, loops=best.loops, joined_holes=best.joined_holes)

    def _make_candidate(
        self, recipe: str, cage: TriMesh, offset: float, notes: tuple[str, ...]
    ) -> Candidate:
        """Judge a cage as it is after rounding to file units."""
        placed = cage.move(self._demand.frame.to_file_units(cage.vertices))
        back = TriMesh(self._demand.frame.to_units(placed.vertices), cage.faces)
        return Candidate(recipe, placed, judge(back, self._demand), offset, notes=notes)

    def _add(self, candidate: Candidate, loops: Loops = NO_LOOPS, joined_holes: int = 0) -> None:
        """Add a candidate with its loops, and its error if it is valid and there is a clip."""
        error = None
        if self._clip is not None and candidate.verdict.is_valid:
            error = self._clip.measure(candidate.cage)
        self._tried.append(replace(candidate, loops=loops, joined_holes=joined_holes, error=error))

    def _choose_best(self) -> BuiltCage:
        """Take the valid candidate of the least error, or else from the tightest shell."""
        if not self._valid:
            faults = self._tried[-1].verdict.faults
            raise NumericalError(
                f"no cage passes the tests, the last one {faults[0]}; please report it"
            )
        best = self._ranked[0]
        notes, angle = best.notes, best.verdict.smallest_angle
        if self._settings.loops and not best.loops.count:
            has_limbs = any(candidate.loops.count for candidate in self._tried)
            notes = (*notes, NO_LOOPED_CAGE if has_limbs else NO_LIMBS)
        if angle < MIN_GOOD_ANGLE:
            notes = (
                *notes,
                f"the smallest angle is {angle:.2g} degrees, expected {MIN_GOOD_ANGLE:g} or more; "
                "weights nearby are less accurate",
            )
        return BuiltCage(best.cage, best, tuple(self._tried), notes, self._mirror)
