"""Describe a file in a few lines: results, bindings, checkpoints, clips, meshes or points."""

from collections.abc import Iterable
from dataclasses import asdict
from itertools import chain
from pathlib import Path

import numpy as np

from cageik_cli.cages.check.faults import find_cage_faults
from cageik_cli.fit.settings import FitRecord
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.find_files import Source, mesh_suffixes
from cageik_cli.formats.open import describe_contents, open_sequence
from cageik_cli.formats.ply_points import PointFile
from cageik_cli.formats.settings import ClipSettings, Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.source import LoadedModel, holds_caged_model, load_model
from cageik_cli.method.points.oriented import REST_COUNTS
from cageik_cli.method.weights.harmonic import MAX_HARMONIC_FACES
from cageik_cli.report.figures import format_length
from cageik_cli.report.fit_rows import format_fit_rows, list_fit_notes
from cageik_cli.report.views.text import format_accuracy_row, format_weights_row
from cageik_cli.report.vocabulary import VOCABULARIES
from cageik_cli.store.binding_file import StoredBinding, is_binding, read_binding
from cageik_cli.store.checkpoint import checkpoint_progress, is_checkpoint
from cageik_cli.store.result import Edit, StoredAnimation, is_animation, read_animation
from cageik_cli.store.result_fields import list_field_rows
from cageik_cli.util.errors import join_truncated
from cageik_cli.util.messages import Note, Row, say
from cageik_cli.util.text import format_count, group_digits
from cageik_cli.util.units import list_size_notes

MAX_LISTED_PARTS = 20
"""Parts of a model that are listed, at most."""


def describe_files(
    arguments: list[str],
    layout: str | None = None,
    exclude: tuple[str, ...] = (),
    fps: float | None = None,
) -> list[tuple[str, list[Row]]]:
    """Return the name and the facts of each of the files, or of the clip whose frames they are.

    `layout` is the order of an array's axes, `exclude` the patterns of parts that are left out, and
    `fps` the rate at which a clip is sampled, as in `ClipSettings`.
    """
    if len(arguments) > 1 and not _are_frames(arguments):
        blocks = (describe_files([each], layout, exclude, fps) for each in arguments)
        return list(chain.from_iterable(blocks))
    path = Path(arguments[0])
    if len(arguments) == 1 and is_checkpoint(path):
        return [(str(path), _checkpoint_rows(path))]
    if path.is_file() and path.suffix.lower() in HDF5_SUFFIXES and (rows := _describe_hdf5(path)):
        return [(str(path), rows)]
    if len(arguments) == 1 and _is_mesh_file(path):
        model = load_model(path, exclude)
        if model.points is not None:
            return [(str(path), _point_rows(model, model.points))]
        loaded = model.mesh
        rows = _mesh_rows(loaded.mesh) + _note_rows(loaded.mesh, loaded.scene, loaded.notes)
        return [(str(path), [("holds", "a mesh"), *rows, _cage_row(loaded.mesh)])]
    settings = ClipSettings(layout=layout, gaps="keep", exclude=exclude, fps=fps)
    rows = describe_contents(arguments, settings) or _clip_rows(open_sequence(arguments, settings))
    return [(join_truncated(arguments), rows)]


def _are_frames(arguments: list[str]) -> bool:
    """Return whether arguments may name the frames of one clip: files of one mesh, of one format.

    Folders and patterns are taken for frames.
    """
    sources = list(map(Source.parse, arguments))
    suffixes = {source.suffix for source in sources}
    is_series = len(suffixes) == 1 and suffixes <= set(mesh_suffixes())
    return is_series or not all(source.file.is_file() for source in sources)


def _is_mesh_file(path: Path) -> bool:
    """Return whether it is a file of one mesh, or a mesh of a result; not a folder or a glob."""
    source = Source.parse(path)
    is_part = source.file.is_file() and source.member is not None
    return source.is_mesh_file or (is_part and holds_caged_model(source.file))


def format_binding_rows(stored: StoredBinding, is_verbose: bool = False) -> list[Row]:
    """Return the rows on the meshes of a binding, its settings, its quality and its fit."""
    binding, quality, fit = stored.binding, stored.binding.quality, stored.fit
    settings = asdict(binding.settings)
    return [
        ("model", _format_counts(binding.rest)),
        *_part_rows(binding.rest),
        ("cage", _format_counts(binding.cage)),
        ("settings", ", ".join(f"{key} {value}" for key, value in settings.items())),
        format_weights_row(quality, binding.has_offsets),
        format_accuracy_row(quality, binding.settings.accuracy),
        *(
            [("projected", f"{group_digits(quality.projected)} vertices outside")]
            if quality.projected
            else []
        ),
        *((f"from {key}", str(source.get("name"))) for key, source in stored.sources.items()),
        *([] if fit is None else _format_fit(fit, is_verbose)),
        *(note.at(stored.sources["cage"]["name"]).row for note in binding.notes),
    ]


def _format_fit(record: FitRecord, is_verbose: bool) -> list[Row]:
    """Return the rows on a fit, the size and the notes."""
    solve = record.solve
    others = ("" if solve.align else ", not aligned") + (
        f", norm {solve.norm:g}" if solve.lowers_deviations else ""
    )
    return [
        *format_fit_rows(record, is_verbose),
        ("fit cages", f"alpha {solve.alpha:g}, beta {solve.beta:g}{others}"),
        ("size", f"{group_digits(record.report.fixed_floats)} floats of fitted weights"),
        *(("note", note) for note in list_fit_notes(record)),
    ]


def _describe_hdf5(path: Path) -> list[Row]:
    """Describe a result, an edit or a binding; no rows for other files."""
    if is_animation(path):
        return _result_rows(read_animation(path))
    if is_binding(path):
        stored = read_binding(path)
        holds = ("holds", f"a binding of cageik bind {stored.version}")
        return [holds, *format_binding_rows(stored)]
    return []


