"""Meshes, clips and skins brought from one unit and up axis to another."""

import numpy as np
import pygltflib
import pytest

from cageik_cli.formats.base.sequence import ArraySequence
from cageik_cli.formats.base.skeleton import Skin, SkinWeights
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.parts import join_meshes, list_part_names, split_parts
from cageik_cli.util.errors import ConnectivityError, SettingError
from cageik_cli.util.units import describe_unit, find_units_of_ratio, spell_unit
from tests.character import make_character
from tests.clips import frames_of
from tests.formats.scenes import FRAMES, MESH, AlembicScene, UsdScene, translation
from tests.formats.written import write
from tests.shapes import box
from tests.texts import texts

TO_FEET = SceneConversion((0.01, 0.3048), ("Z", "Y"))


def test_heights_stay_heights_and_lengths_lengths():
    points = np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(TO_FEET.apply(points), [[1, 3, -2]] * np.array(0.01 / 0.3048))
    back = SceneConversion(TO_FEET.units[::-1], TO_FEET.axes[::-1])
    np.testing.assert_allclose(back.apply(TO_FEET.apply(points)), points, rtol=1e-15)


def test_a_turn_alone_is_exact_and_proper():
    points = np.random.default_rng(0).normal(size=(4, 7, 3))
    turn = SceneConversion(axes=("Y", "Z"))
    assert np.linalg.det(turn.matrix) == 1
    assert (turn.apply(points) == points @ turn.matrix).all()


def test_parts_are_in_the_other_scene_with_transforms_of_their_own():
    """Points in the space of a part are converted as those in the scene: no part gets a scale."""
    model, frames = make_character()
    converted = TO_FEET.convert_mesh(model)
    for before, after in zip(split_parts(model), split_parts(converted), strict=True):
        own, found = before.select(frames), after.select(TO_FEET.apply(frames))
        np.testing.assert_allclose(found, TO_FEET.apply(own), rtol=0, atol=1e-12)
        scales = [np.linalg.det(part.transform[:3, :3]) for part in (before, after)]
        assert scales[0] == pytest.approx(scales[1], rel=1e-12)
    assert (split_parts(converted)[0].transform == np.eye(4)).all()


def test_a_skin_moves_its_mesh_as_before():
    model, _ = make_character()
    rotation = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    weights, turns = SkinWeights(np.zeros((1, 1), int), np.ones((1, 1))), rotation[None, None]
    converted = TO_FEET.convert_skin(Skin(model, weights, rotation[None], turns))
    np.testing.assert_array_equal(list(converted.turns), converted.rotations[None])
    np.testing.assert_allclose(
        converted.rest.vertices @ converted.rotations[0],
        TO_FEET.apply(model.vertices @ rotation),
        rtol=0,
        atol=1e-12,
    )


def test_a_converted_clip_is_another_clip_to_caches():
    model, frames = make_character()
    clip = ArraySequence(frames, model)
    converted = TO_FEET.convert_clip(clip, "clip")
    assert converted.content_digest(0) != clip.content_digest(0)
    np.testing.assert_array_equal(converted.read_frame(2), TO_FEET.apply(frames[2]))
    assert texts(converted.notes) == ("clip: converted from centimetres, z up to feet, y up",)


def test_only_what_both_state_is_converted():
    given = SceneHints(metres_per_unit=0.01)
    assert not SceneConversion.between(given, SceneHints(up_axis="Z"))
    assert SceneConversion.between(given, SceneHints(up_axis="Z", metres_per_unit=1)).factor == 0.01
    assert not SceneConversion.between(given, SceneHints(metres_per_unit=float(np.float32(0.01))))
    scene = Scene(up_axis="Z", metres_per_unit=0.01)
    assert SceneConversion.of_output(scene, SceneHints.parse("m")).axes == ("Y", "Y")


@pytest.mark.parametrize("text", ["cm", "m,z", "0.0123,y", "ft,z"])
def test_units_are_typed_as_they_are_read(text):
    assert SceneHints.parse(text).option_text == text


@pytest.mark.parametrize("text", ["", "yard", "cm,x", "cm,", "0", "inf", "nan,y"])
def test_other_words_are_refused(text):
    with pytest.raises(SettingError):
        SceneHints.parse(text)


def test_units_have_names():
    assert (spell_unit(0.01), spell_unit(0.5)) == ("cm", "0.5")
    assert (describe_unit(0.0254), describe_unit(0.5)) == ("inches", "units of 0.5 m")
    assert find_units_of_ratio(99, 0.05) == ("m", "cm")
    assert find_units_of_ratio(5, 0.05) is None


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


