"""A model and the cage that moves it, whatever holds them.

A fit of the model is transferred to other models in its cage, and notes say how well that works.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.fit.settings import FitRecord
from cageik_cli.fit.transferred import MAX_TRANSFER_DISTANCE, TransferredChange
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.find_files import Source
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.inputs.scene import UNSTATED, CommonScene
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.inputs.source import (
    LoadedModel,
    get_meshes,
    load_model,
    load_source,
    read_caged,
)
from cageik_cli.inputs.weights import (
    bind_cached,
    build_cached,
    load_matching_binding,
    suggest_repair,
)
from cageik_cli.method.weights.binding import Binding, reconstruct
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.figures import format_percent
from cageik_cli.store import result as result_file
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.store.result import (
    Result,
    StoredAnimation,
    has_weights,
    read_animation,
    read_key_frames,
    read_low_rank,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import SettingError, error_context, join_truncated
from cageik_cli.util.messages import Said, say
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import group_digits
from cageik_cli.util.threads import limit_blas_threads


@dataclass(frozen=True, slots=True, eq=False)
class CagedModel:
    """A model at rest and its cage: of a result, of a binding, or in files of their own.

    Attributes
    ----------
    path : Path
        The result, the binding file or the model.
    cage : LoadedMesh, optional
        None for a model in no cage yet.
    result : Result or Edit, optional
        With the cages of a clip.
    stored : StoredBinding, optional
        With the weights, of a binding file.
    source : CagedModel, optional
        The result or the binding that the cage is of, whose fit is transferred to this model.
    common : CommonScene, optional
        That of the model, into which a cage was brought that is given beside it.
    """

    path: Path
    model: LoadedModel
    cage: LoadedMesh | None
    result: StoredAnimation | None = None
    stored: StoredBinding | None = None
    source: "CagedModel | None" = None
    common: CommonScene | None = None

    @staticmethod
    def open(
        path: Path,
        cage: Path | None = None,
        binding: Path | None = None,
        given_in: SceneHints = UNSTATED,
        load: Callable[[Path], LoadedModel] = load_model,
    ) -> "CagedModel":
        """Open a result or a binding; or a model, with its cage or a binding of it, if given.

        A cage may be that of a result or a binding, whose fit is then transferred to the model. It
        is brought into the scene of the model; `given_in` is what it is in, if not what its file
        states.
        """
        held = read_caged(path)
        if held is not None:
            return CagedModel.of_file(path, held)
        caged = CagedModel(path, load(path), None)
        if cage is not None:
            # A part of a result other than its cage has no fit of its own.
            named = Source.parse(cage)
            held = read_caged(named.file) if named.member in (None, "cage") else None
            source = None if held is None else CagedModel.of_file(named.file, held)
            given = load_source(cage, "cage") if source is None else source.cage
            assert given is not None
            common = CommonScene(caged.model.mesh.scene, given_in)
            caged = replace(caged, cage=common.place(given), source=source, common=common)
        if binding is None:
            return caged
        stored = load_matching_binding(binding, caged.model.mesh, caged.cage)
        return replace(caged, stored=stored)

    @staticmethod
    def read(path: Path) -> "CagedModel":
        """Read a result, an edit or a binding; what is neither is refused as no result."""
        held = read_caged(path) if path.exists() else None
        return CagedModel.of_file(path, read_animation(path) if held is None else held)

    @staticmethod
    def of_file(path: Path, held: StoredAnimation | StoredBinding) -> "CagedModel":
        """Return the model of a result or a binding, whose meshes have no files of their own."""
        result, stored = (None, held) if isinstance(held, StoredBinding) else (held, None)
        rest, cage, scene = get_meshes(held)
        model = LoadedMesh(rest, {"name": f"the rest pose of {path.name}"}, scene=scene)
        loaded = LoadedMesh(cage, {"name": f"the cage of {path.name}"}, scene=scene)
        return CagedModel(path, LoadedModel(model), loaded, result, stored)

    @property
    def cage_name(self) -> str:
        """The name of the rest cage in messages."""
        return "the binding's cage" if self.result is None else "the result's cage"

    @property
    def scene(self) -> Scene:
        """The time and space of its clip; the usual ones if there is none."""
        return Scene() if self.result is None else self.result.scene

    @property
    def hints(self) -> SceneHints:
        """Unit and up axis, if they are known: of a result."""
        return UNSTATED if self.result is None else self.result.scene.space

    def require_result(self, need: Said) -> StoredAnimation:
        """Return the result.

        Raises
        ------
        SettingError
            Stating the need, when it is a binding.
        """
        if self.result is None:
            raise SettingError(f"{self.path}: is a binding, " + need)
        return self.result

    def read_bind_settings(self) -> BindSettings:
        """Return how the model was bound to the cage."""
        if self.result is None:
            assert self.stored is not None
            return self.stored.binding.settings
        with error_context(self.path):
            names = ("coordinates", "accuracy", "outside")
            return BindSettings(**{name: str(self.result.settings.get(name)) for name in names})

    def find_binding(self) -> Binding | None:
        """Read the weights; None if a result was written without, or there is a cage only."""
        if self.stored is not None:
            return self.stored.binding
        return None if self.result is None else result_file.read_binding(self.result)

    def read_binding(self, user: str) -> Binding:
        """Read the weights of a result or a binding.

        Raises
        ------
        SettingError
            When a result was written without; `user` is what needs them.
        """
        binding = self.find_binding()
        if binding is None:
            raise result_file.make_weights_error(self.path, user)
        return binding

    @property
    def fit(self) -> FitRecord | None:
        """How the weights were fitted; None if they were not."""
        if self.stored is not None:
            return self.stored.fit
        return None if self.result is None else self.result.fit

    def read_reconstruction(self, user: str) -> Reconstruction:
        """Read the mesh animation that the cages of a result give; raises as `read_binding`."""
        result, binding = self.require_result("which has no cages"), self.read_binding(user)
        return Reconstruction(binding, CageFrames.from_result(result, binding))

    def build_cage(
        self, settings: BuildSettings, cache: Path | None, progress: ProgressListener
    ) -> "CagedModel":
        """Return the model in a cage that is built around it, or taken from the cache."""
        with progress.stage("cage"), error_context(self.path):
            cage = build_cached(self.model.mesh.mesh, settings, cache, progress)
        return replace(self, cage=cage)

    def bind(self, weights: WeightSettings, progress: ProgressListener) -> StoredBinding:
        """Return the weights of the binding; or bind model and cage, and note what changed."""
        if self.stored is not None:
            return self.stored
        rest, cage = self.model.mesh, self.cage
        assert cage is not None
        with progress.stage("bind"), suggest_repair(cage, rest, self.common):
            stored = bind_cached(rest, cage, weights, progress)
        note_all(progress, rest.notes, self.model.name)
        note_all(progress, stored.binding.notes, cage.source["name"])
        if self.source is None or self.common is None:
            return stored
        conversion = self.common.find_conversion(cage.scene)
        return transfer_fit(self.source, stored, weights, progress, conversion)


def report_skipped_frames(result: StoredAnimation, progress: ProgressListener) -> None:
    """Note which frames were skipped, and what is written instead."""
    if result.gaps:
        names = join_truncated(result.frames[k] for k in result.gaps)
        progress.note(
            "note",
            f"{group_digits(len(result.gaps))} of {group_digits(len(result.frames))} frames "
            f"skipped ({names}); their "
            "cages are interpolated, or the nearest at either end of the clip",
        )


def transfer_fit(
    source: "CagedModel",
    stored: StoredBinding,
    weights: WeightSettings,
    progress: ProgressListener,
    conversion: SceneConversion,
) -> StoredBinding:
    """Return the weights of another model in the cage of a source, with what a fit has changed.

    Parameters
    ----------
    source : CagedModel
        A result or a binding. If its weights are not fitted, nothing changes.
    stored : StoredBinding
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
        return stored
    found = _find_weights(source, weights, progress)
    if found is None:
        progress.note(
            "note",
            f"{source.path.name}: its weights are fitted and not in it, so the fit is not "
            "transferred to this mesh, which follows the cages less closely; "
            + say("extract it again with them (`keep_weights=True`)"),
        )
        return stored
    # One thread: the last digits depend on how many.
    with progress.stage("carry"), limit_blas_threads(1):
        fitted, computed = found
        change = TransferredChange(_convert_meshes(fitted, conversion), computed)
        rest = stored.binding.rest
        places = change.locate(rest.vertices)
        transferred = change.add_to(stored.binding, places)
        distances = places.distances[rest.is_used]
        progress.note("note", _describe_distances(source.path.name, distances))
        progress.note("note", _describe_errors(source, change, fitted, computed))
    return replace(stored, binding=transferred, transferred=change)


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
        fitted = replace(computed, weights=change.add_to(computed.weights))
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
        f"the fitted change of the weights is transferred from the model of {name}, which is "
        f"{median} % of its diagonal away (median; {largest} at most)"
    )
    count = int((distances >= MAX_TRANSFER_DISTANCE).sum())
    if count:
        text += (
            f"; {group_digits(count)} of {group_digits(len(distances))} vertices are "
            f"{MAX_TRANSFER_DISTANCE:.0%} away or more, and have computed weights"
        )
    return text


