"""Bind a model to its cage: check that it fits, compute the weights, judge them."""

from collections.abc import Callable

from cageik_cli.cages.enclosure import Enclosure, check_enclosure
from cageik_cli.coordinates.binding import Binding, BindSettings, _reproduction_error
from cageik_cli.coordinates.weights import ACCURACIES, Weights, ignore_progress
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import NumericalError

MIN_HARMONIC_WEIGHT = -0.05
"""Harmonic weights below it are poor: those of sound cages stay above −0.02."""

MAX_ESTIMATED_ERROR = 0.5
"""Rows of harmonic weights that are off by more are no weights."""

MAX_REPRODUCTION_ERROR = 1e-6
"""Weights that miss the rest pose by more, in diagonals, are not weights of this cage."""


def bind(
    rest: TriMesh,
    cage: TriMesh,
    settings: BindSettings | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int], None] = ignore_progress,
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
    enclosure = check_enclosure(cage, rest, settings.outside)
    weights = _compute_weights(enclosure, settings, jobs, progress)
    binding = Binding(
        rest=rest,
        cage=enclosure.cage,
        weights=weights.values,
        settings=settings,
        panels=weights.panels,
        estimated_error=weights.error,
        projected=len(enclosure.projected_indices),
        notes=enclosure.notes + _weight_warnings(weights, settings),
    )
    if not weights.error <= MAX_ESTIMATED_ERROR:
        raise NumericalError(
            f"the weights' estimated error is {weights.error:.2g}, more than "
            f"{MAX_ESTIMATED_ERROR:g}; the "
            "cage has needle-like faces or sheets that nearly touch: cageik check names them"
        )
    reproduction_error = _reproduction_error(enclosure.points, binding)
    if not reproduction_error <= MAX_REPRODUCTION_ERROR:
        raise NumericalError(
            f"the weights miss the rest pose by {reproduction_error:.1e} of the diagonal, "
            f"more than {MAX_REPRODUCTION_ERROR:.0e}; the cage may cross itself or have "
            f"needle-like faces"
        )
    return binding


def _compute_weights(
    enclosure: Enclosure,
    settings: BindSettings,
    jobs: int | None,
    progress: Callable[[int, int], None],
) -> Weights:
    cage, points = enclosure.cage, enclosure.points
    # Imported here: weights that are kept need neither, and they take a sixth of a second.
    if settings.coordinates == "mean-value":
        from cageik_cli.coordinates.mean_value import mean_value_weights

        return mean_value_weights(cage, points, jobs, progress)
    from cageik_cli.coordinates.harmonic import harmonic_weights

    return harmonic_weights(cage, points, settings.accuracy, jobs, progress)


def _weight_warnings(weights: Weights, settings: BindSettings) -> tuple[str, ...]:
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
    if lowest < MIN_HARMONIC_WEIGHT:
        notes.append(
            f"the smallest weight is {lowest:.2g}, below {MIN_HARMONIC_WEIGHT:g}, where exact "
            f"harmonic "
            "weights are not negative: the cage may be very thin for its faces; divide faces "
            "there, or raise --accuracy"
        )
    return tuple(notes)
