"""STL: files of other programs, welded by the first frame or numbered by the rest pose."""

import struct
from dataclasses import replace

import meshio
import numpy as np
import pytest
import trimesh

from cageik_cli.formats.open import load_mesh, open_clip_and_rest, open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.formats.stl import Reader
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import list_part_names
from cageik_cli.util.errors import ConnectivityError, FormatError, InputError, SettingError
from tests.clips import frames_of
from tests.refusals import refused
from tests.shapes import ball, quad_box, quad_text
from tests.texts import texts

MESH = ball(levels=1, size=np.pi)


def encode(mesh, vertices=None):
    """The bytes of a binary file."""
    vertices = mesh.vertices if vertices is None else vertices
    return trimesh.Trimesh(vertices, mesh.faces, process=False).export(file_type="stl")


def encode_text(mesh, name="ball"):
    """The bytes of an ASCII file, each number with all its digits."""
    text = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="stl_ascii")
    return text.replace("solid ", f"solid {name}", 1).encode()


def write_by_meshio(path, mesh, binary):
    cells = [("triangle", mesh.faces)]
    meshio.Mesh(mesh.vertices, cells).write(path, file_format="stl", binary=binary)


def corners_of(mesh):
    return mesh.vertices[mesh.faces]


@pytest.mark.parametrize(
    ("write", "rtol"),
    [
        (lambda path: write_by_meshio(path, MESH, binary=True), 1e-6),
        (lambda path: write_by_meshio(path, MESH, binary=False), 1e-6),
        (lambda path: path.write_bytes(encode(MESH)), 1e-6),
        (lambda path: path.write_bytes(encode_text(MESH)), 0),
    ],
)
def test_triangles_of_other_programs_keep_their_order_and_share_vertices(tmp_path, write, rtol):
    path = tmp_path / "ball.stl"
    write(path)
    loaded = load_mesh(path)
    np.testing.assert_allclose(corners_of(loaded.mesh), corners_of(MESH), rtol=rtol, atol=1e-9)
    assert len(loaded.mesh.vertices) == len(MESH.vertices)
    assert loaded.mesh.is_closed
    assert texts(loaded.notes) == ("96 corners welded into 18 vertices where they are equal",)


def test_vertices_are_numbered_as_the_corners_come(tmp_path):
    path = tmp_path / "ball.stl"
    path.write_bytes(encode(MESH))
    seen = load_mesh(path).mesh.faces.ravel()
    firsts = np.unique(seen, return_index=True)[1]
    assert (np.diff(firsts) > 0).all()


def test_a_binary_file_may_begin_as_text_does(tmp_path):
    path = tmp_path / "ball.stl"
    path.write_bytes(b"solid ball".ljust(80) + encode(MESH)[80:])
    assert load_mesh(path).mesh.is_closed


def test_zeros_of_both_signs_are_one_place(tmp_path):
    path = tmp_path / "square.stl"
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [-0.0, 0, -0.0], [1, 1, 0], [0, 1, 0]])
    path.write_bytes(encode(TriMesh(corners, [[0, 1, 2], [3, 4, 5]])))
    assert load_mesh(path).mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.fixture
def clip(tmp_path, animation):
    """A folder of binary STL frames of the tiny clip."""
    folder = tmp_path / "clip"
    folder.mkdir()
    for k, vertices in enumerate(animation.frames):
        (folder / f"f{k}.stl").write_bytes(encode(animation.rest, vertices))
    return folder


def test_frames_share_the_vertices_of_the_first(clip, animation):
    sequence = open_sequence([str(clip)])
    assert len(sequence.first.vertices) == len(animation.rest.vertices)
    found = frames_of(sequence)[:, sequence.first.faces]
    expected = animation.frames.astype(np.float32)[:, animation.rest.faces]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_frames_are_numbered_as_the_rest_pose(clip, animation, kind):
    path = clip.parent / f"rest.{kind}"
    trimesh.Trimesh(animation.rest.vertices, animation.rest.faces, process=False).export(path)
    sequence, rest = open_clip_and_rest((str(clip),), ClipSettings(), load_mesh(path))
    np.testing.assert_array_equal(sequence.first.faces, animation.rest.faces)
    np.testing.assert_array_equal(frames_of(sequence), animation.frames.astype(np.float32))
    np.testing.assert_array_equal(rest.mesh.faces, animation.rest.faces)
    assert "f0.stl: vertices numbered as in the rest pose, as in all frames" in texts(
        sequence.notes
    )


