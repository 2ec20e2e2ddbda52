"""The input of the builder, its candidates and its result."""

from collections.abc import Callable
from dataclasses import dataclass

from cageik_cli.cages.building.judge import Verdict
from cageik_cli.cages.settings import BuildSettings as BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.arrays import Floats
from cageik_cli.util.text import format_count


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
    """

    recipe: str
    cage: TriMesh
    verdict: Verdict
    offset: float
    error: float | None = None
    notes: tuple[str, ...] = ()


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

    def __repr__(self) -> str:
        tried = format_count(len(self.candidates), "candidate")
        return (
            f"<BuiltCage: {len(self.cage.vertices)} vertices, {len(self.cage.faces)} triangles, "
            f"best of {tried}, {format_count(len(self.notes), 'note')}>"
        )
