"""The weights of a run: computed, from the cache, or from a binding file."""

from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.formats.base.choose_parts import check_part_order
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_vertex_order
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.inputs.rest_pose import load_vertex_weights
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.source import load_rest, load_source
from cageik_cli.inputs.weights import bind_cached, suggest_repair
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.fit import fit_to_clips
from cageik_cli.run.settings import BindRunSettings
from cageik_cli.store.binding_file import StoredBinding, write_binding
from cageik_cli.util.errors import error_context
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
        rest = load_rest(settings.rest, settings.exclude)
        scene = CommonScene(rest.scene, settings.given_in, is_shared=bool(settings.clips))
        cage = scene.place(load_source(settings.cage, "cage"))
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
    clips, taken = [], ClipSettings(exclude=settings.exclude, fps=settings.fps)
    for name in settings.clips:
        clip = open_sequence([name], taken, rest)
        with error_context(name):
            check_part_order(clip.first, rest.mesh, "the rest pose")
            check_vertex_order(clip.first, rest.mesh.fan_triangulated, "the rest pose")
            clip = scene.match_clip(
                clip, name, rest.mesh, beside="those of the rest pose", other="the rest pose"
            )
        note_all(progress, clip.notes)
        clips.append(clip)
    return fit_to_clips(
        binding,
        clips,
        settings.fit,
        progress,
        solve=settings.solve,
        vertex_weights=load_vertex_weights(settings.vertex_weights, rest).vertices,
        memory=settings.memory,
        jobs=settings.weights.jobs,
        cache=settings.weights.cache,
    )
