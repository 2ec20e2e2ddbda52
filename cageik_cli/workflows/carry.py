"""The fit of a model carried to other models in its cage, and how well that works."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.coordinates.binding import Binding, reconstruct
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.fit.carried import MAX_CARRY_DISTANCE, CarriedChange
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.figures import format_percent
from cageik_cli.store.result import Result, has_weights, read_key_frames, read_low_rank
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import error_context
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.bind import WeightSettings, bind_cached

if TYPE_CHECKING:
    from cageik_cli.workflows.caged_model import CagedModel


def carry_fit(
    source: "CagedModel",
    binding: Binding,
    weights: WeightSettings,
    progress: ProgressListener,
    conversion: SceneConversion,
) -> Binding:
    """Return the weights of another model in the cage of a source, with what a fit has changed.

    Parameters
    ----------
    source : CagedModel
        A result or a binding. If its weights are not fitted, nothing changes.
    binding : Binding
        The computed weights, which are changed in place.
    weights : WeightSettings
        How they were computed.
    conversion : SceneConversion
        From the unit and the up axis of the source to those of the other model.

    Raises
    ------
    InputError, NumericalError
        When the weights of the source are damaged, or cannot be computed again.
    """
    if source.fit is None:
        return binding
    found = _find_weights(source, weights, progress)
    if found is None:
        progress.note(
            "note",
            f"{source.path.name}: its weights are fitted and not in it, so the fit is not carried "
            "to this mesh, which follows the cages less closely; extract it again with them "
            "(`keep_weights=True`)",
        )
        return binding
    # One thread: the last digits depend on how many.
    with progress.stage("carry"), limit_blas_threads(1):
        fitted, computed = found
        change = CarriedChange(_convert_meshes(fitted, conversion), computed)
        places = change.locate(binding.rest.vertices)
        carried = change.add_to(binding, places)
        distances = places.distances[binding.rest.is_used]
        progress.note("note", _describe_distances(source.path.name, distances))
        progress.note("note", _describe_errors(source, change, fitted, computed))
    return carried


def _find_weights(
    source: "CagedModel", weights: WeightSettings, progress: ProgressListener
) -> tuple[Binding, Floats] | None:
    """Return the fitted weights of a source, and the weights of its model as others are computed.

    None if the fitted ones are neither in it nor can be computed.
    """
    held, asked = source.read_bind_settings(), weights.bind
    fitted, change = source.find_binding(), None
    if fitted is None:
        change = read_low_rank(source.require_result("which holds its weights"))
        if change is None:
            return None
        computed = _compute_weights(source, replace(weights, bind=held), progress)
        fitted = replace(computed, weights=change.add_to(computed.weights), fit=source.fit)
        if asked.coordinates == held.coordinates and asked.accuracy == held.accuracy:
            return fitted, computed.weights
    bind = BindSettings(asked.coordinates, asked.accuracy, held.outside)
    return fitted, _compute_weights(source, replace(weights, bind=bind), progress).weights


def _compute_weights(
    source: "CagedModel", weights: WeightSettings, progress: ProgressListener
) -> Binding:
    """Bind the model of a source again, without the fit; from the cache if they are there."""
    assert source.cage is not None
    with progress.stage("bind"), error_context(source.path):
        return bind_cached(source.model.mesh, source.cage, weights, progress).binding


def _convert_meshes(binding: Binding, conversion: SceneConversion) -> Binding:
    """Return weights, which have no unit, with their meshes in the scene of another model."""
    rest, cage = map(conversion.convert_mesh, (binding.rest, binding.cage))
    return replace(binding, rest=rest, cage=cage)


def _describe_distances(name: str, distances: Floats) -> str:
    """Say how far the vertices of another model are from the fitted one, in its diagonals."""
    median, largest = (format_percent(100 * float(f(distances))) for f in (np.median, np.max))
    text = (
        f"the fitted change of the weights is carried from the model of {name}, which is {median} "
        f"% of its diagonal away (median; {largest} at most)"
    )
    count = int((distances >= MAX_CARRY_DISTANCE).sum())
    if count:
        text += (
            f"; {count} of {len(distances)} vertices are {MAX_CARRY_DISTANCE:.0%} away or more, "
        )
        text += "and have computed weights"
    return text


def _describe_errors(
    source: "CagedModel", change: CarriedChange, fitted: Binding, computed: Floats
) -> str:
    """Say what error carried weights have at the vertices of the fitted model itself."""
    result = source.result
    # An edited result keeps how far it was edited, and one without weights keeps nothing.
    if result is None or result.edited_from is not None or not has_weights(result):
        assert fitted.fit is not None
        found = fitted.fit.report.fitted
        return (
            "at its own vertices, carried weights are the fitted ones; on the frames of the fit, "
            f"their error is {format_percent(found.fitted.rms)} % of the diagonal, that of "
            f"computed weights {format_percent(found.unfitted.rms)}"
        )
    left_out, own, before = measure_carried(result, change, fitted, computed)
    return (
        "at its own vertices, each left out when the change is carried to it, the error is "
        f"{format_percent(left_out)} % of the diagonal in the frames that the result keeps; of the "
        f"fitted weights {format_percent(own)}, of computed ones {format_percent(before)}"
    )


def measure_carried(
    result: Result, change: CarriedChange, fitted: Binding, computed: Floats
) -> tuple[float, float, float]:
    """Measure the errors of the vertices of a fitted model in the frames that its result keeps.

    Returns
    -------
    float
        With the change that is carried to each vertex from around it. Root mean square, in percent
        of the diagonal, like all.
    float
        With the fitted weights.
    float
        With the computed weights, (m, n), in the same cages.
    """
    key, rest = read_key_frames(result, fitted), fitted.rest
    moved = key.reconstructed - reconstruct(computed, key.cages)
    count, m, _ = moved.shape
    columns = moved.transpose(1, 0, 2).reshape(m, -1)
    left_out = change.predict_left_out(columns).reshape(m, count, 3).transpose(1, 0, 2)
    misses = rest.diagonal * key.errors
    misses, moved, left_out = (one[:, rest.is_used] for one in (misses, moved, left_out))
    return (
        _measure_percent(misses + moved - left_out, rest),
        _measure_percent(misses, rest),
        _measure_percent(misses + moved, rest),
    )


def _measure_percent(misses: Floats, rest: TriMesh) -> float:
    """Return the root mean square of misses (k, m, 3), some of them nan, in percent."""
    return float(100 * np.sqrt(np.nanmean(np.square(misses).sum(axis=2))) / rest.diagonal)
