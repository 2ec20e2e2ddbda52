"""The weights of a run: computed, from the cache, or from a binding file."""

from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.inputs.clip import load_vertex_weights, open_clip_of
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.weights import bind_cached, suggest_repair
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.fit import choose_norm, fit_to_clips
from cageik_cli.run.settings import BindRunSettings
from cageik_cli.store.binding_file import StoredBinding, write_binding
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener, note_all


def bind_files(
    settings: BindRunSettings, progress: ProgressListener | None = None
) -> StoredBinding:
    """Bind a rest pose to a cage and write the binding file."""
    progress = progress or ProgressListener()
    check_writable(settings.output, settings.overwrite)
    check_hdf5_suffix(settings.output)
    with progress.stage("open"):
        scene = CommonScene(given_in=settings.given_in, is_shared=bool(settings.clips))
        rest = scene.open_rest(settings.rest, settings.exclude)
        cage = scene.open_cage(settings.cage)
        note_all(progress, rest.notes, rest.source["name"])
    with progress.stage("bind"), suggest_repair(cage, rest, scene):
        stored = bind_cached(rest, cage, settings.weights, progress)
    if settings.clips:
        with progress.stage("fit"):
            fitted = _fit_to_files(stored.binding, rest, scene, settings, progress)
            stored = stored.with_fit(fitted)
    with progress.stage("write"):
        write_binding(settings.output, stored, settings.overwrite)
    return stored


def _fit_to_files(
    binding: Binding,
    rest: LoadedMesh,
    scene: CommonScene,
    settings: BindRunSettings,
    progress: ProgressListener,
) -> FittedWeights:
    """Fit the weights to the clips of the settings."""
    taken = ClipSettings(exclude=settings.exclude, fps=settings.fps)
    clips = [
        open_clip_of(rest, [name], taken, scene, progress, called="the rest pose")[0]
        for name in settings.clips
    ]
    fitted, notes = fit_to_clips(
        binding,
        clips,
        settings.fit,
        progress,
        solve=choose_norm(settings.solve, settings.fit, clips),
        vertex_weights=load_vertex_weights(settings.vertex_weights, rest).vertices,
        memory=settings.memory,
        jobs=settings.weights.jobs,
        cache=settings.weights.cache,
    )
    note_all(progress, notes)
    return fitted
