"""Bind a model to its cage: check that it fits, compute the weights, judge them."""

from collections.abc import Callable

from cageik_cli.cages.enclosure import Enclosure, check_enclosure
from cageik_cli.coordinates.binding import Binding, BindSettings, _missed
from cageik_cli.coordinates.weights import ACCURACIES, Weights, no_progress
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import NumericalError

LOWEST_WEIGHT = -0.05
"""Harmonic weights below it are poor: those of sound cages stay above −0.02."""

WORST_ERROR = 0.5
"""Rows of harmonic weights that are off by more are no weights."""

WORST_PRECISION = 1e-6
"""Weights that miss the rest pose by more, in diagonals, are not weights of this cage."""


def bind(
    rest: TriMesh,
    cage: TriMesh,
    settings: BindSettings | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int], None] = no_progress,
) -> Binding:
    """Write the rest model in coordinates of the cage, harmonic by default.

    Raises
    ------
    InputError
        When the cage is not fit to hold the model.
    NumericalError
        When the weights do not reproduce the rest model.
    """
    settings = settings or BindSettings()
    held = check_enclosure(cage, rest, settings.outside)
    weights = _weights(held, settings, jobs, progress)
    binding = Binding(
        rest=rest,
        cage=held.cage,
        weights=weights.values,
        settings=settings,
        panels=weights.panels,
        estimated_error=weights.error,
        projected=len(held.projected),
        notes=held.notes + _poor(weights, settings),
    )
    if not weights.error <= WORST_ERROR:
        raise NumericalError(
            f"the weights' estimated error is {weights.error:.2g}, more than {WORST_ERROR:g}; the "
            "cage has needle-like faces or sheets that nearly touch: cageik check names them"
        )
    missed = _missed(held.points, binding)
    if not missed <= WORST_PRECISION:
        raise NumericalError(
            f"the weights miss the rest pose by {missed:.1e} of the diagonal, "
            f"more than {WORST_PRECISION:.0e}; the cage may cross itself or have needle-like faces"
        )
    return binding


def _weights(
    held: Enclosure, settings: BindSettings, jobs: int | None, progress: Callable[[int, int], None]
) -> Weights:
    cage, points = held.cage, held.points
    # Imported here: weights that are kept need neither, and they take a sixth of a second.
    if settings.coordinates == "mean-value":
        from cageik_cli.coordinates.mean_value import mean_value_weights

        return mean_value_weights(cage, points, jobs, progress)
    from cageik_cli.coordinates.harmonic import harmonic_weights

    return harmonic_weights(cage, points, settings.accuracy, jobs, progress)


def _poor(weights: Weights, settings: BindSettings) -> tuple[str, ...]:
    """What is poor about harmonic weights, a sentence each."""
    if settings.coordinates != "harmonic":
        return ()
    notes = []
    tolerance = ACCURACIES[settings.accuracy].tolerance
    if not weights.error <= tolerance:
        notes.append(
            f"the estimated error of the weights, {weights.error:.2g}, misses the tolerance "
            f"{tolerance:g} of --accuracy {settings.accuracy}; a coarser cage, or one further "
            "from the model, is easier"
        )
    lowest = float(weights.values.min(initial=0.0))
    if lowest < LOWEST_WEIGHT:
        notes.append(
            f"the smallest weight is {lowest:.2g}, below {LOWEST_WEIGHT:g}, where exact harmonic "
            "weights are not negative: the cage may be very thin for its faces; divide faces "
            "there, or raise --accuracy"
        )
    return tuple(notes)
