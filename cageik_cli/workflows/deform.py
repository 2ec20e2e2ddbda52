"""The cage animation of a result, applied to its rest model or to another mesh in the cage."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from cageik_cli.cages.enclosure import OutsideError
from cageik_cli.coordinates.binding import FRAMES_PER_PRODUCT, Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.connectivity import check_vertex_order
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.base.settings import ClipSettings
from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.mesh_file import load_mesh
from cageik_cli.formats.open import list_input_files, open_sequence
from cageik_cli.formats.scene import SceneHints
from cageik_cli.formats.write import ExportSummary, Output, write_animation
from cageik_cli.solver.fitting.sample import SampleSettings
from cageik_cli.store.result import Result, has_weights, read_result
from cageik_cli.store.result_frames import read_binding, read_fit, read_rotations
from cageik_cli.util.arrays import DEFAULT_MEMORY, Floats, fit_frames
from cageik_cli.util.errors import SettingError, error_context, join_truncated
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import label_note
from cageik_cli.util.threads import limit_blas_threads
from cageik_cli.workflows.bind import WeightSettings, bind_cached
from cageik_cli.workflows.export import report_skipped_frames
from cageik_cli.workflows.reconstruction import Block, CageFrames, Reconstruction
from cageik_cli.workflows.rig import RigRequest, check_influences, make_rig

MAX_BLOCK_FRAMES = 16
"""Frames per block at most; more is not faster."""

ARRAYS_PER_FRAME = 4
"""Arrays (m, 3) per frame at once: in its group, in its block, in the writer."""


@dataclass(frozen=True, slots=True)
class DeformSettings:
    """Which mesh to deform by which cages, and where to write it.

    Attributes
    ----------
    result : Path
    output : Output
    mesh : Path, optional
        Bound to the rest cage; the rest model if absent.
    coordinates, accuracy, outside : str, optional
        As in `BindSettings`; those of the result if absent.
    cages : str, optional
        A clip of cages to use instead of those of the result.
    clip : ClipSettings
        How that clip is read.
    scene : SceneHints
        Time and space, where they differ from those of the clip or the result.
    cache : Path, optional
        The folder of the weight cache; none is used if absent.
    memory : int
        Bytes for the weights and blocks of frames.
    jobs : int
        Threads.
    influences : int, optional
        Cage vertices that move each vertex, at most, with weights that are fitted again to the
        motion of the mesh; the weights that it has if absent.
    compares : bool
        Note the error of other numbers of influences, too.
    """

    result: Path
    output: Output
    mesh: Path | None = None
    coordinates: str | None = None
    accuracy: str | None = None
    outside: str | None = None
    cages: str | None = None
    clip: ClipSettings = field(default_factory=ClipSettings)
    scene: SceneHints = field(default_factory=SceneHints)
    cache: Path | None = None
    memory: int = DEFAULT_MEMORY
    jobs: int = 1
    influences: int | None = None
    compares: bool = False

    def inputs(self) -> list[Path]:
        """Return the files that are read."""
        mesh = [] if self.mesh is None else [self.mesh]
        cages = [] if self.cages is None else list_input_files([self.cages])
        return [self.result, *mesh, *cages]

    def outputs(self) -> list[Path]:
        """Return the file or folder that is written."""
        return [self.output.target_path]


def deform(settings: DeformSettings, progress: ProgressListener | None = None) -> ExportSummary:
    """Write the animation of the mesh that the cages move.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the weights cannot be trusted.
    """
    progress = progress or ProgressListener()
    settings.output.check_writable()
    result = read_result(settings.result)
    check_influences(result, settings.influences)
    clip = _open_cage_clip(settings, result, progress)
    mesh = load_mesh(settings.mesh) if settings.mesh is not None else _make_rest_model(result)
    binding = _load_or_compute_binding(settings, mesh, result, progress)
    if clip is None:
        report_skipped_frames(result, progress)
        cages, scene = CageFrames.from_result(result), result.scene
    else:
        cages = CageFrames.from_clip(clip, settings.jobs)
        scene = clip.scene.override(result.scene)
    animation = Animation(
        rest=binding.rest,
        frame_count=cages.count,
        scene=settings.scene.override(scene),
        name=_make_object_name(settings.mesh),
        obj_text=mesh.obj_text,
    )
    rotations = _read_needed_rotations(settings, result, binding, cages.count)
    target = Reconstruction(binding, cages, rotations)
    if settings.influences is None:
        memory = settings.memory - binding.weights.nbytes
        blocks = target.blocks(choose_block_size(memory, len(binding.rest.vertices)))
    else:
        blocks = _limit_influences(settings, result, target, progress)
    frames = (block.meshes for block in blocks)
    # One thread: the last digits depend on how many, and the writer takes longer anyway.
    with limit_blas_threads(1):
        return write_animation(settings.output, animation, frames, progress)


def _limit_influences(
    settings: DeformSettings, result: Result, target: Reconstruction, progress: ProgressListener
) -> Iterator[Block]:
    """Yield the frames that few influences give, fitted to the motion of the mesh."""
    sampling = SampleSettings(settings.memory, settings.jobs)
    name = settings.output.path.name
    request = RigRequest(settings.influences, name, settings.compares, sampling)
    return make_rig(result, target, request, progress).blocks()


def _read_needed_rotations(
    settings: DeformSettings, result: Result, binding: Binding, count: int
) -> Floats | None:
    """Read the rotations of the rest pose to each of `count` frames, if the weights need them."""
    if not binding.has_offsets:
        return None
    if count != len(result.frames):
        raise SettingError(
            f"{settings.cages}: has {count} cages, expected {len(result.frames)} as the result, "
            "whose weights have few influences: they turn with its frames; give as many cages"
        )
    return read_rotations(result)


def choose_block_size(memory: int, vertices: int) -> int:
    """Return how many frames, in whole groups, fit into `memory` bytes; one group at least."""
    groups = fit_frames(memory, vertices * FRAMES_PER_PRODUCT, ARRAYS_PER_FRAME)
    return FRAMES_PER_PRODUCT * min(groups, MAX_BLOCK_FRAMES // FRAMES_PER_PRODUCT)


def _open_cage_clip(
    settings: DeformSettings, result: Result, progress: ProgressListener
) -> MeshSequence | None:
    """Open the clip of cages, if one is given, which has the connectivity of the result's."""
    if settings.cages is None:
        return None
    clip = open_sequence([settings.cages], settings.clip, _make_rest_cage(result))
    with error_context(settings.cages):
        check_vertex_order(clip, result.cage, "the result's cage")
    for note in clip.notes:
        progress.note("note", note)
    if clip.missing:
        names = join_truncated((clip.names[k] for k in sorted(clip.missing)), 5)
        progress.note("note", f"{len(clip.missing)} cages are missing ({names}) and interpolated")
    return clip


