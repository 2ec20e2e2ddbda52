"""Binding of a model to its cage: check the cage, compute the weights, check the weights."""

from collections.abc import Callable
from dataclasses import dataclass

from cageik_cli.cages.check.enclosure import check_enclosure
from cageik_cli.cages.check.quality import find_looseness_faults, find_thin_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding, Weights, reproduction_error
from cageik_cli.method.weights.settings import ACCURACIES, COORDINATES, BindSettings
from cageik_cli.util.errors import NumericalError
from cageik_cli.util.messages import Hint, Note, Said, say
from cageik_cli.util.progress import ignore_progress

MAX_SURFACE_ERROR = 0.016
"""A larger error just inside the cage, as a mean over its area, gives a warning.

On sound cages it is 0.0005 to 0.0136 at the standard accuracy, and less at a finer one.
"""

MAX_ESTIMATED_ERROR = 0.5
"""Weights with a larger estimated error are refused."""

MAX_REPRODUCTION_ERROR = 1e-6
"""Weights that reproduce the rest pose worse than this, in diagonals, are refused."""


def bind(
    rest: TriMesh,
    cage: TriMesh,
    settings: BindSettings | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
) -> Binding:
    """Compute the weights of a rest model in a cage, harmonic by default.

    Parameters
    ----------
    rest : TriMesh
        m vertices.
    cage : TriMesh
        n vertices.
    jobs : int, optional
        Threads; the number of processors by default. They do not change the result.
    progress : callable
        Called with (points done, points) after every block; see `harmonic_weights`.

    Raises
    ------
    CageError
        When the cage is not sound or does not enclose the model.
    NumericalError
        When the weights are too inaccurate.
    """
    settings = settings or BindSettings()
    placement = check_enclosure(cage, rest, settings.outside)
    kind = COORDINATES[settings.coordinates]
    compute = kind.load(kind.function, settings.accuracy)
    weights: Weights = compute(placement.cage, placement.points, jobs=jobs, progress=progress)
    warnings = _list_weight_warnings(weights, settings)
    warnings += tuple(found.sentence for found in find_thin_parts(placement.cage))
    binding = Binding(
        rest=rest,
        cage=placement.cage,
        weights=weights.values,
        settings=settings,
        panels=weights.panels,
        estimated_error=weights.error,
        projected=len(placement.outside_indices),
        notes=placement.notes + tuple(Note(warning, "warning") for warning in warnings),
    )
    if not weights.error <= MAX_ESTIMATED_ERROR:
        raise NumericalError(
            f"estimated weight error {weights.error:.2g} exceeds {MAX_ESTIMATED_ERROR:g}; the cage "
            "has needle-like faces or sheets that nearly touch: cageik check lists them"
        )
    reproduced_to = reproduction_error(placement.points, binding)
    if not reproduced_to <= MAX_REPRODUCTION_ERROR:
        raise NumericalError(
            f"the weights reproduce the rest pose only to {reproduced_to:.1e} of the diagonal, "
            f"expected {MAX_REPRODUCTION_ERROR:.0e}; the cage may cross itself or have needle-like "
            "faces: cageik check lists them"
        )
    return binding


@dataclass(frozen=True, slots=True, eq=False)
class JudgedBinding:
    """A binding, and how the room in its cage is judged.

    Attributes
    ----------
    cage_warnings : tuple of Note
        What is poor about the cage if it is this model's own: not for other meshes in it.
    has_loose_cage : bool, optional
        Whether the cage has far too much room for this model; None if it has points only.
    """

    binding: Binding
    cage_warnings: tuple[Note, ...]
    has_loose_cage: bool | None


def judge_binding(binding: Binding) -> JudgedBinding:
    """Judge the room in the cage of a binding.

    `cageik check` looks more thoroughly; this takes a hundredth of the time of the weights.
    """
    if not len(binding.rest.faces):
        return JudgedBinding(binding, (), None)
    found = find_looseness_faults(binding.cage, binding.rest, False)
    faults = tuple(Note(finding.sentence, "warning") for finding in found)
    return JudgedBinding(binding, () if binding.projected else faults, bool(faults))


def _list_weight_warnings(weights: Weights, settings: BindSettings) -> tuple[Said, ...]:
    """Return warnings about computed weights, one sentence each."""
    notes: list[Said] = []
    tolerance = ACCURACIES[settings.accuracy].tolerance
    if not weights.error <= tolerance:
        notes.append(
            f"estimated weight error {weights.error:.2g} exceeds the tolerance {tolerance:g} "
            "of "
            + Hint("accuracy", settings.accuracy)
            + "; use a coarser cage or leave more clearance"
        )
    if not weights.surface_error <= MAX_SURFACE_ERROR:
        notes.append(
            f"weight error {weights.surface_error:.2g} just inside the cage exceeds "
            f"{MAX_SURFACE_ERROR:g}: where no vertex is near, the cage is thin compared with "
            "its faces, and the estimated error may be several times too small; "
            + say("divide faces there, or raise `accuracy=`")
        )
    lowest, usual = float(weights.values.min(initial=0.0)), COORDINATES[settings.coordinates]
    if usual.lowest_weight is not None and lowest < usual.lowest_weight:
        notes.append(
            f"smallest weight {lowest:.2g} is below {usual.lowest_weight:g} (exact "
            f"{settings.coordinates} weights are never negative); the cage may be thin compared "
            "with its faces: " + say("divide faces there, or raise `accuracy=`")
        )
    return tuple(notes)
