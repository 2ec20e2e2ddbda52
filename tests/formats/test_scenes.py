"""A mesh in a scene, in USD as in Alembic: where it is, which one it is, and its faces."""

import numpy as np
import pytest

from cageik_cli.util.errors import ConnectivityError
from tests.clips import frames_of
from tests.formats.scenes import FRAMES, MESH, AlembicScene, UsdScene, translation
from tests.texts import texts


@pytest.fixture(params=[UsdScene, AlembicScene])
def scene(request, tmp_path):
    return request.param(tmp_path)


def test_points_are_moved_by_all_transforms_above(scene):
    turn = [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]  # x to y, y to -x
    scene.transform([translation(1, 2, 3)], "outer")
    scene.transform([turn], "turn", "outer")
    scene.mesh(parent="turn")
    sequence = scene.opened()
    x, y, z = FRAMES.astype(float).transpose(2, 0, 1)
    expected = np.stack([1 - y, 2 + x, 3 + z], axis=2)
    np.testing.assert_allclose(frames_of(sequence), expected, rtol=0, atol=1e-15)
    note = f"{scene.path.name}: moved by a transform into the scene's space"
    assert texts(sequence.notes) == (note,)


def test_a_transform_may_leave_those_above(scene):
    scene.transform([translation(k, 2, 3) for k in range(4)], "outer")
    scene.transform([translation(0, 0, 1)], "inner", "outer", inherits=False)
    scene.mesh(parent="inner")
    shifted = FRAMES + np.array([0, 0, 1.0])
    np.testing.assert_allclose(frames_of(scene.opened()), shifted, rtol=1e-15)


def test_a_mesh_moved_by_its_parent_alone(scene):
    scene.transform([translation(k, 0, 0) for k in range(3)])
    scene.mesh(parent="move", frames=FRAMES[:1])
    sequence = scene.opened()
    expected = [FRAMES[0] + np.array([float(k), 0, 0]) for k in range(3)]
    np.testing.assert_allclose(frames_of(sequence), expected, rtol=1e-15)
    note = f"{scene.path.name}: moved by an animated transform into the scene's space"
    assert texts(sequence.notes) == (note,)
    assert sequence.scene.start == 1


def test_faces_of_a_mirrored_mesh_turn(scene):
    scene.transform([np.diag([-1, 1, 1, 1])])
    scene.mesh(parent="move", frames=[MESH.vertices])
    np.testing.assert_allclose(scene.opened().first.volume, MESH.volume, rtol=1e-6)


def test_polygons_are_cut_and_compared_as_fans(scene):
    corners = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [1.5, 0.5, 0], [3, 3, 0]])
    scene.mesh(frames=[corners], faces=[[0, 1, 2, 3], [2, 1, 4]])
    sequence = scene.opened()
    assert sequence.first.fan_triangulated.faces.tolist() == [[0, 1, 2], [0, 2, 3], [2, 1, 4]]
    a, b, c = (sequence.first.vertices[corner] for corner in sequence.first.faces[:2].T)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    note = f"{scene.path.name}: 1 polygon cut into triangles to compute with"
    assert texts(sequence.notes) == (note,)


@pytest.fixture
def clothed(scene):
    """A scene of a mesh that moves, and a static hat and shoe that are moved to x = 1."""
    scene.mesh()
    scene.transform([translation(1, 0, 0)])
    scene.mesh("hat", "move", frames=FRAMES[:1])
    scene.mesh("shoe", "move", frames=FRAMES[:1])
    return scene


def test_several_meshes_are_parts_of_one(clothed):
    sequence = clothed.opened()
    parts = sequence.first.attributes.parts
    assert parts.names == ("/mesh", "/move/hat", "/move/shoe")
    assert parts.vertex_counts.tolist() == [6, 6, 6]
    np.testing.assert_array_equal(parts.transforms[1], translation(1, 0, 0))
    still = np.tile(FRAMES[0] + np.array([1.0, 0, 0]), (len(FRAMES), 1, 1))
    expected = np.concatenate([FRAMES, still, still], axis=1)
    np.testing.assert_array_equal(frames_of(sequence), expected)
    assert texts(sequence.notes) == (
        f"{clothed.path.name}: /move/hat, /move/shoe: moved by a transform into the scene's space",
    )


@pytest.mark.parametrize(
    ("member", "exclude", "names"),
    [
        ("::/move/hat", (), ["/move/hat"]),
        ("::/move", (), ["/move/hat", "/move/shoe"]),
        ("::/move/", (), ["/move/hat", "/move/shoe"]),
        ("", ("/move",), ["/mesh"]),
        ("", ("sh*",), ["/mesh", "/move/hat"]),
        ("", ("/move/s*", "mesh"), ["/move/hat"]),
    ],
)
def test_meshes_are_chosen_by_paths_and_patterns(clothed, member, exclude, names):
    sequence = clothed.opened(member, exclude=exclude)
    assert list(sequence.first.attributes.parts.names) == names
    assert len(frames_of(sequence)[0]) == 6 * len(names)


@pytest.mark.parametrize(
    ("member", "exclude", "says"),
    [
        ("::/boot", (), "no mesh `/boot`; choose one of /mesh, /move/hat, /move/shoe"),
        ("::/mov", (), "no mesh `/mov`"),
        ("", ("boot",), "`exclude=boot` matches none of its meshes: /mesh"),
        ("", ("*",), "leaves none"),
    ],
)
def test_a_choice_of_no_mesh_is_refused(clothed, member, exclude, says):
    assert says in clothed.refused(member, exclude=exclude)


def test_a_part_whose_vertices_change_in_number_is_named(scene):
    scene.mesh("one", frames=[*FRAMES[:2], FRAMES[2][:5]])
    scene.mesh("two", frames=[*FRAMES[:2], np.vstack([FRAMES[2], FRAMES[2][:1]])])
    with pytest.raises(ConnectivityError, match="5 vertices of /one, the rest pose has 6"):
        frames_of(scene.opened())


def test_a_scene_without_a_mesh_is_refused(scene):
    scene.transform([np.eye(4)])
    assert scene.refused().startswith("holds no mesh")


def test_vertices_that_change_in_number_are_refused(scene):
    scene.mesh(frames=[*FRAMES[:2], FRAMES[2][:5]])
    with pytest.raises(ConnectivityError, match=r"clip\.\w+\[3\]: 5 vertices of /mesh"):
        frames_of(scene.opened())


@pytest.mark.parametrize(
    ("faces", "says"),
    [
        ([], "0 faces need 0 corners"),
        ([[0, 1, 6]], "(counted from 0), but there are 6"),
    ],
)
def test_faces_that_make_no_mesh_are_refused(scene, faces, says):
    scene.mesh(faces=faces)
    assert says in scene.refused()