def _load_or_compute_binding(
    settings: DeformSettings, mesh: LoadedMesh, result: Result, progress: ProgressListener
) -> Binding:
    """Return the weights of the result if they fit the settings; else bind the mesh to the cage."""
    result_settings = _read_bind_settings(result)
    bind_settings = BindSettings(
        settings.coordinates or result_settings.coordinates,
        settings.accuracy or result_settings.accuracy,
        settings.outside or result_settings.outside,
    )
    is_own = settings.mesh is None and bind_settings == result_settings
    if is_own and has_weights(result):
        binding = read_binding(result)
        assert binding is not None
        return binding
    weight_settings = WeightSettings(
        bind_settings, settings.cache, settings.jobs, is_own_cage=settings.mesh is None
    )
    with progress.stage("bind"), error_context(settings.mesh or settings.result), _name(mesh):
        binding = bind_cached(mesh, _make_rest_cage(result), weight_settings, progress).binding
    for note in mesh.notes + binding.notes:
        label, text = label_note(note)
        progress.note(label, f"{mesh.source['name']}: {text}")
    if result.fit is None:
        return binding
    return _apply_fit(binding, result, is_own, progress)


def _apply_fit(
    binding: Binding, result: Result, is_own: bool, progress: ProgressListener
) -> Binding:
    """Return a binding of computed weights with what a fit has changed, where it can be known.

    Raises
    ------
    SettingError
        When the weights of the result are fitted, not in it, and wanted.
    """
    fit = read_fit(result)
    if is_own and fit is not None and fit.low_rank is not None:
        return replace(binding, weights=fit.low_rank.add_to(binding.weights))
    if is_own:
        raise SettingError(
            f"{result.path}: its weights are fitted to a clip and not in it, so they cannot be "
            "computed again; extract it again without --no-weights, or with --fit-rank"
        )
    progress.note(
        "note",
        f"the cages of {result.path.name} are for weights that were fitted to its model; this mesh "
        f"has {binding.settings.coordinates} weights, which follow them less closely",
    )
    return binding


@contextmanager
def _name(mesh: LoadedMesh) -> Iterator[None]:
    """Call the mesh by its name where it is outside the cage, which is not made for it."""
    try:
        yield
    except OutsideError as error:
        if error.outside is None:
            raise
        remedy = "move it into the rest cage"
        if not error.outside.is_misplaced:
            remedy += ", or take the nearest points of the cage with --outside project"
        message = f"{error.outside.describe(mesh.source['name'])}; {remedy}"
        raise OutsideError(message) from error


def _read_bind_settings(result: Result) -> BindSettings:
    with error_context(result.path):
        names = ("coordinates", "accuracy", "outside")
        return BindSettings(**{name: str(result.settings.get(name)) for name in names})


def _make_rest_cage(result: Result) -> LoadedMesh:
    return LoadedMesh(result.cage, result.cage, {"name": f"the cage of {result.path.name}"})


def _make_rest_model(result: Result) -> LoadedMesh:
    return LoadedMesh(result.rest, result.rest, {"name": f"the rest pose of {result.path.name}"})


def _make_object_name(mesh: Path | None) -> str:
    """Return the name of the mesh in letters that all formats accept."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", mesh.stem) if mesh is not None else "mesh"
    return f"_{name}" if name[0].isdigit() else name
