"""Meshes, clips and skins brought from one unit and up axis to another."""

import numpy as np
import pytest

from cageik_cli.formats.base.sequence import ArraySequence
from cageik_cli.formats.base.skeleton import Skin, SkinWeights
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.parts import split_parts
from cageik_cli.util.errors import SettingError
from cageik_cli.util.units import describe_unit, find_units_of_ratio, spell_unit
from tests.character import make_character
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
