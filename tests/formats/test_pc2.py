"""PC2 files written byte by byte, as their description says."""

import struct

import numpy as np
import pytest

from cageik_cli.formats.open import describe_contents, load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import InputError
from tests.clips import frames_of

FACES = np.array([[0, 1, 2], [0, 2, 3]])
FRAMES = np.random.default_rng(0).normal(size=(5, 4, 3)).astype("f4")
MAGIC = b"POINTCACHE2\0"


def pc2(frames=FRAMES, magic=MAGIC, version=1, start=0.0, rate=1.0):
    numbers = [value for frame in frames.tolist() for vertex in frame for value in vertex]
    header = struct.pack("<iiffi", version, frames.shape[1], start, rate, len(frames))
    return magic + header + struct.pack(f"<{len(numbers)}f", *numbers)


def claiming(vertices, frames):
    data = pc2()
    return (
        data[:16]
        + struct.pack("<i", vertices)
        + data[20:28]
        + struct.pack("<i", frames)
        + data[32:]
    )


@pytest.fixture
def opened(tmp_path, write_obj):
    rest = load_mesh(write_obj(tmp_path / "rest.obj", FRAMES[0], FACES))

    def through(data, how=None):
        (tmp_path / "clip.pc2").write_bytes(data)
        return open_sequence([str(tmp_path / "clip.pc2")], how, rest)

    return through


def test_frames_are_the_files_and_faces_the_rest_poses(opened):
    sequence = opened(pc2())
    assert sequence.names == tuple(f"clip.pc2[{k}]" for k in range(5))
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.notes == ()


@pytest.mark.parametrize("start", [0.0, 1.0, -3.0, 100.5])
def test_it_starts_where_it_says(opened, start):
    assert opened(pc2(start=start)).scene == SceneHints(start=start)


def test_chosen_frames_start_at_the_first_of_them(opened):
    sequence = opened(pc2(start=10), ClipSettings(slice(1, None, 3)))
    assert sequence.scene == SceneHints(start=11, frame_step=3)
    assert sequence.names == ("clip.pc2[1]", "clip.pc2[4]")
    np.testing.assert_array_equal(frames_of(sequence), FRAMES[1::3])


@pytest.mark.parametrize("rate", [0.5, 2.0])
def test_another_rate_is_the_step_of_frame_numbers(opened, rate):
    clip = opened(pc2(start=1001.0, rate=rate))
    assert (clip.scene, clip.notes) == (SceneHints(start=1001.0, frame_step=rate), ())


DAMAGES = {
    "empty": (b"", "0 bytes, a PC2 file has at least 32"),
    "header cut": (pc2()[:31], "31 bytes, a PC2 file has at least 32"),
    "cut": (pc2()[:-4], "take 272 bytes, but has 268; it is cut short"),
    "longer": (pc2() + b"\0", "take 272 bytes, but has 273; it is damaged"),
    "other magic": (pc2(magic=b"POINTCACHE3\0"), "begins with b'POINTCACHE3\\x00' and version 1"),
    "other version": (pc2(version=2), "and version 2, expected b'POINTCACHE2\\x00' and version 1"),
    "no frame": (claiming(4, 0), "announces 0 frames, 4 vertices"),
    "no vertex": (claiming(0, 5), "announces 5 frames, 0 vertices"),
    "negative": (claiming(-4, -5), "announces -5 frames, -4 vertices"),
    "huge": (claiming(2**31 - 1, 2**31 - 1), "which take 55340232169"),
    "start nan": (pc2(start=np.nan), "starts at frame nan with a sample every 1.0 frames"),
    "start inf": (pc2(start=np.inf), "starts at frame inf"),
    "rate nan": (pc2(rate=np.nan), "a sample every nan frames"),
    "rate 0": (pc2(rate=0), "a sample every 0.0 frames"),
    "rate negative": (pc2(rate=-1), "a sample every -1.0 frames"),
    "rate inf": (pc2(rate=np.inf), "a sample every inf frames"),
    "other mesh": (pc2(FRAMES[:, :3]), "3 vertices, the rest pose has 4"),
}


@pytest.mark.parametrize(("data", "says"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_no_sound_clip_is_refused(tmp_path, opened, data, says):
    with pytest.raises(InputError) as caught:
        opened(data)
    assert str(caught.value).startswith(f"{tmp_path / 'clip.pc2'}: ")
    assert says in str(caught.value)


def test_without_a_rest_pose_it_is_outlined(tmp_path):
    (tmp_path / "clip.pc2").write_bytes(pc2(start=1, rate=2))
    rows = dict(describe_contents([str(tmp_path / "clip.pc2")], ClipSettings()))
    assert (rows["frames"], rows["vertices"], rows["scene"]) == (
        "5",
        "4",
        "from frame 1, in steps of 2",
    )
    assert "note" not in rows
