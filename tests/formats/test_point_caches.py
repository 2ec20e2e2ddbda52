"""PC2, MDD and `.anime` byte by byte; what holds for all formats is in `test_readers`."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.mdd import _infer_timing
from cageik_cli.formats.open import describe_contents, load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.util.errors import ConnectivityError, FormatError, InputError
from tests.clips import frames_of
from tests.formats.kinds import FACES, FRAMES, PC2_MAGIC, anime, mdd, pc2
from tests.texts import texts

HUGE = 2**31 - 1


@pytest.fixture
def rest(tmp_path, write_obj):
    return load_mesh(write_obj(tmp_path / "rest.obj", FRAMES[0], FACES))


@pytest.fixture
def opened(tmp_path, rest):
    def through(name, data):
        (tmp_path / name).write_bytes(data)
        return open_sequence([str(tmp_path / name)], None, rest)

    return through


@pytest.mark.parametrize("start", [0.0, 1.0, -3.0, 100.5])
@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_pc2_starts_where_it_says_with_the_step_of_its_rate(opened, start, rate):
    clip = opened("clip.pc2", pc2(start=start, rate=rate))
    step = None if rate == 1 else rate
    assert (clip.scene, texts(clip.notes)) == (SceneHints(start=start, frame_step=step), ())


def test_the_scene_is_outlined_without_a_rest_pose(tmp_path):
    for name, data, scene in (
        ("clip.pc2", pc2(start=1, rate=2), "from frame 1, in steps of 2"),
        ("clip.mdd", mdd(), "24 frames per second, from frame 0"),
    ):
        (tmp_path / name).write_bytes(data)
        rows = dict(describe_contents([str(tmp_path / name)], ClipSettings()))
        assert (rows["scene"], "note" in rows) == (scene, False)


@given(
    st.integers(2, 400),
    st.sampled_from([1.0, 12.5, 24.0, 25.0, 29.97, 30.0, 59.94, 120.0]),
    st.integers(-100, 1000),
)
def test_times_in_single_precision_give_the_plain_numbers_back(count, fps, start):
    """Each is within its rounding; they are plain, unless the rounding hides the digits."""
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
    times = ((numbers[0] + numbers[1] * np.arange(9)) / fps).astype("f4")
    hints, _ = _infer_timing(times)
    assert hints == SceneHints(found[0], found[1], frame_step=found[2])


@pytest.mark.parametrize("times", [[0, 1, 2, 4, 5], [0] * 5, [4, 3, 2, 1, 0]])
def test_times_that_are_uneven_stand_or_run_back_are_noted(opened, times):
    sequence = opened("clip.mdd", mdd(times=times))
    assert sequence.scene == SceneHints()
    (note,) = texts(sequence.notes)
    assert note.startswith(f"clip.mdd: the times of its frames, {times[0]} s, {times[1]} s to ")
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)


def test_a_single_time_says_nothing_of_speed(opened):
    sequence = opened("clip.mdd", mdd(FRAMES[:1]))
    assert (sequence.scene, texts(sequence.notes)) == (SceneHints(), ())


def damage_header(make, size, *faces):
    """What may be wrong with every header: its length, its counts, and the size that they need."""
    return {
        "empty": (b"", "the file is empty"),
        "header cut": (make()[: size - 1], f"{size - 1} bytes, a"),
        "cut": (make()[:-4], "it is cut short"),
        "longer": (make() + b"\0", "it is damaged"),
        "no frame": (make(counts=(0, 4, *faces)), "announces 0 frames, 4 vertices"),
        "no vertex": (make(counts=(5, 0, *faces)), "announces 5 frames, 0 vertices"),
        "negative": (make(counts=(-5, -4, *faces)), "announces -5 frames, -4 vertices"),
        "huge": (make(counts=(HUGE, HUGE, *faces)), "which take 553402321"),
    }


PC2_DAMAGES = damage_header(pc2, 32) | {
    "other magic": (pc2(magic=b"POINTCACHE3\0"), "begins with b'POINTCACHE3\\x00' and version 1"),
    "other version": (pc2(version=2), f"and version 2, expected {PC2_MAGIC!r} and version 1"),
    "start nan": (pc2(start=np.nan), "starts at frame nan with a sample every 1.0 frames"),
    "start inf": (pc2(start=np.inf), "starts at frame inf"),
    "rate nan": (pc2(rate=np.nan), "a sample every nan frames"),
    "rate 0": (pc2(rate=0), "a sample every 0.0 frames"),
    "rate negative": (pc2(rate=-1), "a sample every -1.0 frames"),
    "rate inf": (pc2(rate=np.inf), "a sample every inf frames"),
}
MDD_DAMAGES = damage_header(mdd, 8) | {
    "little-endian": (
        np.array([5, 4], "<i4").tobytes() + mdd()[8:],
        "announces 83886080 frames, 67108864 vertices",
    ),
    "time nan": (mdd(times=[0, 1, np.nan, 3, 4]), "the time of sample 2 is nan, expected seconds"),
    "time inf": (mdd(times=[0, 1, 2, 3, np.inf]), "the time of sample 4 is inf"),
}
ANIME_DAMAGES = damage_header(anime, 12, 4) | {
    "no face": (anime(faces=FACES[:0]), "announces 5 frames, 4 vertices, 0 triangles"),
    "negative faces": (anime(counts=(5, 4, -2)), "-2 triangles"),
    "counted from 1": (anime(faces=FACES + 1), "faces name vertices 1 to 4 of 4"),
    "other vertices": (anime(faces=FACES + 2), "face 0 names vertices 2, 3, 4 (counted from 0)"),
    "negative vertices": (anime(faces=FACES - 1), "face 0 names vertices -1, 0, 1"),
}
DAMAGES = [
    pytest.param(name, *damage, id=f"{name} {fault}")
    for name, damages in (
        ("clip.pc2", PC2_DAMAGES),
        ("clip.mdd", MDD_DAMAGES),
        ("clip.anime", ANIME_DAMAGES),
    )
    for fault, damage in damages.items()
]


@pytest.mark.parametrize(("name", "data", "says"), DAMAGES)
def test_what_is_no_sound_clip_is_refused(tmp_path, opened, name, data, says):
    with pytest.raises(InputError) as caught:
        opened(name, data)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert says in str(caught.value)
    assert str(caught.value).count(name) == 1


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
    with pytest.raises(ConnectivityError, match="10 000 000 vertices, the rest pose has 4"):
        open_sequence([str(path)], None, rest)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 1 << 20
