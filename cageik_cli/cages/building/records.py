"""What is asked of the builder, what was tried, and what came of it."""

from collections.abc import Callable
from dataclasses import dataclass

from cageik_cli.cages.building.judge import Verdict
from cageik_cli.cages.settings import BuildSettings as BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """What a cage is built for.

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
        How it was made.
    cage : TriMesh
        In file units; fit to be handed out only if the verdict says so.
    verdict : Verdict
        Lengths in diagonals of the model.
    offset : float
        Of the shell it was made from, diagonals of the model; infinite without a shell.
    error : float, optional
        On the animation; None where nothing was measured.
    notes : tuple of str
        What had to be done to the model's surface, a sentence each.
    """

    recipe: str
    cage: TriMesh
    verdict: Verdict
    offset: float
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
