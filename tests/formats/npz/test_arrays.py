"""Clips in `.npz` and `.npy`: names and layouts in use, and what must not be loaded."""

import gc
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.npz import FACE_NAMES, VERTEX_NAMES, choose_layout, list_layouts
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import FormatError, InputError, SettingError
from tests.clips import frames_of
from tests.refusals import refused
from tests.texts import texts

FACES = np.array([[0, 1, 2], [0, 2, 3]])
AXES = {"fvx": (0, 1, 2), "vxf": (1, 2, 0), "fxv": (0, 2, 1)}
FRAMES = np.arange(2 * 4 * 3, dtype=float).reshape(2, 4, 3) ** 2


@pytest.fixture
def opened(tmp_path):
    """Write arrays to a file and open it as a clip."""

    def through(how=None, rest=None, **arrays):
        np.savez_compressed(tmp_path / "clip.npz", **arrays)
        return open_sequence([str(tmp_path / "clip.npz")], how, rest)

    return through


@pytest.fixture
def rest(tmp_path, write_obj):
    return load_mesh(write_obj(tmp_path / "rest.obj", FRAMES[0], FACES))


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [*((name, "faces") for name in VERTEX_NAMES), *(("verts", name) for name in FACE_NAMES)],
)
def test_the_usual_names_are_found(opened, vertices, faces):
    sequence = opened(**{vertices: FRAMES, faces: FACES, "fps": 24})
    assert sequence.names == ("clip.npz[1]", "clip.npz[2]")
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.scene == SceneHints(fps=24)


@pytest.mark.parametrize("kind", ["f2", "f4", "f8", ">f8"])
def test_positions_are_kept_to_the_bit(opened, kind):
    frames = FRAMES.astype(kind)
    found = frames_of(opened(verts=frames, faces=FACES.astype("u2")))
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, frames.astype(float))


@given(st.integers(1, 6), st.integers(4, 6))
def test_both_layouts_give_the_same_frames_or_are_refused(tmp_path_factory, count, vertices):
    """Told by the faces, of which one names the last vertex; refused are as many frames."""
    frames = np.random.default_rng(count).normal(size=(count, vertices, 3))
    faces = np.array([*FACES, [0, 1, vertices - 1]])
    path = tmp_path_factory.mktemp("layouts") / "clip.npz"
    for layout, axes in AXES.items():
        for order in "CF":
            np.savez(path, verts=np.asarray(frames.transpose(axes), order=order), faces=faces)
            told = ClipSettings(layout=layout)
            np.testing.assert_array_equal(frames_of(open_sequence([str(path)], told)), frames)
            if count == vertices and layout != "fvx":
                with pytest.raises(SettingError, match=r"can be read as vxf .* or fxv"):
                    open_sequence([str(path)])
            else:
                np.testing.assert_array_equal(frames_of(open_sequence([str(path)])), frames)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("layout", AXES)
def test_runs_of_frames_are_the_frames(tmp_path, monkeypatch, layout, order):
    """Whatever lies fastest in the file, and however few frames fit in a run."""
    frames = np.random.default_rng(0).normal(size=(11, 4, 3))
    path = tmp_path / "clip.npz"
    np.savez(path, verts=np.asarray(frames.transpose(AXES[layout]), order=order), faces=FACES)
    for bound in (1, 4 * 4 * 3 * 8, 1 << 25):
        monkeypatch.setattr("cageik_cli.formats.base.readers.MAX_CHUNK_BYTES", bound)
        sequence = open_sequence([str(path)], ClipSettings(slice(1, None, 2), layout))
        np.testing.assert_array_equal(frames_of(sequence, 3, 1), frames[1::2])
        np.testing.assert_array_equal(frames_of(sequence, 2, 4), frames[1::2])


def _lone(path, frames, rest):
    np.save(path, frames)
    return open_sequence([str(path)], None, rest)


@pytest.mark.parametrize("shape", [(4, 3, 9), (9, 3, 4)])
def test_the_rest_pose_tells_the_layout(tmp_path, rest, shape):
    frames = np.random.default_rng(0).normal(size=shape)
    expected = frames.transpose(2, 0, 1) if shape[0] == 4 else frames.transpose(0, 2, 1)
    np.testing.assert_array_equal(frames_of(_lone(tmp_path / "clip.npy", frames, rest)), expected)


def test_what_an_export_says_of_its_scene_is_taken(opened):
    said = {"fps": 30.0, "start": 5, "up_axis": "Z", "metres_per_unit": np.float32(0.5)}
    assert opened(verts=FRAMES, faces=FACES, **said).scene == SceneHints(30, 5, "Z", 0.5)
    chosen = opened(ClipSettings(slice(1, None)), verts=FRAMES, faces=FACES, **said)
    assert chosen.scene == SceneHints(30, 6, "Z", 0.5)