def _checkpoint_rows(path: Path) -> list[Row]:
    done, count = checkpoint_progress(path)
    return [
        ("holds", "the checkpoint of an interrupted or a running cageik extract"),
        (
            "frames",
            f"{group_digits(done)} of {group_digits(count)}; "
            + say("rerun the command with `resume=True` to continue"),
        ),
    ]


def _format_counts(mesh: TriMesh) -> str:
    triangles = f"{group_digits(len(mesh.faces))} triangles{_format_polygons(mesh)}"
    return f"{group_digits(len(mesh.vertices))} vertices, {triangles}"


def _format_polygons(mesh: TriMesh) -> str:
    """Return what the triangles are cut from, if they are."""
    return "" if mesh.attributes is None else f" of {mesh.attributes.description}"


def _result_rows(result: StoredAnimation) -> list[Row]:
    kind = "an edit" if isinstance(result, Edit) else "a result"
    return [
        ("holds", f"{kind} of {VOCABULARIES[result.FORMAT].command} {result.version}"),
        (
            "frames",
            f"{group_digits(len(result.frames))}, {result.frames[0]} to {result.frames[-1]}",
        ),
        ("model", _format_counts(result.rest)),
        *_part_rows(result.rest),
        ("cage", _format_counts(result.cage)),
        *list_field_rows(result),
        *(note.row for note in result.notes),
    ]


def _clip_rows(sequence: MeshSequence) -> list[Row]:
    missing = []
    if sequence.missing:
        names = join_truncated(sequence.names[k] for k in sorted(sequence.missing))
        missing = [("missing", f"{len(sequence.missing)} of these frames: {names}")]
    return [
        ("holds", "a clip"),
        ("frames", f"{group_digits(len(sequence))}, {sequence.names[0]} to {sequence.names[-1]}"),
        *missing,
        *_mesh_rows(sequence.first),
        *([("scene", sequence.scene.description)] if sequence.scene.description else []),
        *_note_rows(sequence.first, sequence.scene, sequence.notes),
    ]


def _note_rows(mesh: TriMesh, scene: SceneHints, notes: Iterable[Note]) -> list[Row]:
    """Return rows of notes, and of a size that no character has in the unit of the scene."""
    unit, says = scene.metres_per_unit, "the file says that a unit is"
    if unit is None:
        unit, says = Scene().metres_per_unit, "a unit is taken for"
    sizes = [text + " of cageik extract" for text in list_size_notes(mesh.diagonal, unit, says)]
    return [("note", note.located) for note in (*notes, *map(Note, sizes))]


def _mesh_rows(mesh: TriMesh) -> list[Row]:
    volume = f"closed, volume {format_length(mesh.volume)}" if mesh.is_closed else "open"
    components = format_count(int(mesh.components.max()) + 1, "component")
    return [
        ("vertices", group_digits(len(mesh.vertices))),
        ("triangles", f"{group_digits(len(mesh.faces))}{_format_polygons(mesh)}"),
        *_part_rows(mesh),
        ("surface", f"{volume}, {components}"),
        _bounds_row(mesh),
    ]


def _part_rows(mesh: TriMesh) -> list[Row]:
    """Return a row of each part of a mesh, up to `MAX_LISTED_PARTS`; none if it came as one."""
    parts = mesh.polygons.parts
    if parts is None:
        return []
    triangles = np.concatenate([[0], np.cumsum(mesh.polygons.corner_counts - 2)])
    rows = []
    for name, count, polygons in zip(
        parts.names[:MAX_LISTED_PARTS], parts.vertex_counts, parts.polygon_slices, strict=False
    ):
        faces = triangles[polygons.stop] - triangles[polygons.start]
        rows.append(
            ("part", f"{name}: {group_digits(count)} vertices, {group_digits(faces)} triangles")
        )
    more = len(parts.names) - len(rows)
    return [*rows, *([("part", f"and {more} more")] if more else [])]


def _point_rows(model: LoadedModel, points: PointFile) -> list[Row]:
    rows = [("holds", model.kind), (model.unit, group_digits(len(points.rows)))]
    if model.splats is None:
        rows.append(("properties", join_truncated(points.names, 20)))
    else:
        coefficients = model.splats.harmonics.shape[1]
        rows.append(("colours", f"spherical harmonics up to band {REST_COUNTS[coefficients]}"))
    notes = _note_rows(model.mesh.mesh, model.mesh.scene, ())
    return [*rows, _bounds_row(model.mesh.mesh), *notes]


def _bounds_row(mesh: TriMesh) -> tuple[str, str]:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    text = f"{_format_point(low)} to {_format_point(high)}, diagonal {format_length(mesh.diagonal)}"
    return "bounds", text


def _cage_row(mesh: TriMesh) -> tuple[str, str]:
    if len(mesh.faces) > MAX_HARMONIC_FACES:  # tests of so many, for nothing, could take gigabytes
        most = group_digits(MAX_HARMONIC_FACES)
        text = f"unfit: it has {group_digits(len(mesh.faces))} faces, at most {most} are used"
        return "as a cage", text
    findings = find_cage_faults(mesh)
    unfit = [finding.sentence for finding in findings if finding.severity == "unfit"]
    if not unfit:
        return "as a cage", "; ".join(["sound", *(finding.message for finding in findings)])
    more = f" ({len(unfit) - 1} more: cageik check)" if len(unfit) > 1 else ""
    return "as a cage", f"unfit: {unfit[0]}{more}"


def _format_point(position: np.ndarray) -> str:
    return "(" + ", ".join(format_length(value) for value in position) + ")"