PLAIN = np.eye(4)
MIRROR = np.diag([-1.0, 1, 1, 1])
TWICE = np.diag([2.0, 2, 2, 1])
STRETCH = np.diag([3.0, 1, 1, 1])
SHEAR = np.eye(4)
SHEAR[0, 1] = 0.5
TURN = np.eye(4)
TURN[:2, :2] = [[0.8, 0.6], [-0.6, 0.8]]
CASES = {
    "mirrored": {"/h/a": PLAIN, "/h/b": MIRROR},
    "sheared": {"/h/a": PLAIN, "/h/b": SHEAR},
    "at the top": {"/a": PLAIN, "/b": TWICE},
    "below each other": {"/h/a": TWICE, "/h/a/b": PLAIN, "/h/a/b/c": STRETCH},
    "stretched in a turned one": {"/h/a": TURN, "/h/a/b": STRETCH @ TURN},
    "sheared by those above": {"/h/a": STRETCH, "/h/a/b": TURN @ STRETCH},
    "sheared below its path": {"/h/a": STRETCH, "/h/a/b": TURN, "/h/a/b/c": TURN},
}
OTHERS = {
    "mirrored": {"/h/b": PLAIN},
    "sheared": {"/h/b": PLAIN},
    "sheared below its path": {"/h/a/b": STRETCH, "/h/a/b/c": STRETCH},
}
"""Transforms that nodes of glTF cannot have: positions are in the space of what is above."""


def make_model(transforms):
    """A box per part, beside each other."""
    meshes = []
    for k, matrix in enumerate(transforms.values()):
        mesh = box() if np.linalg.det(matrix) > 0 else box().flip()
        places = mesh.vertices + np.array([3.0 * k, 0, 0])
        meshes.append(mesh.move(places @ matrix[:3, :3]))
    return join_meshes(meshes, list(transforms), list(transforms.values()))


@pytest.mark.parametrize("suffix", ["usdc", "abc", "glb"])
@pytest.mark.parametrize("case", list(CASES))
def test_places_and_transforms_come_back(tmp_path, case, suffix):
    model = make_model(CASES[case])
    frames = np.stack([model.vertices * (1 + 0.1 * k) for k in range(3)])
    clip = open_sequence([str(write(tmp_path / f"a.{suffix}", model, frames))])
    for k in range(3):
        np.testing.assert_allclose(clip.read_positions(k), frames[k], rtol=0, atol=2e-6)
    assert clip.first.volume == pytest.approx(model.volume, rel=1e-6)  # faces are not turned
    for part, (name, matrix) in zip(split_parts(clip.first), CASES[case].items(), strict=True):
        assert part.name == name
        kept = OTHERS.get(case, {}).get(name, matrix) if suffix == "glb" else matrix
        np.testing.assert_allclose(part.transform, kept, atol=1e-12)


@pytest.mark.parametrize("case", list(CASES))
def test_nodes_of_gltf_are_moved_turned_and_scaled_only(tmp_path, case):
    """As the specification wants it: the axes of each node are at right angles."""
    model = make_model(CASES[case])
    path = write(tmp_path / "a.glb", model, model.vertices[None])
    matrices = [node.matrix for node in pygltflib.GLTF2().load(path).nodes if node.matrix]
    assert matrices or case in ("mirrored", "sheared")
    for matrix in matrices:
        axes = np.reshape(matrix, (4, 4))[:3, :3]
        products = axes @ axes.T
        assert np.abs(products - np.diag(np.diag(products))).max() < 1e-9


@pytest.mark.parametrize("suffix", ["usdc", "abc", "glb", "obj"])
def test_names_that_would_be_one_place_stay_apart(tmp_path, suffix):
    names = ["body", "/body", "/", "a//b", "a/b", "a b", "/ä"]
    model = make_model(dict.fromkeys(names, PLAIN))
    path = tmp_path / ("a_####.obj" if suffix == "obj" else f"a.{suffix}")
    if suffix == "obj":
        path = tmp_path / "out" / path.name
    frames = np.stack([model.vertices, 2 * model.vertices])
    write(path, model, frames)
    clip = open_sequence([str(path.parent if suffix == "obj" else path)])
    assert len(set(list_part_names(clip.first))) == len(names)
    assert len(clip.first.vertices) == len(model.vertices)
    assert clip.first.volume == pytest.approx(model.volume, rel=1e-6)
