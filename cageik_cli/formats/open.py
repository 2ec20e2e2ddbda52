"""Open clips: from files, folders and globs to a sequence of frames in natural order."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cageik_cli.formats.base.choose_parts import order_parts, select_parts
from cageik_cli.formats.base.files import decompress, describe_source, file_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh, check_connectivity, describe_folded
from cageik_cli.formats.base.readers import ArrayClipFile, FrameFileReader, parse_mesh
from cageik_cli.formats.base.sequence import ClipRequest, MeshSequence
from cageik_cli.formats.find_files import (
    Source,
    check_frames,
    expand_arguments,
    find_readers,
    list_left_out,
    parse_arguments,
)
from cageik_cli.formats.settings import ClipSettings, RestFrame
from cageik_cli.formats.stl import number_as_clip
from cageik_cli.formats.timeline import parse_frame_number
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import adopt_parts
from cageik_cli.util.errors import (
    FileAccessError,
    FormatError,
    SettingError,
    error_context,
)
from cageik_cli.util.files import read_input
from cageik_cli.util.messages import Hint, Note, Said, say
from cageik_cli.util.text import group_digits, to_unicode

_UNSUPPORTED_REASONS = {
    ".bvh .c3d .asf .amc": "holds the motion of a skeleton, not a mesh; export the mesh that it "
    "moves, as OBJ frames",
    ".fbx .blend": "is a scene of another program; export it as glTF, USD or Alembic, or bake it: "
    "blender --background --python docs/scripts/bake_rig.py -- {file} {stem}.abc",
    ".ma .max .mb .hip .hipnc .hiplc .bgeo": "is a scene of another program; export the meshes "
    "from it as USD, Alembic or OBJ frames",
    ".3mf .amf": "is a package for 3D printing, which is not read; export the mesh in it as STL or "
    "OBJ",
    ".dae .x3d .wrl .3ds .3dxml .xaml": "is a scene in a format that is not read; export it as "
    "glTF, USD or OBJ",
    ".step .stp .iges .igs .brep": "holds curved surfaces, not a mesh; mesh them, and export that "
    "as STL or OBJ",
}
"""Why files that look like clips cannot be read, by their suffixes, with the names to type."""


def open_sequence(
    arguments: Sequence[str], settings: ClipSettings | None = None, rest: LoadedMesh | None = None
) -> MeshSequence:
    """Open the clip that `arguments` name: files, folders, globs, or one file that holds a clip.

    `FILE::CLIP` picks one of a file's clips. `rest` is the rest pose, for files that hold no faces.

    Raises
    ------
    InputError
        When nothing matches, formats are mixed, or the first frame cannot be read.
    """
    reader, request = _resolve_request(arguments, settings or ClipSettings(), rest)
    sequence = reader(request)
    left_out = map(Note, list_left_out(arguments, request.paths))
    sequence.notes = (*left_out, *sequence.notes)
    sequence.takes_missing = request.settings.missing
    return sequence


def list_members(path: Path) -> list[str]:
    """List the clips in a file that holds several; empty if it is a clip itself, or damaged."""
    try:
        return find_readers()[file_suffix(path)].list_members(path)
    except Exception:  # whatever is in the file: opening it says what is wrong
        return []


def describe_contents(arguments: Sequence[str], settings: ClipSettings) -> list[tuple[str, Said]]:
    """Describe files that are not a clip by themselves, in labelled lines; empty for a clip."""
    reader, request = _resolve_request(arguments, settings, None)
    return reader.describe_contents(request)


def _resolve_request(
    arguments: Sequence[str], settings: ClipSettings, rest: LoadedMesh | None
) -> tuple[type[MeshSequence], ClipRequest]:
    readers_by_suffix = find_readers()
    arguments, member = parse_arguments(arguments)
    paths = expand_arguments(arguments, tuple(readers_by_suffix))
    check_frames(arguments, tuple(paths))
    for path in paths:
        if file_suffix(path) not in readers_by_suffix:
            raise FileAccessError(f"{path}: {_explain_unsupported(path)}")
    kinds = sorted({file_suffix(path) for path in paths})
    if len(kinds) > 1:
        raise SettingError(
            f"{arguments[0]}: files of formats {', '.join(kinds)} are mixed; "
            "choose one format, for instance with a quoted glob"
        )
    reader = readers_by_suffix[kinds[0]]
    with error_context(arguments[0] if member is None else f"{arguments[0]}::{member}"):
        _check_choice(reader, kinds[0], member, settings.exclude if rest is None else ())
    if settings.layout is not None and not reader.has_layout:
        raise SettingError(
            f"{arguments[0]}: the axes of `{kinds[0]}` files have a fixed order; remove "
            + Hint("layout", settings.layout)
        )
    return reader, ClipRequest(tuple(paths), member, rest, settings)


def _check_choice(
    reader: type[MeshSequence], suffix: str, member: str | None, exclude: Sequence[str]
) -> None:
    """Refuse to choose from what is in a file of a format that holds one clip, or one mesh."""
    if member is not None and not reader.has_members:
        what = "mesh" if issubclass(reader, FrameFileReader) else "clip"
        raise SettingError(f"a `{suffix}` file holds one {what}; remove `::{member}`")
    if exclude and not reader.has_parts:
        raise SettingError(
            f"a `{suffix}` file holds no parts; remove " + Hint("exclude", exclude[0])
        )


def _explain_unsupported(path: Path, holds: str = "clip") -> str:
    suffix = file_suffix(path)
    for suffixes, reason in _UNSUPPORTED_REASONS.items():
        if suffix in suffixes.split():
            return reason.format(file=path.name, stem=path.stem)
    expected = ", ".join(find_readers())
    return f"`{suffix}` is not a {holds} format that can be read, expected {expected}"


def open_clip_and_rest(
    frames: Sequence[str],
    settings: ClipSettings,
    rest: LoadedMesh | None,
    rest_frame: RestFrame = 0,
) -> tuple[MeshSequence, LoadedMesh]:
    """Open a clip and its rest pose: a mesh of the same connectivity, or a frame of it."""
    sequence = open_sequence(frames, settings, rest)
    if rest is not None:
        with error_context(rest.path or rest.source["name"]):
            ordered, notes = order_parts(rest.mesh, sequence.first, "the clip")
            if rest.is_welded:
                ordered = number_as_clip(ordered, sequence.first)
            fans = ordered.fan_triangulated
            expected = sequence.first.fan_triangulated
            check_connectivity(len(fans.vertices), fans.faces, expected, "the first frame")
        # Polygons are cut as in the first frame, which also knows its parts, and may know more.
        attributes, known = ordered.attributes, sequence.first.attributes
        if attributes is None or (attributes.parts is None and known and known.parts):
            attributes = known
        elif known is not None and known.parts is not None:
            attributes = adopt_parts(attributes, known)
        mesh = TriMesh(ordered.vertices, sequence.first.faces, attributes)
        return sequence, replace(rest, mesh=mesh, notes=(*rest.notes, *map(Note, notes)))
    return sequence, load_rest_frame(sequence, find_rest_index(sequence, rest_frame))


def find_rest_index(sequence: MeshSequence, rest_frame: RestFrame) -> int:
    """Return the index of the rest pose, which is given by index, or as text by its number."""
    timeline = sequence.timeline
    if isinstance(rest_frame, str):
        with error_context(Hint("rest_frame", rest_frame)):
            return timeline.find_index(parse_frame_number(rest_frame))
    if not 0 <= rest_frame < len(sequence):
        raise SettingError(
            Hint("rest_frame", rest_frame) + f": there is no such index; {timeline.describe()}"
        )
    return rest_frame


def load_rest_frame(sequence: MeshSequence, index: int) -> LoadedMesh:
    """Read a frame of a clip as its rest pose."""
    positions = sequence.read_frame(index)
    missing = int(np.count_nonzero(np.isnan(positions[:, 0])))
    if missing:
        raise FormatError(
            f"{sequence.location(index)}: {group_digits(missing)} of "
            f"{group_digits(len(positions))} vertices of the rest "
            "pose are missing; "
            + say("take a complete frame by `rest_frame=`, or a mesh by `rest=`")
        )
    path = Path(sequence.location(index))
    return LoadedMesh(
        sequence.first.move(positions),
        {"name": sequence.names[index]},
        path=path if Source.parse(path).is_mesh_file else None,
    )


def load_mesh(name: Path | Source, exclude: Sequence[str] = ()) -> LoadedMesh:
    """Read one mesh: a mesh file, or the first frame of a file that holds a clip.

    Polygons are cut into triangles, with a note. `FILE::PATH` picks what is read of a file of
    several meshes, and patterns leave out some of them.

    Raises
    ------
    FileAccessError, FormatError
        Naming the file, when it is missing, not a mesh, or of an unknown format.
    """
    source = Source.parse(name)
    with error_context(source.file):
        if source.file.is_dir():
            raise FileAccessError("is a folder, expected a file; give a mesh in it")
        if not source.file.exists():
            raise FileAccessError("no such file; check the path")
        if source.suffix not in find_readers():
            raise FileAccessError(_explain_unsupported(source.file, "mesh"))
    reader = find_readers()[source.suffix]
    with error_context(source):
        _check_choice(reader, source.suffix, source.member, exclude)
    if not issubclass(reader, FrameFileReader):
        return _load_first_frame(source, reader, exclude)
    with error_context(source.file):
        data = read_input(source.file)
        content = decompress(data, source.suffix)
        read = reader.read_attributes(content, parse_mesh(reader, content))
        read = reader.read_library(source.file, read)
        whole = read.make_mesh()
        mesh, _, left_out = select_parts(whole, source.member, exclude)
        origin = describe_source(source.file, data) | {"name": to_unicode(source.name)}
        notes = tuple(map(Note, (*read.notes, *map(str, describe_folded(whole)), *left_out)))
        is_welded = not reader.numbers_vertices
        return LoadedMesh(mesh, origin, notes, Path(str(source)), is_welded=is_welded)


def _load_first_frame(
    source: Source, reader: type[MeshSequence], exclude: Sequence[str]
) -> LoadedMesh:
    """Read the first frame of a file that holds a clip, as a mesh."""
    settings = ClipSettings(exclude=tuple(exclude))
    request = ClipRequest((source.file,), source.member, settings=settings)
    if issubclass(reader, ArrayClipFile) and reader.describe_contents(request):
        raise FormatError(
            f"{source}: holds no mesh, since it has no faces; give a file that has them, such as "
            ".obj, .usdc or .abc"
        )
    clip = reader(request)
    # A clip names its file in each note; what shows those of a mesh names it, too.
    notes = [Note(note.text, note.kind) for note in clip.notes]
    if len(clip) > 1:
        notes.insert(0, Note(f"the first of its {len(clip)} frames is taken"))
    origin, path = clip.describe_source(), Path(str(source))
    return LoadedMesh(clip.first, origin, tuple(notes), path, scene=clip.scene)
