"""Notes on frames and vertices: each fault is named, and a clean clip has no note."""

import re
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.report.notes import list_clip_notes, list_outlier_notes
from cageik_cli.report.record import build_report
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from tests.shapes import rotation
from tests.texts import texts


@pytest.fixture
def list_notes(make_case, animation):
    """The notes on a clip whose first frame is the rest pose, and the others are changed."""

    def made(change, faces=None):
        frames = animation.frames.copy()
        frames[1:] = [change(k, frame) for k, frame in enumerate(frames[1:])]
        faces = animation.rest.faces if faces is None else faces
        return list_clip_notes(make_case(frames, faces).result)

    return made


def test_a_clip_in_motion_has_no_note(list_notes):
    assert list_notes(lambda k, frame: 0.8 * frame @ rotation(k) + k) == []


@pytest.mark.parametrize("is_open", [False, True])
def test_mirrored_frames_are_noted(list_notes, animation, is_open):
    """Those of an open model are found by the volume of their cages."""
    faces = animation.rest.faces[1:] if is_open else None
    mirrored = [-1.0, 1, 1]
    (note,) = list_notes(lambda k, frame: frame * (mirrored if k < 2 else 1), faces)
    assert note.startswith("2 of 5 frames are mirrored relative to the rest pose (")
    assert "[2]" in note
    assert "[4]" not in note
    assert "scale of -1" in note


@pytest.mark.parametrize(
    ("factor", "size", "unit"),
    [
        (100, "times as large as", "centimetres and metres"),
        (0.01, "times smaller than", "centimetres and metres"),
        (2.54, "times as large as", "inches and centimetres"),
        (7, "times as large as", "or of another model"),
    ],
)
def test_frames_of_another_size_are_noted_with_the_likely_unit(list_notes, factor, size, unit):
    (note,) = list_notes(lambda _, frame: factor * frame)
    found = re.match(f"the frames are ([0-9.]+) {size} the rest pose", note)
    assert float(found[1]) == pytest.approx(max(factor, 1 / factor), rel=0.06)
    assert unit in note


def test_frames_somewhat_larger_are_not_noted(list_notes):
    assert list_notes(lambda _, frame: 1.7 * frame) == []


def test_a_body_folded_flat_is_not_mirrored(list_notes):
    assert list_notes(lambda _, frame: frame * [1, 1, -0.05]) == []


@pytest.mark.parametrize(("below", "data", "is_noted"), [(15, 14, True), (16, 16, False)])
def test_hardly_more_vertices_than_the_cage_has_are_noted(
    make_case, animation, below, data, is_noted
):
    """Vertices in no face are no data; 16 are 2 for each of the 8 of the cage."""
    faces = animation.rest.faces
    kept = faces[(faces < below).all(axis=1)]
    assert len(np.unique(kept)) == data
    notes = list_clip_notes(make_case(animation.frames, kept).result)
    assert len(notes) == is_noted
    if is_noted:
        assert f"{data} vertices of the model are data, and the cage has 8" in notes[0]
        assert "smaller cage" in notes[0]


def test_the_note_is_in_the_report(make_case, animation):
    frames = np.concatenate([animation.frames[:1], -animation.frames[1:]])
    report = build_report(make_case(frames, animation.rest.faces).result)
    assert any("mirrored" in note for note in texts(report.notes))
    assert TriMesh(frames[1], animation.rest.faces).volume < 0


@pytest.fixture(scope="module")
def walk(fixtures_folder):
    folder = fixtures_folder / "walker"
    texts = [(folder / "frames" / f"walker_{k}.obj").read_text().splitlines() for k in range(1, 17)]
    frames = [[line.split()[1:4] for line in text if line[:2] == "v "] for text in texts]
    faces = [line.split()[1:4] for line in texts[0] if line[:2] == "f "]
    corners = [[int(word.split("/")[0]) - 1 for word in face] for face in faces]
    return np.array(frames, float), np.array(corners), folder / "cage.obj"


@pytest.fixture
def notes_of(walk, tmp_path, monkeypatch, weights_cache):
    monkeypatch.chdir(tmp_path)

    def notes(frames):
        np.savez("clip.npz", verts=frames, faces=walk[1])
        output = Path("cages.h5")
        result = extract(
            ExtractSettings(("clip.npz",), walk[2], output, overwrite=True, cache=weights_cache)
        )
        assert set(list_outlier_notes(result)) <= set(texts(build_report(result).notes))
        return texts(list_outlier_notes(result))

    return notes


def test_a_clean_clip_has_no_note(walk, notes_of):
    assert notes_of(walk[0]) == ()


@pytest.mark.parametrize(
    ("changed", "source", "move", "note", "named", "remedy"),
    [
        (9, 9, [0.0, 0.4, 0.0], "1 frame where the motion jumps, most in", 9, "smooth=auto"),
        (10, 9, 0.0, "1 frame the same as the one before", 10, "fill_gaps=True"),
    ],
    ids=["a jump", "a copy"],
)
def test_frames_that_stand_out_are_noted(
    walk, notes_of, changed, source, move, note, named, remedy
):
    frames = walk[0].copy()
    frames[changed] = walk[0][source] + move
    (found,) = [text for text in notes_of(frames) if text.startswith(note)]
    assert f"clip.npz[{named + 1}]" in found
    assert f"`{remedy}`" in found


def test_outlier_vertices_are_noted_and_rejecting_them_was_tried(walk, notes_of):
    frames = walk[0].copy()
    frames[[7, 12], 100] += 1.0
    notes = notes_of(frames)
    (found,) = [text for text in notes if text.startswith("2 frames with vertices far away")]
    assert "clip.npz[8]" in found
    assert "robust" not in found
    (tried,) = [text for text in notes if "`robust=True`" in text]
    assert "outliers among their neighbours" in tried


def test_a_quick_limb_is_no_outlier(walk, notes_of):
    frames = walk[0].copy()
    arm = frames[0, :, 0] > np.quantile(frames[0, :, 0], 0.9)
    frames[7, arm] += [1.0, 0.5, 0.0]
    notes = notes_of(frames)
    assert not any("far away" in note or "robust" in note for note in notes)
    assert any("jumps" in note for note in notes)


def test_a_vertex_that_never_moves_is_noted(walk, notes_of):
    frames = walk[0] - walk[0].mean(axis=1, keepdims=True) + walk[0][0].mean(axis=0)
    moving = int(np.ptp(frames, axis=0).sum(axis=1).argmax())
    frames[:, moving] = frames[0, moving]
    notes = [note for note in notes_of(frames) if "unlike the neighbours" in note]
    assert len(notes) == 1
    assert f"vertex {moving} is off" in notes[0]
    assert "`vertex_weights=`" in notes[0]
