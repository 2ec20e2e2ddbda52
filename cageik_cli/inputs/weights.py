"""The cage of a run and the weights of its model: from a file, from the cache, or computed.

The builder of cages is imported when one is built: it takes as long to import as the rest of a run.
"""

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cageik_cli.cages.bind import JudgedBinding, bind, judge_binding
from cageik_cli.cages.check.enclosure import MisfitError, refuse_other_unit
from cageik_cli.cages.check.faults import validate_cage
from cageik_cli.cages.check.quality import find_looseness_faults
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.files import describe_file, describe_source
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.method.weights.settings import COORDINATES
from cageik_cli.store.binding_file import StoredBinding, read_binding
from cageik_cli.store.cache import Entry, EntryCache, find_binding, find_cage
from cageik_cli.util.errors import CageError, OutputError, SettingError, error_context
from cageik_cli.util.messages import Hint, Note, Said, say
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import group_digits

BUILT_CAGE = "built cage"
"""Name of a cage that was built for the run, in place of that of a file."""

MAX_QUICK_FACES = 3000
"""Faces of a cage whose equations take less than half a minute; the time grows with their cube."""

UNNAMED_REST = "MODEL.obj"
"""Stands for a rest pose that is in no mesh file."""


def build_cached(
    model: TriMesh, settings: BuildSettings, cache: Path | None, progress: ProgressListener
) -> LoadedMesh:
    """Build the cage of a model, or take it from the cache if there is a folder for that.

    The cage and its notes have the same bytes either way.
    """
    build = partial(_build, model, settings, progress)
    if cache is None:
        entry = build()
    else:
        entries = EntryCache(cache, partial(progress.note, "cage"))
        entry = find_cage(entries, model, settings, build)
    progress.note("cage", entry["description"])
    cage = TriMesh(entry["vertices"], entry["faces"])
    data = encode_exact_obj(cage.vertices, cage.faces)
    source = describe_source(Path(BUILT_CAGE), data)
    return LoadedMesh(cage, source, tuple(map(Note, entry["notes"])))


def check_cage_output(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a file that cannot be written."""
    if path.suffix.lower() != ".obj":
        raise OutputError(
            f"{path}: a built cage is written as .obj, which keeps all its digits; name an .obj "
            "file"
        )
    check_writable(path, overwrite)


def _build(model: TriMesh, settings: BuildSettings, progress: ProgressListener) -> Entry:
    """Build the cage, and describe it, as the cache keeps it."""
    from cageik_cli.cages.builder.build import build_cage
    from cageik_cli.report.views.cage import describe_built_cage

    built = build_cage(model, settings, progress=progress.update)
    return {
        "vertices": built.cage.vertices,
        "faces": built.cage.faces,
        "description": describe_built_cage(built),
        "notes": built.notes,
    }


def format_repair_command(cage: Path, rest: Path | None) -> str:
    """Return the command that repairs a cage for a rest pose."""
    words = ["cageik", "cage", "--repair", str(cage), "--rest", str(rest or UNNAMED_REST)]
    words += ["-o", f"{cage.name.split('.')[0]}_repaired.obj"]
    command = shlex.join(words)
    if rest is None:
        command += f" ({UNNAMED_REST}: the rest pose, as a mesh file)"
    return command


@contextmanager
def suggest_repair(
    cage: LoadedMesh, rest: LoadedMesh, common: CommonScene | None = None
) -> Iterator[None]:
    """Name the cage in errors raised inside, and the command that may repair its file.

    Where the scene that it was placed in offers options in place of that, they are named.
    """
    with error_context(cage.path or cage.source["name"]):
        try:
            yield
        except CageError as error:
            misfit = error.misfit if isinstance(error, MisfitError) else None
            remedy: Said = ""
            if misfit is not None and common is not None:
                remedy = common.offer(misfit.transform, cage.scene)
            if cage.path is not None and error.is_repairable and not remedy:
                remedy = f"; to repair the cage: {format_repair_command(cage.path, rest.path)}"
            if not remedy:
                raise
            raise CageError(error.text + remedy) from error


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
            f"is the model itself, {group_digits(len(rest.mesh.vertices))} vertices at the same "
            "places, expected "
            "a coarse cage around it; give one, or build it by cageik cage"
        )

    def compute() -> JudgedBinding:
        solves_equations = COORDINATES[settings.bind.coordinates].needs_accuracy
        if solves_equations and len(cage.mesh.faces) > MAX_QUICK_FACES:
            progress.note(
                "bind",
                f"the cage has {group_digits(len(cage.mesh.faces))} faces: their equations take a "
                "minute or more, however few vertices there are; "
                + say('a coarser cage, or `coordinates="mean-value"`, takes less'),
            )
        taken = settings.bind, settings.jobs, progress.update
        return judge_binding(bind(rest.mesh, cage.mesh, *taken))

    if settings.cache is None:
        judged = compute()
    else:
        cache = EntryCache(settings.cache, partial(progress.note, "cache"))
        judged = find_binding(cache, rest.mesh, cage.mesh, settings.bind, compute)
        progress.update(len(rest.mesh.vertices), len(rest.mesh.vertices))
    binding, sources = judged.binding, {"cage": cage.source, "rest": rest.source}
    notes = cage.notes + binding.notes
    if is_own_cage:
        refuse_other_unit(binding.cage, binding.rest)
        notes += _list_cage_warnings(cage, judged)
    binding = replace(binding, notes=notes)
    return StoredBinding(binding, sources, has_loose_cage=judged.has_loose_cage)


def _are_same(cage: TriMesh, rest: TriMesh) -> bool:
    """Return whether a cage is the very mesh that it is to hold."""
    return np.array_equal(cage.vertices, rest.vertices) and np.array_equal(cage.faces, rest.faces)


def _list_cage_warnings(cage: LoadedMesh, judged: JudgedBinding) -> tuple[Note, ...]:
    """Return how a cage is judged; of one that was built, what to build it with."""
    if not judged.cage_warnings or cage.source["name"] != BUILT_CAGE:
        return judged.cage_warnings
    binding = judged.binding
    faults = find_looseness_faults(binding.cage, binding.rest, is_thorough=False, is_built=True)
    return tuple(Note(fault.sentence, "warning") for fault in faults)


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


def restore_baseline_weights(
    stored: StoredBinding, rest: LoadedMesh, settings: WeightSettings, progress: ProgressListener
) -> StoredBinding:
    """Return known weights with those before their fit, which binding files do not hold."""
    binding = stored.binding
    if stored.fit is None or stored.unfitted is not None:
        return stored
    cage = LoadedMesh(binding.cage, stored.sources["cage"])
    settings = replace(settings, bind=binding.settings)
    with error_context(stored.sources["binding"]["name"]):
        unfitted = bind_cached(rest, cage, settings, progress).binding
    return replace(stored, unfitted=unfitted)


def _check_same_mesh(path: Path, what: str, expected: TriMesh, given: TriMesh) -> None:
    difference = _describe_difference(expected, given)
    if difference:
        leave = say("leave `cage=` out, ") if what == "cage" else ""
        raise SettingError(
            f"{path}: is the binding of another {what} ({difference}); give that {what} with "
            + Hint(what.split()[0])
            + ", "
            + leave
            + "or bind this one"
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
