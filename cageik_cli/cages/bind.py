"""Binding of a model to its cage: check the cage, compute the weights, check the weights."""

from collections.abc import Callable
from dataclasses import dataclass

from cageik_cli.cages.check.enclosure import Placement, check_enclosure
from cageik_cli.cages.check.quality import find_looseness_faults, find_thin_parts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding, Weights, reproduction_error
from cageik_cli.method.weights.settings import ACCURACIES, BindSettings
from cageik_cli.util.errors import NumericalError
from cageik_cli.util.progress import ignore_progress, mark_warning

MIN_HARMONIC_WEIGHT = -0.05
"""Harmonic weights below it give a warning; those of sound cages stay above −0.02."""

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
        Called with (points done, points) after every block.

    Raises
    ------
    CageError
        When the cage is not sound or does not enclose the model.
    NumericalError
        When the weights are too inaccurate.
    """
    settings = settings or BindSettings()
    placement = check_enclosure(cage, rest, settings.outside)
    weights = _compute_weights(placement, settings, jobs, progress)
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
        notes=placement.notes + tuple(map(mark_warning, warnings)),
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


def _compute_weights(
    placement: Placement,
    settings: BindSettings,
    jobs: int | None,
    progress: Callable[[int, int], None],
) -> Weights:
    cage, points = placement.cage, placement.points
    # Imported here because they are slow to import, and cached weights need neither.
    if settings.coordinates == "mean-value":
        from cageik_cli.method.weights.mean_value import mean_value_weights

        return mean_value_weights(cage, points, jobs, progress)
    from cageik_cli.method.weights.harmonic import harmonic_weights

    return harmonic_weights(cage, points, settings.accuracy, jobs, progress)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedBinding:
    """A binding, and how the room in its cage is judged.

    The warnings say what is poor about the cage if it is this model's own: not for other meshes in
    it. Whether the cage has far too much room is None of a model that has points only.
    """

    binding: Binding
    cage_warnings: tuple[str, ...]
    has_loose_cage: bool | None


def judge_binding(binding: Binding) -> JudgedBinding:
    """Judge the room in the cage of a binding.

    `cageik check` looks more thoroughly; this takes a hundredth of the time of the weights.
    """
    if not len(binding.rest.faces):
        return JudgedBinding(binding, (), None)
    found = find_looseness_faults(binding.cage, binding.rest, False)
    faults = tuple(finding.sentence for finding in found)
    return JudgedBinding(binding, () if binding.projected else faults, bool(faults))


def _list_weight_warnings(weights: Weights, settings: BindSettings) -> tuple[str, ...]:
    """Return warnings about harmonic weights, one sentence each."""
    if settings.coordinates != "harmonic":
        return ()
    notes = []
    tolerance = ACCURACIES[settings.accuracy].tolerance
    if not weights.error <= tolerance:
        notes.append(
            f"estimated weight error {weights.error:.2g} exceeds the tolerance {tolerance:g} of "
            f"`accuracy={settings.accuracy}`; use a coarser cage or leave more clearance"
        )
    if not weights.surface_error <= MAX_SURFACE_ERROR:
        notes.append(
            f"weight error {weights.surface_error:.2g} just inside the cage exceeds "
            f"{MAX_SURFACE_ERROR:g}: where no vertex is near, the cage is thin compared with its "
            "faces, and the estimated error may be several times too small; divide faces there, "
            "or raise `accuracy=`"
        )
    lowest = float(weights.values.min(initial=0.0))
    if lowest < MIN_HARMONIC_WEIGHT:
        notes.append(
            f"smallest weight {lowest:.2g} is below {MIN_HARMONIC_WEIGHT:g} (exact harmonic "
            "weights are never negative); the cage may be thin compared with its faces: divide "
            "faces there, or raise `accuracy=`"
        )
    return tuple(notes)
