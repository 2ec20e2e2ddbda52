"""Clips in Alembic: archives that alembic3d wrote, in every way that scenes and paths differ."""

import alembic3d  # noqa: F401  # before imath, which is its own
import imath
import numpy as np
import pytest
from alembic3d.AbcCoreAbstract import AcyclicFlag, TimeSampling, TimeSamplingType, TimeVector
from alembic3d.AbcGeom import OPolyMeshSchemaSample

from cageik_cli.formats.alembic import name_parts, place_meshes
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.parts import list_part_names
from cageik_cli.util.errors import FormatError
from tests.clips import frames_of
from tests.formats.character_files import WRITERS, read_alembic, read_usd
from tests.formats.scenes import FRAMES, AlembicScene, translation
from tests.formats.written import write
from tests.texts import texts


@pytest.fixture
def archive(tmp_path):
    return AlembicScene(tmp_path)


@pytest.mark.parametrize("fps", [30, 24000 / 1001])
def test_the_scene_is_what_the_times_say(archive, fps):
    archive.mesh(times=TimeSampling(1 / fps, 11 / fps))
    assert archive.opened().scene == SceneHints(fps=round(fps, 9), start=11.0)


def test_uneven_samples_are_taken_one_after_the_other(archive):
    times = TimeVector()
    times.extend([0.0, 0.1, 0.5, 0.6])
    archive.mesh(times=TimeSampling(TimeSamplingType(AcyclicFlag.kAcyclic), times))
    sequence = archive.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert sequence.scene == SceneHints()
    assert texts(sequence.notes) == (
        "clip.abc: its 4 samples are not evenly spaced in time; each is used as one frame",
    )


def test_transforms_of_other_times_are_taken_in_proportion(archive):
    """Points at frames 1 to 4, the transform at 1, 3 and 5: halfway at frames 2 and 4."""
    archive.transform([translation(k, 0, 0) for k in (0, 2, 6)], times=TimeSampling(2 / 24, 1 / 24))
    archive.mesh(parent="move")
    shifts = frames_of(archive.opened()) - FRAMES
    np.testing.assert_allclose(shifts[:, :, 0], np.repeat([[0], [1], [2], [4]], 6, 1), atol=1e-12)


def test_points_of_another_rate_are_interpolated(archive):
    """One part at frames 1 to 4, another at 1, 3, 5 and 7: halfway at the frames between."""
    archive.mesh("fast")
    archive.mesh("slow", times=TimeSampling(2 / 24, 1 / 24))
    frames = frames_of(archive.opened())
    np.testing.assert_array_equal(frames[:4, :6], FRAMES)
    np.testing.assert_array_equal(frames[[0, 2, 4, 5], 6:], FRAMES)
    between = (FRAMES[:2].astype(float) + FRAMES[1:3]) / 2
    np.testing.assert_allclose(frames[[1, 3], 6:], between, rtol=0, atol=1e-12)


@pytest.mark.parametrize("fps", [24, 29.97, 30])
def test_times_that_differ_by_rounding_are_one(archive, fps):
    still = np.repeat(FRAMES[:1], 36, axis=0)
    archive.mesh("fast", frames=still, times=TimeSampling(1 / fps, 1 / fps))
    for step in (2, 3, 5):
        times = TimeSampling(step / fps, 1 / fps)
        archive.mesh(f"slow_{step}", frames=still[: 35 // step + 1], times=times)
    assert len(archive.opened().frame_indices) == 36


def test_points_of_another_number_cannot_be_interpolated(archive):
    archive.mesh("fast")
    archive.mesh("slow", frames=[FRAMES[0], FRAMES[1][:5]], times=TimeSampling(2 / 24, 1 / 24))
    sentence = "/slow: 5 vertices in sample 1, expected 6 as in sample 0; all must share"
    assert sentence in archive.refused()


def test_a_transform_without_samples_moves_nothing(archive):
    archive.transform([])
    archive.mesh(parent="move")
    sequence = archive.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)
    assert texts(sequence.notes) == ()


def test_faces_that_change_are_refused(archive):
    archive.mesh()
    corners = imath.IntArray(3)
    corners[1], corners[2] = 1, 2
    faces = (corners, imath.IntArray(3, 1))
    archive.objects["mesh"].set(OPolyMeshSchemaSample(imath.V3fArray(6), *faces))
    sentence = "the faces change at time 4; all frames must share one connectivity"
    assert archive.refused() == f"/mesh: {sentence}"


@pytest.mark.parametrize(
    ("spoiled", "sentence"),
    [
        ({"frames": [np.zeros((0, 3))]}, "vertices have shape (0, 3), expected (count, 3)"),
        ({"frames": []}, "is not a sound Alembic file ("),
    ],
)
def test_what_makes_no_clip_is_a_sentence(archive, spoiled, sentence):
    archive.mesh(**spoiled)
    assert sentence in archive.refused()


def test_a_file_that_was_never_closed_is_a_sentence(archive):
    archive.mesh()
    archive.opened()
    data = bytearray(archive.path.read_bytes())
    data[5] = 0
    archive.path.write_bytes(data)
    with pytest.raises(FormatError, match=r"clip\.abc: is cut short"):
        open_sequence([str(archive.path)])


def test_a_sample_that_is_missing_is_a_sentence(archive):
    """The library itself would crash; a sample is found by where its size and digest begin."""
    archive.mesh()
    archive.opened()
    data = archive.path.read_bytes()
    place = data.index(FRAMES[1].tobytes()) - 16 - 8
    there = (place | 1 << 63).to_bytes(8, "little")
    assert data.count(there) == 1
    archive.path.write_bytes(data.replace(there, bytes(8)))
    with pytest.raises(FormatError, match=r"clip\.abc\[2\]: /mesh: sample 1 of `P` is missing"):
        frames_of(open_sequence([str(archive.path)]))


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"no Alembic\n" * 9, "is not an Alembic file"),
        (b"\x89HDF\r\n\x1a\n" + bytes(99), "is an old Alembic file"),
        (b"Ogawa\xff\0\1" + b"\x10" + bytes(99), "is not a sound Alembic file ("),
    ],
)
def test_what_is_no_alembic_is_a_sentence(tmp_path, data, sentence):
    path = tmp_path / "clip.abc"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        open_sequence([str(path)])
    assert str(caught.value).startswith(f"{path}: {sentence}")


