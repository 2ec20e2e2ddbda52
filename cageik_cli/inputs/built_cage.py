"""The cage of a run: built or taken from the cache if none is given, or refused with a remedy.

The builder is imported when a cage is built: it takes as long to import as the rest of a run.
"""

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from cageik_cli.cages.check.enclosure import MisfitError
from cageik_cli.cages.check.misfit import Transform
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.base.files import describe_source
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.store.cache import Entry, EntryCache, find_cage
from cageik_cli.util.errors import CageError, OutputError, error_context
from cageik_cli.util.messages import Note, Said
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener

BUILT_CAGE = "built cage"
"""Name of a cage that was built for the run, in place of that of a file."""

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
    return LoadedMesh(
        cage, describe_source(Path(BUILT_CAGE), data), tuple(map(Note, entry["notes"]))
    )


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
    cage: LoadedMesh, rest: LoadedMesh, offer: Callable[[Transform | None], Said] | None = None
) -> Iterator[None]:
    """Name the cage in errors raised inside, and the command that may repair its file.

    `offer` returns the options in place of a transform, see `CommonScene.offer`. Where there are
    some, nothing has to be repaired.
    """
    with error_context(cage.path or cage.source["name"]):
        try:
            yield
        except CageError as error:
            misfit = error.misfit if isinstance(error, MisfitError) else None
            remedy: Said = "" if misfit is None or offer is None else offer(misfit.transform)
            if cage.path is not None and error.is_repairable and not remedy:
                remedy = f"; to repair the cage: {format_repair_command(cage.path, rest.path)}"
            if not remedy:
                raise
            raise CageError(error.text + remedy) from error
