"""The weights of a run: computed, from the cache, or from a binding file."""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.enclosure import refuse_other_unit
from cageik_cli.cages.check.faults import validate_cage
from cageik_cli.cages.check.quality import find_room_faults
from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.base.choose_parts import check_part_order
from cageik_cli.formats.base.files import describe_file
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_vertex_order
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.solver.settings import SolveSettings
from cageik_cli.store.binding_file import StoredBinding, read_binding, write_binding
from cageik_cli.store.cache import EntryCache
from cageik_cli.store.cache_keys import find_binding
from cageik_cli.util.arrays import DEFAULT_MEMORY
from cageik_cli.util.errors import CageError, SettingError, error_context
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener, label_note, mark_warning
from cageik_cli.workflows.common_scene import CommonScene
from cageik_cli.workflows.fit import fit_to_clips
from cageik_cli.workflows.mesh_source import load_rest, load_source
from cageik_cli.workflows.rest_pose import load_vertex_weights
from cageik_cli.workflows.run_cage import BUILT_CAGE, suggest_repair
from cageik_cli.workflows.settings import READ, READ_CLIP, WRITTEN, CommandSettings


@dataclass(frozen=True, slots=True)
class WeightSettings:
    """How the weights of a run are obtained.

    Attributes
    ----------
    cache : Path, optional
        The folder of the weight cache; none is used if absent.
    """

    bind: BindSettings = field(default_factory=BindSettings)
    cache: Path | None = None
    jobs: int = 1


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
            stored = replace(stored, binding=fitted)
    with progress.stage("write"):
        write_binding(settings.output, stored, settings.overwrite)
    return stored


def _fit_to_files(
    binding: Binding,
    rest: LoadedMesh,
    scene: CommonScene,
    settings: BindRunSettings,
    progress: ProgressListener,
) -> Binding:
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


def bind_cached(
    rest: LoadedMesh,
    cage: LoadedMesh,
    settings: WeightSettings,
    progress: ProgressListener,
    *,
    is_own_cage: bool = True,
) -> StoredBinding:
    """Bind a rest pose to a cage, or take their weights from the cache of weights.

    The notes of the binding include what was changed when the cage mesh was read; and, if the cage
    is for this model, not for another one, how it is judged.
    """
    if is_own_cage and _are_same(cage.mesh, rest.mesh):
        raise CageError(
            f"is the model itself, {len(rest.mesh.vertices)} vertices at the same places, expected "
            "a coarse cage around it; give one, or build it by cageik cage"
        )
    compute = partial(bind, rest.mesh, cage.mesh, settings.bind, settings.jobs, progress.update)
    if settings.cache is None:
        binding = compute()
    else:
        cache = EntryCache(settings.cache, partial(progress.note, "cache"))
        binding = find_binding(cache, rest.mesh, cage.mesh, settings.bind, compute)
        progress.update(len(rest.mesh.vertices), len(rest.mesh.vertices))
    sources = {"cage": cage.source, "rest": rest.source}
    notes = cage.notes + binding.notes
    if is_own_cage:
        refuse_other_unit(binding.cage, binding.rest)
        notes += tuple(map(mark_warning, _list_cage_warnings(cage, binding)))
    return StoredBinding(replace(binding, notes=notes), sources)


def _are_same(cage: TriMesh, rest: TriMesh) -> bool:
    """Return whether a cage is the very mesh that it is to hold."""
    return np.array_equal(cage.vertices, rest.vertices) and np.array_equal(cage.faces, rest.faces)


def _list_cage_warnings(cage: LoadedMesh, binding: Binding) -> tuple[str, ...]:
    """Return how a cage is judged; of one that was built, what to build it with."""
    if not binding.cage_warnings or cage.source["name"] != BUILT_CAGE:
        return binding.cage_warnings
    faults = find_room_faults(binding.cage, binding.rest, is_thorough=False, is_built=True)
    return tuple(fault.sentence for fault in faults)


def load_matching_binding(path: Path, rest: LoadedMesh, cage: LoadedMesh | None) -> StoredBinding:
    """Read a binding file, and check that it is of this rest pose and, if given, this cage."""
    source = describe_file(path)
    stored = read_binding(path)
    binding = stored.binding
    sources = {"binding": source, "cage": stored.sources["cage"], "rest": rest.source}
    if cage is not None:
        with error_context(cage.source["name"]):
            outward, _ = validate_cage(cage.mesh)
        sources["cage"] = cage.source
        _check_same_mesh(path, "cage", binding.cage, outward)
    _check_same_mesh(path, "rest pose", binding.rest, rest.mesh)
    if rest.mesh.attributes is not None:
        binding = replace(binding, rest=rest.mesh)
    return replace(stored, binding=binding, sources=sources)


def restore_unfitted(
    stored: StoredBinding, rest: LoadedMesh, settings: WeightSettings, progress: ProgressListener
) -> StoredBinding:
    """Return known weights with those before their fit, which binding files do not hold."""
    binding = stored.binding
    if binding.fit is None or binding.unfitted is not None:
        return stored
    cage = LoadedMesh(binding.cage, stored.sources["cage"])
    settings = replace(settings, bind=binding.settings)
    with error_context(stored.sources["binding"]["name"]):
        unfitted = bind_cached(rest, cage, settings, progress).binding
    return replace(stored, binding=replace(binding, unfitted=unfitted))


def _check_same_mesh(path: Path, what: str, expected: TriMesh, given: TriMesh) -> None:
    difference = _describe_difference(expected, given)
    if difference:
        leave = "leave `cage=` out, " if what == "cage" else ""
        raise SettingError(
            f"{path}: is the binding of another {what} ({difference}); give that {what} with "
            f"`{what.split()[0]}=`, {leave}or bind this one"
        )


def _describe_difference(expected: TriMesh, given: TriMesh) -> str:
    """Say what differs first between two meshes; nothing if they are the same."""
    for noun, there, here in (
        ("vertices", len(expected.vertices), len(given.vertices)),
        ("triangles", len(expected.faces), len(given.faces)),
    ):
        if there != here:
            return f"found {here} {noun}, expected {there}"
    apart = np.linalg.norm(given.vertices - expected.vertices, axis=1)
    moved = np.flatnonzero(apart)
    if len(moved):
        return (
            f"vertex {moved[0]} is {apart[moved[0]]:.3g} away from its place; vertices that "
            f"differ: {len(moved)}, by {apart.max():.3g} at most"
        )
    turned = np.flatnonzero((given.faces != expected.faces).any(axis=1))
    if len(turned):
        joined = ["-".join(map(str, mesh.faces[turned[0]])) for mesh in (expected, given)]
        return (
            f"triangle {turned[0]} has vertices {joined[1]}, expected {joined[0]}; triangles that "
            f"differ: {len(turned)}"
        )
    return ""