def _describe_errors(
    source: "CagedModel", change: TransferredChange, fitted: Binding, computed: Floats
) -> str:
    """Say what error transferred weights have at the vertices of the fitted model itself."""
    result = source.result
    # An edit keeps how far it moved frames, and a result without weights keeps nothing.
    if not isinstance(result, Result) or not has_weights(result):
        assert source.fit is not None
        found = source.fit.report.fitted
        return (
            "at its own vertices, transferred weights are the fitted ones; on the frames of the "
            f"fit, their error is {format_percent(found.fitted.rms)} % of the diagonal, that of "
            f"computed weights {format_percent(found.unfitted.rms)}"
        )
    left_out, own, before = _measure_transferred(result, change, fitted, computed)
    return (
        "at its own vertices, each left out when the change is transferred to it, the error is "
        f"{format_percent(left_out)} % of the diagonal in the frames that the result keeps; of the "
        f"fitted weights {format_percent(own)}, of computed ones {format_percent(before)}"
    )


def _measure_transferred(
    result: Result, change: TransferredChange, fitted: Binding, computed: Floats
) -> tuple[float, float, float]:
    """Measure the errors of the vertices of a fitted model in the frames that its result keeps.

    Returns
    -------
    float
        With the change that is transferred to each vertex from around it. Root mean square, in
        percent of the diagonal, like all.
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