def test_quads_of_the_rest_pose_are_kept(tmp_path):
    rest = quad_box(2.0)
    path = tmp_path / "rest.obj"
    path.write_text(quad_text(2.0))
    for k in range(3):
        (tmp_path / f"f{k}.stl").write_bytes(encode(rest, rest.vertices + k))
    frames = (str(tmp_path / "f*.stl"),)
    sequence, loaded = open_clip_and_rest(frames, ClipSettings(), load_mesh(path))
    np.testing.assert_array_equal(frames_of(sequence), [rest.vertices + k for k in range(3)])
    assert loaded.mesh.attributes.corner_counts.tolist() == [4] * 6


def test_a_rest_pose_is_numbered_as_the_clip(folder, animation):
    path = folder / "rest.stl"
    path.write_bytes(encode(animation.rest))
    _, rest = open_clip_and_rest(("frames",), ClipSettings(), load_mesh(path))
    np.testing.assert_array_equal(rest.mesh.faces, animation.rest.faces)
    expected = animation.rest.vertices.astype(np.float32)
    np.testing.assert_array_equal(rest.mesh.vertices, expected)


def test_a_rest_pose_of_other_triangles_is_refused(folder, animation):
    path = folder / "rest.stl"
    path.write_bytes(encode(replace(animation.rest, faces=animation.rest.faces[::-1])))
    with refused(ConnectivityError, "triangle 0 joins vertices", at=path):
        open_clip_and_rest(("frames",), ClipSettings(), load_mesh(path))


def make_lips():
    """Two triangles that meet at one side at rest, with vertices of their own, and open."""
    rest = TriMesh([[0, 0, 0], [2, 0, 0], [1, 1, 0], [0, 0, 0], [2, 0, 0], [1, -1, 0]], LIPS)
    opened = rest.vertices.copy()
    opened[[3, 4, 5], 1] -= 0.25
    return rest, opened


LIPS = [[0, 1, 2], [4, 3, 5]]


def test_lips_that_open_are_refused_without_a_rest_pose_that_knows_them(tmp_path, write_obj):
    rest, opened = make_lips()
    for k, vertices in enumerate([rest.vertices, opened]):
        (tmp_path / f"f{k}.stl").write_bytes(encode(rest, vertices))
    frames = [str(tmp_path)]
    says = "triangles 0 and 1 (counted from 0) share vertex 1 of the rest pose, but have it at "
    with refused(ConnectivityError, says + "(2, 0, 0) and (2, -0.25, 0)", at=tmp_path / "f1.stl"):
        frames_of(open_sequence(frames))
    path = write_obj(tmp_path / "rest/closed.obj", rest.vertices, rest.faces)
    sequence, _ = open_clip_and_rest((*frames,), ClipSettings(), load_mesh(path))
    np.testing.assert_array_equal(frames_of(sequence), [rest.vertices, opened])


def test_vertices_that_meet_later_are_the_frames_of_one_clip(tmp_path):
    rest, opened = make_lips()
    for k, vertices in enumerate([opened, rest.vertices, rest.vertices]):
        (tmp_path / f"f{k}.stl").write_bytes(encode(rest, vertices))
    frames = frames_of(open_sequence([str(tmp_path)]))
    assert frames.shape == (3, 6, 3)


def test_meshes_of_other_triangles_are_no_clip(tmp_path):
    for name, mesh in (("body", MESH), ("hat", ball(levels=0))):
        (tmp_path / f"{name}.stl").write_bytes(encode(mesh))
    with refused(SettingError, "body.stl of 32 triangles, hat.stl of 8 triangles", at=tmp_path):
        open_sequence([str(tmp_path)])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda mesh: replace(mesh, faces=mesh.faces[:-1]), "31 triangles, the rest pose has 32"),
        (lambda mesh: replace(mesh, faces=mesh.faces[::-1]), "(70 corners differ so)"),
        (lambda mesh: replace(mesh, faces=np.roll(mesh.faces, 1, 1)), "triangles 0 and 1"),
    ],
)
def test_another_connectivity_is_refused(clip, animation, change, says):
    frame = replace(animation.rest, vertices=animation.frames[3])
    (clip / "f3.stl").write_bytes(encode(change(frame)))
    with refused(ConnectivityError, says, at=clip / "f3.stl"):
        frames_of(open_sequence([str(clip)]))


