"""MDD files written byte by byte, as their description says."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.open import describe_contents, load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import ConnectivityError, FormatError, InputError, SettingError
from tests.clips import frames_of

FACES = np.array([[0, 1, 2], [0, 2, 3]])
FRAMES = np.random.default_rng(0).normal(size=(5, 4, 3)).astype("f4")


def mdd(frames=FRAMES, times=None):
    times = np.arange(len(frames)) / 24 if times is None else times
    numbers = [value for frame in frames.tolist() for vertex in frame for value in vertex]
    return (
        struct.pack(">ii", *frames.shape[:2])
        + struct.pack(f">{len(times)}f", *times)
        + struct.pack(f">{len(numbers)}f", *numbers)
    )


@pytest.fixture
def rest(tmp_path, write_obj):
    return load_mesh(write_obj(tmp_path / "rest.obj", FRAMES[0], FACES))


@pytest.fixture
def opened(tmp_path, rest):
    def through(data, how=None):
        (tmp_path / "clip.mdd").write_bytes(data)
        return open_sequence([str(tmp_path / "clip.mdd")], how, rest)

    return through


def test_frames_are_the_files_and_faces_the_rest_poses(opened):
    sequence = opened(mdd())
    assert sequence.names == tuple(f"clip.mdd[{k}]" for k in range(5))
    np.testing.assert_array_equal(sequence.first.faces, FACES)
    np.testing.assert_array_equal(sequence.first.fan_triangulated.faces, FACES)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.scene == SceneHints(fps=24.0, start=0.0)
    assert sequence.notes == ()


def test_polygons_of_the_rest_pose_are_compared_as_they_are(tmp_path, opened):
    """A concave quad is cut otherwise than as a fan, in the clip as in the rest pose."""
    (tmp_path / "rest.obj").write_text("v 0 0 0\nv 4 1 0\nv 1 1 0\nv 1 4 0\nf 1 2 3 4\n")
    rest = load_mesh(tmp_path / "rest.obj")
    (tmp_path / "clip.mdd").write_bytes(mdd())
    sequence = open_sequence([str(tmp_path / "clip.mdd")], None, rest)
    np.testing.assert_array_equal(sequence.first.faces, rest.mesh.faces)
    np.testing.assert_array_equal(
        sequence.first.fan_triangulated.faces, rest.mesh.fan_triangulated.faces
    )


@pytest.mark.parametrize(
    ("selection", "numbers"),
    [
        (slice(None), [0, 1, 2, 3, 4]),
        (slice(1, 3), [1, 2]),
        (slice(None, None, 2), [0, 2, 4]),
        (slice(-2, None), [3, 4]),
        (slice(2, 99, 2), [2, 4]),
    ],
)
def test_chosen_frames_keep_their_numbers_and_their_speed(opened, selection, numbers):
    sequence = opened(mdd(), ClipSettings(selection))
    assert sequence.names == tuple(f"clip.mdd[{k}]" for k in numbers)
    np.testing.assert_array_equal(frames_of(sequence), FRAMES[selection])
    assert sequence.scene == SceneHints(fps=24.0, start=numbers[0], frame_step=selection.step)


def test_no_frame_chosen_is_refused(opened):
    with pytest.raises(SettingError, match=r"clip\.mdd: --frames 7: .* 5 frames"):
        opened(mdd(), ClipSettings(slice(7, None)))


@given(
    st.integers(2, 400),
    st.sampled_from([1.0, 12.5, 24.0, 25.0, 29.97, 30.0, 59.94, 120.0]),
    st.integers(-100, 1000),
)
def test_times_in_single_precision_give_the_plain_numbers_back(count, fps, start):
    """Each is within its rounding; they are plain, unless the rounding hides the digits."""
    from cageik_cli.formats.mdd import _infer_timing

    times = ((start + np.arange(count)) / fps).astype("f4")
    hints, notes = _infer_timing(times)
    rounding = float(np.spacing(np.abs(times).max()))
    assert notes == ()
    share = 2 * rounding * fps / (count - 1)
    assert hints.fps == pytest.approx(fps, rel=share, abs=0)
    # The start in frames is a time in seconds times the frame rate, which may be off by that share.
    nearly = 1e-3 + 4 * rounding * fps * count + share * start
    assert hints.start == pytest.approx(start, rel=0, abs=nearly)
    if fps == int(fps) and rounding * fps * fps < 0.4:
        assert hints == SceneHints(fps, start)


@pytest.mark.parametrize(
    ("numbers", "fps", "found"),
    [
        ((1001, 2), 24, (24.0, 1001.0, 2.0)),
        ((1001, 3), 30, (30.0, 1001.0, 3.0)),
        ((1000, 2), 24, (12.0, 500.0, None)),  # the times are those of 12 frames per second
    ],
)
def test_the_step_is_found_if_the_clip_starts_between_samples(numbers, fps, found):
    from cageik_cli.formats.mdd import _infer_timing

    times = ((numbers[0] + numbers[1] * np.arange(9)) / fps).astype("f4")
    hints, _ = _infer_timing(times)
    assert hints == SceneHints(found[0], found[1], frame_step=found[2])


def test_uneven_times_are_noted_and_the_frames_taken(opened):
    sequence = opened(mdd(times=[0, 1, 2, 4, 5]))
    assert sequence.scene == SceneHints()
    (note,) = sequence.notes
    assert note.startswith("clip.mdd: the times of its frames, 0 s, 1 s to 5 s, are not evenly")
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)


@pytest.mark.parametrize("times", [[0] * 5, [4, 3, 2, 1, 0]])
def test_times_that_stand_or_run_back_are_noted(opened, times):
    assert "not evenly spaced" in opened(mdd(times=times)).notes[0]


def test_a_single_frame_has_no_speed(opened):
    sequence = opened(mdd(FRAMES[:1]))
    assert (sequence.scene, sequence.notes) == (SceneHints(), ())


def _header(data, frames, vertices):
    return struct.pack(">ii", frames, vertices) + data[8:]


DAMAGES = {
    "empty": (b"", "0 bytes, an MDD file has at least 8"),
    "header cut": (b"1234567", "7 bytes, an MDD file has at least 8"),
    "cut": (
        mdd()[:-1],
        "take 268 bytes, but has 267; it is cut short",
    ),
    "longer": (mdd() + b"\0", "take 268 bytes, but has 269; it is damaged"),
    "no frame": (_header(mdd(), 0, 4), "announces 0 frames, 4 vertices"),
    "no vertex": (_header(mdd(), 5, 0), "announces 5 frames, 0 vertices"),
    "negative": (_header(mdd(), -5, -4), "announces -5 frames, -4 vertices"),
    "huge": (_header(mdd(), 2**31 - 1, 2**31 - 1), "which take 55340232178178981904 bytes"),
    "little-endian": (
        np.array([5, 4], "<i4").tobytes() + mdd()[8:],
        "announces 83886080 frames, 67108864 vertices",
    ),
    "time nan": (mdd(times=[0, 1, np.nan, 3, 4]), "the time of frame 2 is nan, expected seconds"),
    "time inf": (mdd(times=[0, 1, 2, 3, np.inf]), "the time of frame 4 is inf"),
    "other mesh": (mdd(FRAMES[:, :3]), "3 vertices, the rest pose has 4"),
}


@pytest.mark.parametrize(("data", "says"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_no_sound_clip_is_refused(tmp_path, opened, data, says):
    with pytest.raises(InputError) as caught:
        opened(data)
    assert str(caught.value).startswith(f"{tmp_path / 'clip.mdd'}: ")
    assert says in str(caught.value)
    assert str(caught.value).count("clip.mdd") == 1


def test_a_first_frame_that_is_not_finite_is_named(opened):
    frames = FRAMES.copy()
    frames[0, 2, 1] = np.nan
    with pytest.raises(FormatError, match=r"^clip\.mdd\[0\]: vertex 2 is \("):
        opened(mdd(frames))


def test_without_a_rest_pose_it_is_refused_and_outlined(tmp_path):
    (tmp_path / "clip.mdd").write_bytes(mdd())
    typed = [str(tmp_path / "clip.mdd")]
    with pytest.raises(SettingError, match="--rest"):
        open_sequence(typed)
    assert describe_contents(typed, ClipSettings()) == [
        ("holds", "positions without faces; give these by --rest"),
        ("frames", "5"),
        ("vertices", "4"),
        ("scene", "24 frames per second, from frame 0"),
    ]


def test_a_huge_claim_is_refused_without_room_for_it(tmp_path, rest):
    """The file is sparse: as large as a clip would be, but for a byte."""
    import tracemalloc

    frames, vertices = 1000, 10**7
    path = tmp_path / "clip.mdd"
    with path.open("wb") as stream:
        stream.write(struct.pack(">ii", frames, vertices))
        stream.truncate(8 + 4 * frames + 12 * frames * vertices - 1)
    tracemalloc.start()
    with pytest.raises(FormatError, match="cut short"):
        open_sequence([str(path)], None, rest)
    with path.open("ab") as stream:
        stream.write(b"\0")
    with pytest.raises(ConnectivityError, match="10000000 vertices, the rest pose has 4"):
        open_sequence([str(path)], None, rest)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 20
