"""Weights of a model in its cage: from a binding file, from the cache, or computed."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from cageik_cli.cages.bind import JudgedBinding, bind, judge_binding
from cageik_cli.cages.check.enclosure import refuse_other_unit
from cageik_cli.cages.check.faults import validate_cage
from cageik_cli.cages.check.quality import find_looseness_faults
from cageik_cli.formats.base.files import describe_file
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.built_cage import BUILT_CAGE
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.store.binding_file import StoredBinding, read_binding
from cageik_cli.store.cache import EntryCache, find_binding
from cageik_cli.util.errors import CageError, SettingError, error_context
from cageik_cli.util.messages import Hint, Note, say
from cageik_cli.util.progress import ProgressListener


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

    def compute() -> JudgedBinding:
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