def test_corners_of_a_vertex_may_differ_by_their_rounding_alone(clip, animation):
    path, whole = clip / "f3.stl", animation.frames[3].astype(np.float32)
    corners = whole[animation.rest.faces].reshape(-1, 3)
    places = np.flatnonzero(animation.rest.faces.ravel() == 0)
    last = TriMesh(corners, np.arange(len(corners)).reshape(-1, 3))
    for step, is_sound in ((1, True), (64, False)):
        moved = corners.copy()
        moved[places[-1]] += step * np.spacing(np.abs(whole).max())
        path.write_bytes(encode(replace(last, vertices=moved)))
        sequence = open_sequence([str(clip)])
        if is_sound:
            number = sequence.first.faces.ravel()[places[0]]
            np.testing.assert_array_equal(sequence.read_frame(3)[number], whole[0])
        else:
            with refused(ConnectivityError, "(1 corner differ so)", at=path):
                sequence.read_frame(3)


def test_a_rest_pose_with_a_vertex_of_no_triangle_has_another_count(clip, animation, write_obj):
    vertices = [*animation.rest.vertices, (9, 9, 9)]
    path = write_obj(clip.parent / "rest.obj", vertices, animation.rest.faces)
    with refused(ConnectivityError, "19 vertices, the first frame has 18", at=path):
        open_clip_and_rest((str(clip),), ClipSettings(), load_mesh(path))


def test_vertices_that_are_no_numbers_in_all_corners_are_missing(clip, animation):
    vertices = animation.frames[2].copy()
    vertices[animation.rest.faces[0, 0]] = np.nan
    (clip / "f2.stl").write_bytes(encode(animation.rest, vertices))
    found = frames_of(open_sequence([str(clip)], ClipSettings(missing=True)))
    assert np.isnan(found).any(axis=(1, 2)).tolist() == [False, False, True, False, False]
    assert np.isnan(found[2]).all(axis=1).nonzero()[0].tolist() == [0]
    with refused(FormatError, "vertex 0 is (nan, nan, nan)", at=clip / "f2.stl"):
        frames_of(open_sequence([str(clip)]))


SOLIDS = encode_text(ball(levels=0), "left hand") + encode_text(MESH, "vertex endsolid normal 1 2")


def test_solids_are_parts(tmp_path):
    path = tmp_path / "two.stl"
    path.write_bytes(SOLIDS)
    loaded = load_mesh(path)
    assert list_part_names(loaded.mesh) == ("left hand", "vertex endsolid normal 1 2")
    assert loaded.mesh.attributes.parts.vertex_counts.tolist() == [6, 18]
    part = load_mesh(f"{path}::vertex endsolid normal 1 2").mesh
    np.testing.assert_array_equal(corners_of(part), corners_of(MESH))
    assert len(load_mesh(path, exclude=("vertex*",)).mesh.faces) == 8


def test_solids_that_touch_share_no_vertex_and_names_are_told_apart(tmp_path):
    path = tmp_path / "two.stl"
    path.write_bytes(encode_text(MESH, "a") * 2 + encode_text(MESH, ""))
    mesh = load_mesh(path).mesh
    assert list_part_names(mesh) == ("a", "a_2", "solid")
    assert len(mesh.vertices) == 3 * len(MESH.vertices)


def test_a_part_of_frames_is_read(tmp_path):
    for k in range(3):
        (tmp_path / f"f{k}.stl").write_bytes(SOLIDS)
    sequence = open_sequence([str(tmp_path)], ClipSettings(exclude=("left*",)))
    np.testing.assert_array_equal(
        frames_of(sequence)[:, sequence.first.faces], [corners_of(MESH)] * 3
    )


def test_a_binary_file_has_no_parts_to_choose(tmp_path):
    path = tmp_path / "ball.stl"
    path.write_bytes(encode(MESH))
    with refused(SettingError, "has no objects to choose from", at=path):
        load_mesh(path, exclude=("left",))


TRIANGLE = """solid a
facet normal 0 0 1
 outer loop
  vertex 0 0 0
  vertex 1 0 0
  vertex 0 1 0
 endloop
endfacet
endsolid a
"""