PAIRS = {
    "pairs": (
        {"/hero/geo/body/bodyShape": 0, "/hero/eye/eyeShape": 1},
        ["/hero/geo/body", "/hero/eye"],
    ),
    "moved at the top": ({"/body/bodyShape": 0}, ["/body"]),
    "below each other": ({"/a/b/bShape": 1, "/a/b/c/cShape": 1}, ["/a/b", "/a/b/c"]),
    "Blender": ({"/hero/geo/hat/hat": 1}, ["/hero/geo/hat/hat"]),
    "several below one": ({"/geo/geoShape": 1, "/geo/other": 1}, ["/geo", "/geo/other"]),
    "still at the top": ({"/body/bodyShape": 1}, ["/body/bodyShape"]),
    "below a name that is its own": ({"/body/body_1/body_1Shape": 1}, ["/body/body_1/body_1Shape"]),
    "twice": ({"/a/b": 1, "/a/b/bShape": 1}, ["/a/b", "/a/b/bShape"]),
}
"""Paths of meshes with whether they are still, and the first of their parts."""


@pytest.mark.parametrize("case", list(PAIRS))
def test_a_pair_of_names_is_one_part_if_it_is_written_as_that_pair(case):
    meshes, parts = PAIRS[case]
    assert name_parts(list(meshes), list(meshes.values()))[: len(parts)] == parts


def test_parts_of_any_paths_are_written_where_their_meshes_were():
    """Those of pairs are; what else an archive has may get a transform of its own."""
    rng = np.random.default_rng(1)
    shortened = 0
    for _ in range(500):
        steps = rng.choice(["a", "b", "ab", "aShape", "abShape"], (4, 3))
        meshes = list({"/" + "/".join(each[: rng.integers(1, 4)]) for each in steps})
        are_still = (rng.random(len(meshes)) < 0.5).tolist()
        parts = name_parts(meshes, are_still)
        assert len(set(parts)) == len(parts)
        placed = place_meshes(parts, are_still)
        for mesh, part, place in zip(meshes, parts, placed, strict=True):
            assert part in (mesh, mesh.rpartition("/")[0])
            assert part == mesh or place == mesh
            shortened += part != mesh
    assert shortened > 50


def test_a_part_is_chosen_by_its_path_and_by_that_of_its_mesh(tmp_path):
    file = WRITERS["alembic"](tmp_path)
    for member in ("/hero/geo/jacket", "/hero/geo/jacket/jacketShape"):
        clip = open_sequence([f"{file}::{member}"])
        assert list_part_names(clip.first) == ("/hero/geo/jacket",)


@pytest.mark.parametrize("source", ["usd", "alembic"])
def test_paths_come_back_on_the_way_through_other_formats(tmp_path, source):
    """An archive is written onto the one that it came from, and a stage through an archive, too."""
    first = WRITERS[source](tmp_path)
    read = read_usd if source == "usd" else read_alembic
    path = first
    for k, suffix in enumerate(("usdc", "abc", "glb", "abc", first.suffix[1:])):
        clip = open_sequence([str(path)])
        frames = np.stack([clip.read_positions(k) for k in range(2)])
        path = write(tmp_path / f"{k}.{suffix}", clip.first, frames)
    assert {mesh.path for mesh in read(path)} == {mesh.path for mesh in read(first)}
