"""Notes on what stands out of a clip: each fault is named, and a clean clip has no note."""

from pathlib import Path

import numpy as np
import pytest

from cageik_cli.report.record import build_report
from cageik_cli.report.standouts import list_standout_notes
from cageik_cli.workflows.extract import extract
from cageik_cli.workflows.settings import ExtractSettings


@pytest.fixture(scope="module")
def walk(fixtures_folder):
    folder = fixtures_folder / "walker"
    texts = [(folder / "frames" / f"walker_{k}.obj").read_text().splitlines() for k in range(1, 25)]
    frames = [[line.split()[1:4] for line in text if line[:2] == "v "] for text in texts]
    faces = [line.split()[1:4] for line in texts[0] if line[:2] == "f "]
    corners = [[int(word.split("/")[0]) - 1 for word in face] for face in faces]
    return np.array(frames, float), np.array(corners), folder / "cage.obj"


@pytest.fixture
def notes_of(walk, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def notes(frames):
        np.savez("clip.npz", verts=frames, faces=walk[1])
        result = extract(ExtractSettings(("clip.npz",), walk[2], Path("cages.h5"), overwrite=True))
        assert set(list_standout_notes(result)) <= set(build_report(result).notes)
        return list_standout_notes(result)

    return notes


def test_a_clean_clip_has_no_note(walk, notes_of):
    assert notes_of(walk[0]) == []


def test_thrown_vertices_are_noted_with_their_frames(walk, notes_of):
    frames = walk[0].copy()
    frames[[7, 12], 100] += 1.0
    note = notes_of(frames)[0]
    assert note.startswith("2 frames with vertices far away")
    assert "clip.npz[7]" in note
    assert "--robust" in note


def test_a_jump_is_noted(walk, notes_of):
    frames = walk[0].copy()
    frames[9] += [0.0, 0.4, 0.0]
    (note,) = notes_of(frames)
    assert note.startswith("1 frame where the motion jumps, most in clip.npz[9]")
    assert "--smooth auto" in note


def test_a_copy_is_noted(walk, notes_of):
    frames = walk[0].copy()
    frames[10] = frames[9]
    notes = [note for note in notes_of(frames) if "the same as" in note]
    assert len(notes) == 1
    assert "clip.npz[10]" in notes[0]
    assert "--fill-gaps" in notes[0]


def test_a_vertex_that_never_moves_is_noted(walk, notes_of):
    frames = walk[0] - walk[0].mean(axis=1, keepdims=True) + walk[0][0].mean(axis=0)
    moving = int(np.ptp(frames, axis=0).sum(axis=1).argmax())
    frames[:, moving] = frames[0, moving]
    notes = [note for note in notes_of(frames) if "unlike the neighbours" in note]
    assert len(notes) == 1
    assert f"vertex {moving} is off" in notes[0]
    assert "--vertex-weights" in notes[0]