@pytest.mark.parametrize(
    "text",
    [
        TRIANGLE.replace("\n", "\r\n"),
        TRIANGLE.replace("\n", "\r"),
        TRIANGLE.replace("\n", "  \n\n\t"),
        TRIANGLE.upper(),
        TRIANGLE.replace("solid a", "solid"),
        TRIANGLE.replace("solid a\n", "solid facet vertex 1 2 3 é\n", 1),
        TRIANGLE.replace("1 0 0", "+1.e0 .0 -0E-9"),
        TRIANGLE.replace("normal 0 0 1", "normal -nan(ind) NaN inf"),
        TRIANGLE.rstrip(),
        "\n" + TRIANGLE,
        "\ufeff" + TRIANGLE,
        TRIANGLE + "solid empty\nendsolid empty\n",
    ],
)
def test_dialects_of_text(tmp_path, text):
    path = tmp_path / "triangle.stl"
    path.write_text(text, newline="")
    mesh = load_mesh(path).mesh
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    assert mesh.faces.tolist() == [[0, 1, 2]]


def test_one_vertex_is_counted_as_one():
    corner = TRIANGLE.replace("1 0 0", "0 0 0").replace("0 1 0", "0 0 0")
    (note,) = Reader.parse(corner.encode()).left_out
    assert note == "3 corners welded into 1 vertex where they are equal"


BINARY = bytes(80) + struct.pack("<I", 1) + struct.pack("<12fH", *range(12), 0)
FACET = "\n".join(TRIANGLE.splitlines()[1:-1])

FAULTS = {
    "no bytes": (b"", "the file is empty"),
    "a few bytes": (BINARY[:70], "70 bytes that do not begin with `solid`"),
    "cut short": (BINARY[:-1], "announces 1 triangles, which take 134 bytes, but has 133"),
    "more behind": (BINARY + b"\0", "which take 134 bytes, but has 135"),
    "huge": (BINARY[:80] + b"\xff" * 4 + BINARY[84:], "announces 4 294 967 295 triangles"),
    "solid and binary": (b"solid" + BINARY[5:-1], "cut short"),
    "none": (bytes(84), "holds no triangle"),
    "none in text": ("solid a\nendsolid a\n", "holds no triangle"),
    "other text": ("v 0 0 0\n" * 20, "is no text that begins with `solid`"),
    "nan": (BINARY[:96] + b"\0\0\xc0\x7f" + BINARY[100:], "vertex 0 is (nan, 4, 5)"),
    "signalling nan": (BINARY[:96] + b"\0\0\xa0\x7f" + BINARY[100:], "vertex 0 is (nan, 4, 5)"),
    "inf": (TRIANGLE.replace("1 0 0", "1 0 inf"), "vertex 1 is (1, 0, inf)"),
    "word": (TRIANGLE.replace("1 0 0", "1 0 zero"), "line 2 does not begin a whole facet ("),
    "two numbers": (TRIANGLE.replace("1 0 0", "1 0"), "line 2"),
    "four numbers": (TRIANGLE.replace("1 0 0", "1 0 0 1"), "line 2"),
    "numbers moved on": (TRIANGLE.replace("1 0 0", "1 0 0 0").replace("0 1 0", "1 0"), "line 2"),
    "quad": (TRIANGLE.replace(" endloop", "vertex 1 1 0\n endloop"), "line 2"),
    "one line": (TRIANGLE.replace("\n", " "), "ends in line 1"),
    "no end": (TRIANGLE.replace("endsolid a", ""), "ends in line 8, expected a whole facet"),
    "no second end": (TRIANGLE + "solid b\n" + FACET, "ends in line 17"),
    "no beginning": (TRIANGLE + FACET, "line 10 does not begin `solid NAME`"),
    "solidified": (TRIANGLE.replace("solid a", "solidify", 1), "line 1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_sound_stl_is_refused(tmp_path, fault):
    content, says = FAULTS[fault]
    path = tmp_path / "bad.stl"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(InputError, says, at=path):
        load_mesh(path)


def test_what_trimesh_cannot_read_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "ball.stl"
    path.write_bytes(encode(MESH))

    def fail(stream):
        raise AttributeError("no such thing")

    monkeypatch.setattr("trimesh.exchange.stl.load_stl", fail)
    with refused(FormatError, "is not a sound STL mesh (no such thing); export it again", at=path):
        load_mesh(path)
    monkeypatch.setattr("trimesh.exchange.stl.load_stl", lambda stream: {"vertices": np.eye(3)})
    with refused(FormatError, "holds 32 triangles, but 1 can be read", at=path):
        load_mesh(path)
