"""What holds of a clip in every format: its frames, which are taken, and what is refused."""

import hashlib
import re

import numpy as np
import pytest

from cageik_cli.formats.find_files import clip_suffixes
from cageik_cli.formats.open import describe_contents, load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, Scene
from cageik_cli.util.errors import (
    ConnectivityError,
    FileAccessError,
    FormatError,
    InputError,
    SettingError,
)
from tests.clips import frames_of
from tests.formats.kinds import FACES, FRAMES, KINDS, WITHOUT_FACES
from tests.refusals import refused
from tests.texts import texts

SLICES = [slice(1, 3), slice(None, None, 2), slice(-2, None), slice(2, 99, 2)]


class Clip:
    """A file of some kind, with a rest pose where the kind has no faces."""

    def __init__(self, folder, name, write_obj):
        self._folder, self.path, self.name, self.rest = folder, folder / name, name, None
        if name in WITHOUT_FACES:
            self.rest = load_mesh(write_obj(folder / "rest.obj", FRAMES[0], FACES))

    def open(self, frames=FRAMES, **how):
        if frames is not None:
            # In a folder of its own, since USD keeps a layer while a clip is open.
            self.path = self._folder / str(len(list(self._folder.iterdir()))) / self.name
            self.path.parent.mkdir()
            KINDS[self.name](self.path, frames)
        return open_sequence([str(self.path)], ClipSettings(**how), self.rest)


@pytest.fixture(params=KINDS)
def clip(request, tmp_path, write_obj):
    return Clip(tmp_path, request.param, write_obj)


def name_frames(name, sequence):
    """The names of frames of a file, each with its number."""
    scene = sequence.scene.override(Scene())
    return tuple(f"{name}[{scene.frame_number(k):g}]" for k in range(len(sequence)))


def test_no_format_of_clips_is_left_out():
    meshes = (".obj", ".ply", ".off", ".stl")
    frames = {*meshes, *(f"{suffix}.gz" for suffix in meshes)}
    names = {name.removeprefix("clip") for name in KINDS}
    assert names | frames == set(clip_suffixes())


def test_frames_faces_and_digest(clip):
    sequence = clip.open()
    assert sequence.names == name_frames(clip.name, sequence)
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(sequence.first.vertices, FRAMES[0])
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    np.testing.assert_array_equal(frames_of(sequence, 3, 4), FRAMES)
    digest = hashlib.sha256(clip.path.read_bytes()).hexdigest()
    assert sequence.describe_source() == {"name": clip.name, "sha256": digest}
    assert sequence.digest(2).hex() == digest
    assert texts(sequence.notes) == ()


def test_a_file_that_is_written_again_keeps_no_digest(clip):
    """Its digest would be of the new content, and what was read of the old."""
    sequence = clip.open()
    clip.path.write_bytes(clip.path.read_bytes() + b" ")
    with refused(FileAccessError, "changed while it was read; run again", clip.path):
        sequence.describe_source()


@pytest.mark.parametrize("selection", SLICES, ids=str)
def test_chosen_frames_keep_their_names_and_numbers(clip, selection):
    whole, chosen = clip.open().scene, range(5)[selection]
    sequence = clip.open(selection=selection)
    assert sequence.names == name_frames(clip.name, sequence)
    np.testing.assert_array_equal(sequence.first.vertices, FRAMES[selection][0])
    np.testing.assert_array_equal(frames_of(sequence), FRAMES[selection])
    assert sequence.scene == whole.restrict_to_frames(chosen)


def test_no_frame_chosen_is_refused(clip):
    with pytest.raises(SettingError, match=r"`selection=7:` .* 5 frames"):
        clip.open(selection=slice(7, None))


