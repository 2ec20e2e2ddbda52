"""The cage of a run that is given none: built around the rest pose, or taken from the cache."""

from functools import partial
from pathlib import Path

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store.cage_cache import CageCache, CageEntry
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.build_cage import describe_built_cage, list_warnings, load_built_cage

BUILT_CAGE_NAME = "built cage"
"""Name, in the sources of a result, of a cage that was built for it."""


def build_cached(
    model: TriMesh, settings: BuildSettings, cache: Path | None, progress: ProgressListener
) -> LoadedMesh:
    """Build the cage of a model, or take it from the cache if there is a folder for that.

    The cage and its notes have the same bytes either way.

    Raises
    ------
    FormatError, NumericalError
        As `cages.build.build_cage`.
    """
    build = partial(_build, model, settings, progress)
    if cache is None:
        entry = build()
    else:
        entry = CageCache(cache, partial(progress.note, "cage")).get_or_build(
            model, settings, build
        )
    progress.note("cage", entry.description)
    return load_built_cage(TriMesh(entry.vertices, entry.faces), entry.notes, BUILT_CAGE_NAME)


def _build(model: TriMesh, settings: BuildSettings, progress: ProgressListener) -> CageEntry:
    """Build the cage, and describe it."""
    from cageik_cli.cages.build import build_cage

    built = build_cage(model, settings, progress=progress.update)
    return CageEntry(
        vertices=built.cage.vertices,
        faces=built.cage.faces,
        description=describe_built_cage(built),
        notes=list_warnings(built),
    )
