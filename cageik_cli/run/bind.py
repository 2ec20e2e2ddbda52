"""The weights of a run: computed, from the cache, or from a binding file."""

from dataclasses import dataclass, field
from pathlib import Path

from cageik_cli.fit.fitted import FittedWeights
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.base.choose_parts import check_part_order
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_vertex_order
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.inputs.built_cage import suggest_repair
from cageik_cli.inputs.mesh_source import load_rest, load_source
from cageik_cli.inputs.rest_pose import load_vertex_weights
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.weights import WeightSettings, bind_cached
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.run.fit import fit_to_clips
from cageik_cli.run.settings import READ, READ_CLIP, WRITTEN, CommandSettings
from cageik_cli.store.binding_file import StoredBinding, write_binding
from cageik_cli.util.arrays import DEFAULT_MEMORY
from cageik_cli.util.errors import error_context
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener, label_note


@dataclass(frozen=True, slots=True)
class BindRunSettings(CommandSettings):
    """What to bind to what, and where to write it.

    Attributes
    ----------
    given_in : SceneHints
        Unit and up axis of the cage and the clips, see `CommonScene`.
    clips : tuple of str
        Clips that the weights are fitted to, each a folder, a glob or a file; none by default.
    vertex_weights : Path or "area", optional
        For the fit: a file with one number per vertex of the model, or by their area.
    exclude : tuple of str
        Patterns of parts of the rest pose and of the clips that are left out.
    fps : float, optional
        Frames per second at which clips of files without a rate are sampled.
    """

    cage: Path = field(metadata=READ)
    rest: Path = field(metadata=READ)
    output: Path = field(metadata=WRITTEN)
    weights: WeightSettings = field(default_factory=WeightSettings)
    overwrite: bool = False
    given_in: SceneHints = field(default_factory=SceneHints)
    clips: tuple[str, ...] = field(default=(), metadata=READ_CLIP)
    fit: FitSettings = field(default_factory=FitSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    vertex_weights: Path | str | None = field(default=None, metadata=READ)
    exclude: tuple[str, ...] = ()
    fps: float | None = None
    memory: int = DEFAULT_MEMORY


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
        cage, offer = scene.place_cage(load_source(settings.cage, "cage"))
        for note in rest.notes:
            progress.note("note", f"{rest.source['name']}: {note}")
    with progress.stage("bind"), suggest_repair(cage, rest, offer):
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
        for note in clip.notes:
            progress.note(*label_note(note))
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
