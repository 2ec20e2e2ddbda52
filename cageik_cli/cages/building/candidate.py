"""A cage that was tried: what it was made of, and what speaks against it."""

from collections.abc import Callable
from dataclasses import dataclass

from cageik_cli.cages.building.judge import Verdict
from cageik_cli.cages.building.loops import NO_LOOPS, Loops
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats

MIN_FLAWLESS_ANGLE = 10.0
"""A smallest angle below this, degrees, makes a candidate rank lower."""


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