def test_a_single_frame(clip):
    np.testing.assert_array_equal(frames_of(clip.open(FRAMES[:1])), FRAMES[:1])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite_are_refused_with_their_frame(clip, value):
    frames = FRAMES.copy()
    frames[3, 2, 1] = value
    sequence = clip.open(frames)
    assert len(frames_of(clip.open(frames, selection=slice(0, 3)))) == 3
    name = re.escape(sequence.names[3])
    with pytest.raises(FormatError, match=rf"{name}: vertex 2 is "):
        frames_of(sequence)
    frames[0, 1, 2] = value
    with pytest.raises(FormatError, match=r"clip\.\w+.*: vertex 1 is "):
        clip.open(frames)


def test_vertices_may_be_missing(clip):
    frames = FRAMES.copy()
    frames[0, 1], frames[3, 2, 1] = np.nan, np.nan
    if clip.name in ("clip.anime", "clip.glb", "clip.gltf"):  # offsets from what is not there
        frames[:, 1] = np.nan
    sequence = clip.open(frames, missing=True)
    found = frames_of(sequence)
    np.testing.assert_array_equal(np.isnan(found).all(axis=2), np.isnan(frames).any(axis=2))
    np.testing.assert_array_equal(sequence.first.vertices[[0, 2, 3]], FRAMES[0, [0, 2, 3]])
    middle = FRAMES[0, [0, 2, 3]].mean(axis=0)
    np.testing.assert_allclose(sequence.first.vertices[1], middle, rtol=1e-15)


def test_a_file_cut_anywhere_is_refused_by_its_name(clip):
    clip.open()
    data = clip.path.read_bytes()
    for size in {0, 1, 7, *range(13, len(data) - 1, max(1, len(data) // 13)), len(data) - 2}:
        if clip.name == "clip.usda" and data[:size].rstrip().endswith(b"}\n}"):
            continue
        if clip.name == "clip.usdz" and b"PK\1\2" in data[:size]:  # USD needs no directory
            continue
        clip.path.write_bytes(data[:size])
        with pytest.raises(InputError) as caught:
            frames_of(clip.open(frames=None))
        assert clip.name in str(caught.value).split(": ")[0]
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "data",
    [b"", b"no clip\n" * 20, b"\xff" * 200, b"\x80\x04N.", b"PK\3\4", b"#usda 1.0\ndef \xb8\n"],
)
def test_what_is_no_clip_is_refused_by_its_name(clip, data, capfd):
    clip.path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        clip.open(frames=None)
    assert str(caught.value).startswith(f"{clip.path}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_a_folder_of_that_name_is_refused(clip):
    clip.path.mkdir()
    with pytest.raises(InputError, match="is a folder"):
        clip.open(frames=None)


@pytest.mark.parametrize("clip", WITHOUT_FACES, indirect=True)
def test_without_faces_a_rest_pose_gives_them(clip):
    sequence = clip.open()
    np.testing.assert_array_equal(sequence.first.fan_triangulated.faces, FACES)
    with pytest.raises(ConnectivityError, match=r"clip\.\w+: 8 vertices, the rest pose has 4"):
        clip.open(np.repeat(FRAMES, 2, axis=1))
    clip.open()
    with pytest.raises(SettingError, match=r"clip\.\w+: holds positions but no faces"):
        open_sequence([str(clip.path)])
    rows = dict(describe_contents([str(clip.path)], ClipSettings()))
    assert str(rows["holds"]).startswith("positions without faces")
    assert (rows["frames"], rows["vertices"]) == ("5", "4")


@pytest.mark.parametrize("clip", WITHOUT_FACES, indirect=True)
def test_polygons_of_the_rest_pose_are_compared_as_they_are(clip, tmp_path):
    """A concave quad is cut otherwise than as a fan, in the clip as in the rest pose."""
    (tmp_path / "rest.obj").write_text("v 0 0 0\nv 4 1 0\nv 1 1 0\nv 1 4 0\nf 1 2 3 4\n")
    clip.rest = load_mesh(tmp_path / "rest.obj")
    found, rest = clip.open().first, clip.rest.mesh
    np.testing.assert_array_equal(found.faces, rest.faces)
    np.testing.assert_array_equal(found.fan_triangulated.faces, rest.fan_triangulated.faces)