def test_hints_that_cannot_be_are_noted_and_others_passed_by(opened):
    sequence = opened(
        verts=FRAMES, faces=FACES, fps=0, up_axis="up", start=[1, 2], metres_per_unit="m"
    )
    assert sequence.scene == SceneHints()
    assert texts(sequence.notes) == (
        "clip.npz: ignored `fps`: 0 frames per second, expected a number above zero",
        "clip.npz: ignored `up_axis`: `up_axis=` is 'up', expected one of Y, Z",
    )
    assert opened(verts=FRAMES, faces=FACES, fps=np.array(None)).scene == SceneHints()


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"verts": FRAMES}, "`rest=`"),
        ({"faces": FACES}, "holds none of the arrays vertices, verts"),
        ({"verts": FRAMES, "v": FRAMES, "f": FACES}, "holds verts, v of the arrays"),
        ({"verts": FRAMES, "f": FACES, "tris": FACES}, "holds tris, f of the arrays"),
        ({"verts": FRAMES.astype(int), "faces": FACES}, "positions are int64 of shape (2, 4, 3)"),
        ({"verts": FRAMES[:0], "faces": FACES}, "positions have shape (0, 4, 3)"),
        (
            {"verts": FRAMES, "faces": FACES.astype(float)},
            "faces are float64 of shape (2, 3), expected integers",
        ),
        ({"verts": FRAMES, "faces": FACES.ravel()}, "faces are int64 of shape (6,)"),
        ({"verts": FRAMES, "faces": np.zeros((2, 4), int)}, "faces are int64 of shape (2, 4)"),
        ({"verts": FRAMES, "faces": FACES[:0]}, "0 faces"),
        (
            {"verts": FRAMES, "faces": FACES + 1},
            "faces name vertices 1 to 4 of 4",
        ),
        (
            {"verts": FRAMES.transpose(1, 2, 0), "faces": FACES + 1},
            "faces name vertices 1 to 4 of 4",
        ),
        (
            {"poses": FRAMES, "betas": FRAMES, "trans": FRAMES},
            "holds body parameters (AMASS or SMPL",
        ),
        ({"other": FRAMES}, "holds none of the arrays vertices, verts, V, v"),
        (
            {"verts": np.array([None]), "faces": FACES},
            "positions are object of shape (1,), expected",
        ),
        ({"verts": FRAMES, "faces": np.array([None])}, "faces are object of shape (1,)"),
    ],
)
def test_other_arrays_are_refused_with_what_was_found(opened, tmp_path, arrays, says):
    with refused(InputError, says, at=tmp_path / "clip.npz"):
        opened(**arrays)


@pytest.mark.parametrize(
    ("old", "new"),
    [(b"PK\1\2", b"PK\1\1"), (b"(2, 4, 3)", b"(9, 9, 9)"), (b"{'descr'", b"({descr'")],
)
def test_a_damaged_file_is_refused_and_closed(tmp_path, monkeypatch, old, new):
    left = []
    monkeypatch.setattr(sys, "unraisablehook", left.append)
    path = tmp_path / "clip.npz"
    np.savez(path, verts=FRAMES, faces=FACES)
    path.write_bytes(path.read_bytes().replace(old, new))
    with refused(FormatError, "", at=path):
        open_sequence([str(path)])
    gc.collect()
    assert not left


@pytest.mark.parametrize(
    ("shape", "layout", "found"),
    [
        ((7, 5, 3), None, ["fvx"]),
        ((5, 3, 7), None, ["vxf", "fxv"]),
        ((5, 3, 7), "vxf", ["vxf"]),
        ((5, 3, 7), "fxv", ["fxv"]),
        ((3, 5, 3), None, ["fvx"]),
        ((5, 3, 3), None, ["fvx", "vxf", "fxv"]),
    ],
)
def test_an_axis_of_three_is_the_coordinates(shape, layout, found):
    assert list_layouts(shape, layout) == found


@pytest.mark.parametrize(
    ("shape", "layout", "says"),
    [
        ((3, 5, 7), None, "expected (frames, vertices, 3) or (vertices, 3, frames) or (frames, 3"),
        ((5, 3), None, "positions have shape (5, 3)"),
        ((2, 5, 3, 3), None, "positions have shape (2, 5, 3, 3)"),
        ((), None, "positions have shape ()"),
        ((0, 5, 3), None, "positions have shape (0, 5, 3)"),
        ((5, 0, 3), None, "positions have shape (5, 0, 3)"),
        ((7, 5, 3), "fxv", "expected (frames, 3, vertices)"),
    ],
)
def test_other_shapes_are_refused(shape, layout, says):
    with refused(FormatError, says):
        list_layouts(shape, layout)


@pytest.mark.parametrize(
    ("shape", "named", "layout"),
    [
        ((7, 5, 3), None, "fvx"),
        ((7, 5, 3), 99, "fvx"),
        ((5, 3, 7), 5, "vxf"),
        ((5, 3, 7), 7, "fxv"),
        ((5, 3, 7), 6, "fxv"),
        ((5, 3, 3), 5, "vxf"),
        ((5, 3, 3), 4, "vxf"),
    ],
)
def test_the_vertices_that_are_named_decide(shape, named, layout):
    assert choose_layout(list_layouts(shape, None), shape, named) == layout


@pytest.mark.parametrize(
    ("shape", "named", "says"),
    [
        ((5, 3, 7), None, "vxf (7 frames of 5 vertices) or fxv (5 frames of 7 vertices)"),
        ((5, 3, 7), 4, "vxf (7 frames of 5 vertices) or fxv (5 frames of 7 vertices)"),
        ((5, 3, 7), 8, "vxf (7 frames of 5 vertices) or fxv (5 frames of 7 vertices)"),
        ((5, 3, 5), 5, "vxf (5 frames of 5 vertices) or fxv (5 frames of 5 vertices)"),
        ((5, 3, 3), 3, "fvx (5 frames of 3 vertices) or fxv (5 frames of 3 vertices)"),
        ((3, 3, 3), 3, "fvx (3 frames of 3 vertices) or vxf (3 frames of 3 vertices) or fxv"),
    ],
)
def test_several_readings_are_asked_about(shape, named, says):
    with pytest.raises(SettingError) as caught:
        choose_layout(list_layouts(shape, None), shape, named)
    assert says in str(caught.value)
    assert str(caught.value).endswith("`layout=`")
