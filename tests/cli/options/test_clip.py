"""Which frames of a clip, in what order of axes, and which of a file's clips."""

import struct
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.store.result import read_cages, read_result


@pytest.fixture
def clips(folder, animation):
    """The animation of `frames` in other kinds of file, beside a rest pose."""
    frames, faces = animation.frames.astype("f4"), animation.rest.faces
    counts = frames.shape[:2]
    times = np.arange(len(frames), dtype=">f4") / 25
    Path("clip.mdd").write_bytes(
        struct.pack(">ii", *counts) + times.astype(">f4").tobytes() + frames.astype(">f4").tobytes()
    )
    header = struct.pack("<12siiffi", b"POINTCACHE2\0", 1, counts[1], 3.0, 1.0, counts[0])
    Path("clip.pc2").write_bytes(header + frames.tobytes())
    offsets = struct.pack("<iii", *counts, len(faces)) + frames[0].tobytes()
    Path("clip.anime").write_bytes(
        offsets + faces.astype("<i4").tobytes() + (frames[1:] - frames[0]).tobytes()
    )
    np.save("clip.npy", frames.transpose(1, 2, 0))
    np.savez_compressed("clip.npz", verts=frames, faces=faces)
    with h5py.File("clip.hdf5", "w") as file:
        file["faces"], file["walk"] = faces, frames.transpose(1, 2, 0)
        file["run"] = frames[:2].transpose(1, 2, 0)
    return folder


def extracted(run, *words):
    outcome = run("extract", *words, "--cage", "cage.obj", "-q", "--overwrite")
    assert outcome.code == 0, outcome.err
    result = read_result(Path("cages.h5"))
    return result, np.concatenate(list(read_cages(result, 10)))


def name_frames(clip, indices):
    """The names of frames, which are their numbers on the timeline of the clip."""
    start = {"clip.mdd": 0, "clip.pc2": 3}.get(clip, 1)
    return tuple(f"{clip}[{start + k}]" for k in indices)


REST = ("--rest", "frames/frame_1.obj")
WORDS = {
    "mdd": ("clip.mdd", *REST),
    "pc2": ("clip.pc2", *REST),
    "anime": ("clip.anime",),
    "npy": ("clip.npy", *REST),
    "npy, layout told": ("clip.npy", "--layout", "vxf", *REST),
    "npz": ("clip.npz",),
    "hdf5": ("clip.hdf5::walk",),
}


@pytest.mark.slow
@pytest.mark.parametrize("words", WORDS.values(), ids=WORDS)
def test_every_kind_gives_the_cages_of_the_frames(run, clips, words):
    _, expected = extracted(run, "frames")
    result, cages = extracted(run, *words)
    assert result.frames == name_frames(words[0], range(5))
    np.testing.assert_allclose(cages, expected, rtol=0, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("typed", "numbers"),
    [
        ("1:3", [1, 2]),
        ("::2", [0, 2, 4]),
        ("-2:", [3, 4]),
        (":", [0, 1, 2, 3, 4]),
        ("3:99", [3, 4]),
    ],
)
@pytest.mark.parametrize("words", [("frames",), *WORDS.values()], ids=["obj", *WORDS])
def test_frames_are_chosen_and_keep_their_numbers(run, clips, words, typed, numbers):
    rest = [] if "--rest" in words else REST
    result, _ = extracted(run, *words, *rest, "--frames", typed, "--no-weights")
    if words == ("frames",):
        assert result.frames == tuple(f"frame_{k + 1}.obj" for k in numbers)
    else:
        assert result.frames == name_frames(words[0], numbers)


def test_the_scene_is_the_files_unless_told(run, clips):
    mdd, pc2 = WORDS["mdd"], WORDS["pc2"]
    scene = extracted(run, *mdd)[0].scene
    assert (scene.fps, scene.start) == (25.0, 0.0)
    scene = extracted(run, *mdd, "--frames", "2::2")[0].scene
    assert (scene.fps, scene.start, scene.frame_step) == (25.0, 2.0, 2.0)
    scene = extracted(run, *pc2)[0].scene
    assert (scene.fps, scene.start) == (24.0, 3.0)
    scene = extracted(run, *pc2, "--fps", "30", "--start", "1")[0].scene
    assert (scene.fps, scene.start) == (30.0, 1.0)


def test_a_result_is_a_clip_of_its_cages(run, clips):
    """In the scene of the clip that they came from."""
    _, cages = extracted(run, *WORDS["mdd"], "--frames", ":3")
    Path("cages.h5").rename("first.h5")
    from cageik_cli.formats.open import open_sequence
    from cageik_cli.formats.settings import SceneHints
    from tests.clips import frames_of

    sequence = open_sequence(["first.h5"])
    np.testing.assert_array_equal(frames_of(sequence), cages)
    assert sequence.scene == SceneHints(25.0, 0.0, "Y", 1.0, 1.0)


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["frames", "--frames", "9:"], 1, "--frames 9: "),
        (["frames", "--frames", "4:2"], 2, "give --frames 2:4 for indices, or --frames 2-4 for"),
        (["clip.npz", "--frames", "5:7"], 1, "clip.npz: --frames 5:7 "),
        (["frames", "--frames", "3:3"], 2, "give --frames 3:4 for indices, or --frames 3 for the"),
        (["frames", "--frames", "4-2"], 2, "ends before it begins; the clip has 5 frames, 1 to 5"),
        (["frames", "--frames", "-2:3"], 1, "give --frames 1-3 for numbers"),
        (["frames", "--frames", "three"], 2, "'three'"),
        (["frames", "--frames", "7-9"], 1, "the clip has 5 frames, 1 to 5"),
        (["frames", "--frames", "::0"], 2, "'::0'"),
        (["frames", "--frames", "1:9:00"], 2, "'1:9:00'"),
        (["frames", "--frames", "::-1"], 2, "'::-1'"),
        (["clip.npy", "--layout", "xvf"], 2, "'xvf' is not one of 'fvx', 'vxf', 'fxv'"),
        (["clip.npy", "--layout", "fvx", *REST], 1, "(18, 3, 5), expected (frames, vertices, 3)"),
        (["clip.npy", "--layout", "fxv", *REST], 1, "5 vertices, the rest pose has 18"),
        (["clip.hdf5"], 1, "clip.hdf5: holds 2 clips: run, walk; choose one, as in FILE::run"),
        (["clip.hdf5::wlk"], 1, "clip.hdf5: holds no clip `wlk`; the nearest names are walk, run"),
        (["clip.mdd"], 1, "clip.mdd: holds positions but no faces"),
        (["clip.mdd", "--rest", "cage.obj"], 1, "clip.mdd: 18 vertices, the rest pose has 8; all"),
        (["clip.mdd", "--layout", "vxf"], 1, "the axes of `.mdd` files have a fixed order"),
    ],
)
def test_what_cannot_be_taken_is_refused(run, clips, words, code, says):
    outcome = run("extract", *words, "--cage", "cage.obj")
    assert (outcome.code, outcome.out) == (code, "")
    assert says in " ".join(outcome.err.split())
    assert code == 2 or len(outcome.err.splitlines()) == 1
    assert not Path("cages.h5").exists()


def test_the_check_takes_them_too(run, clips):
    for words in (("clip.hdf5::run", "--frames", "1:"), ("clip.npy", "--layout", "vxf", *REST)):
        outcome = run("check", *words, "--cage", "cage.obj")
        assert (outcome.code, outcome.err) == (0, "")
        assert "18 vertices" in outcome.out
