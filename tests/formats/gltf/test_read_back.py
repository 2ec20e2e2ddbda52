"""Files of glTF that cageik wrote, read again: what `deform` gives, within the stated error."""

import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, Scene
from cageik_cli.geometry.parts import split_parts
from tests.character import NAMES, make_character
from tests.clips import frames_of
from tests.formats.written import write

UPRIGHT = 0.01 * np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From z up and centimetres to y up and metres, for rows."""


@pytest.fixture(scope="module")
def character():
    return make_character()


def find_places(points, others):
    """Which of other points each point is."""
    return np.array([np.abs(others - point).sum(axis=1).argmin() for point in points])


def list_corners(mesh):
    """The places and texture coordinates of the corners of all triangles, in any order."""
    look, rows = mesh.attributes, []
    for face, polygon in zip(mesh.faces.tolist(), look.triangle_polygons, strict=True):
        start = look.starts[polygon]
        ring = look.corners[start : start + look.corner_counts[polygon]].tolist()
        for vertex in face:
            uv = look.uvs.values[look.uvs.indices[start + ring.index(vertex)]]
            rows.append([*mesh.vertices[vertex], *uv])
    rows = np.array(rows)
    return rows[np.lexsort(rows.round(4).T)]


@pytest.mark.parametrize(
    ("scene", "axes"),
    [(Scene(30.0, 11.0, frame_step=2.0), np.eye(3)), (Scene(25.0, 3.0, "Z", 0.01), UPRIGHT)],
)
def test_a_character_comes_back_with_its_parts(tmp_path, character, scene, axes):
    model, frames = character
    clip = open_sequence([str(write(tmp_path / "a.glb", model, frames, scene=scene))])
    assert len(clip) == len(frames)
    found = clip.scene
    assert (found.fps, found.start, found.frame_step or 1) == (
        scene.fps,
        scene.start,
        scene.frame_step,
    )
    assert clip.first.attributes.parts.names == NAMES
    diagonal = clip.first.diagonal
    for mine, part in zip(split_parts(clip.first), split_parts(model), strict=True):
        look, expected = mine.mesh.attributes, part.mesh.attributes
        assert look.materials.names == expected.materials.names
        np.testing.assert_allclose(look.material_colours, expected.material_colours, rtol=1e-6)
        placed = part.mesh.move(part.mesh.vertices @ axes)
        places = find_places(mine.mesh.vertices, placed.vertices)
        assert sorted(places) == list(range(len(placed.vertices)))
        np.testing.assert_allclose(
            np.array([frame[mine.vertices] for frame in clip]),
            frames[:, part.vertices][:, places] @ axes,
            rtol=0,
            atol=1e-6 * diagonal,
        )
        corners = list_corners(mine.mesh)
        np.testing.assert_allclose(corners, list_corners(placed), rtol=0, atol=1e-6)


@pytest.mark.parametrize("fps", [None, 30.0, 15.0])
def test_a_late_start_comes_back_at_the_rate_that_is_stated(tmp_path, character, fps):
    scene = Scene(30.0, 123_456.0)
    path = write(tmp_path / "a.glb", *character, scene=scene)
    found = open_sequence([str(path)], ClipSettings(fps=fps)).scene
    assert found.start == (0 if fps == 15 else 123_456)


@pytest.mark.parametrize(
    ("command", "same", "member"),
    [
        ("deform cages.h5 -o rig.glb --morphs 6", "", ""),
        ("export cages.h5 rig.glb --with-model", "", "::/cage/model"),
        ("export cages.h5 rig.glb --skeleton --influences 4", "--influences 4", ""),
        ("export cages.h5 rig.glb", None, ""),
    ],
)
def test_what_commands_write_is_read_back(extracted, run, command, same, member):
    outcome = run(*command.split())
    assert outcome.code == 0, outcome.err
    expected = open_sequence(["cages.h5"])
    if same is not None:
        assert run("deform", "cages.h5", "-o", "same.npz", *same.split(), "-q").code == 0
        expected = open_sequence(["same.npz"])
    clip = open_sequence([f"rig.glb{member}"])
    np.testing.assert_array_equal(clip.first.faces, expected.first.faces)
    np.testing.assert_allclose(
        frames_of(clip), frames_of(expected), rtol=0, atol=1e-6 * expected.first.diagonal
    )
    assert clip.scene.start == 1
    mesh = load_mesh(f"rig.glb{member}").mesh
    np.testing.assert_array_equal(mesh.vertices, clip.first.vertices)
