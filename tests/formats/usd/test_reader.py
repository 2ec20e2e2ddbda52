"""Clips in USD: files that usd-core wrote, in every way that scenes differ."""

import hashlib
import shutil

import numpy as np
import pytest
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.usd import library
from cageik_cli.formats.usd.library import capture_diagnostics
from cageik_cli.geometry.parts import list_part_names
from cageik_cli.util.errors import FormatError, InputError
from tests.character import NAMES
from tests.clips import frames_of
from tests.formats.scenes import FRAMES, MESH, UsdScene
from tests.texts import texts


@pytest.fixture
def scene(tmp_path):
    return UsdScene(tmp_path)


NESTED = {
    "braces": ('def "a" {', "}"),
    "braces behind the name of a file": ("def \"a\" (payload = @'@) { # '\n", "}"),
    "round brackets": ("(1, ", ")"),
    "square brackets": ("[", "]"),
}


@pytest.mark.parametrize("kind", NESTED)
def test_what_is_nested_too_deeply_is_refused_before_usd_crashes(tmp_path, kind):
    begin, end = NESTED[kind]
    deep = begin * (library.MAX_NESTING + 1) + end * (library.MAX_NESTING + 1)
    path = tmp_path / "clip.usda"
    path.write_text(f"#usda 1.0\n{deep}\n")
    with pytest.raises(FormatError, match=r"clip\.usda: is nested more than 500 levels deep"):
        open_sequence([str(path)])
    above = tmp_path / "above.usda"
    above.write_text("#usda 1.0\n(subLayers = [@clip.usda@])\n")
    with pytest.raises(FormatError, match=r"clip\.usda: is nested more than 500 levels deep"):
        open_sequence([str(above)])


def test_brackets_in_texts_and_comments_are_no_nesting(scene):
    scene.mesh()
    scene.stage.GetRootLayer().comment = "{" * 600
    scene.stage.GetRootLayer().documentation = "\n'{\"" * 600
    assert len(scene.opened()) == len(FRAMES)


def test_references_that_multiply_prims_are_refused(scene, monkeypatch):
    """One root, two prims of a class, and three of each of its four copies."""
    scene.places["proto"] = str(scene.stage.CreateClassPrim("/proto").GetPath())
    scene.mesh(parent="proto")
    for k in range(4):
        copy = scene.stage.DefinePrim(f"/copy_{k}", "Xform")
        copy.GetReferences().AddInternalReference("/proto")
    monkeypatch.setattr(library, "MAX_PRIMS", 15)
    assert len(scene.opened().first.attributes.parts.names) == 4
    monkeypatch.setattr(library, "MAX_PRIMS", 14)
    assert scene.refused().startswith("its references make more than 14 prims")


def test_a_file_that_has_changed_is_read_as_it_is_now(scene):
    """USD keeps a layer as long as something holds it, such as the clip that was opened before."""
    scene.mesh()
    before = scene.opened()
    text = scene.path.read_text()
    assert 'def Mesh "mesh"' in text
    scene.path.write_text(text.replace('def Mesh "mesh"', 'def Mesh "other" {}\ndef Mesh "mesh"'))
    assert scene.refused().startswith("/other")
    scene.path.write_text(text)
    assert len(scene.opened()) == len(before)


def test_faces_that_unpack_to_far_more_than_the_file_are_refused(tmp_path):
    scene = UsdScene(tmp_path, "clip.usdc")
    mesh = scene.mesh()
    mesh.GetFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(np.full(10**6, 3, np.int32)))
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(np.zeros(3 * 10**6, np.int32)))
    with pytest.raises(FormatError, match=r"`faceVertexCounts`: takes at least 4000000 bytes"):
        scene.opened()


def test_the_scene_is_what_the_stage_says(scene):
    scene.mesh(times=(5, 6, 7, 8))
    assert scene.opened().scene == SceneHints(start=5.0)
    scene.stage.SetTimeCodesPerSecond(30)
    UsdGeom.SetStageUpAxis(scene.stage, "Z")
    UsdGeom.SetStageMetersPerUnit(scene.stage, 0.01)
    assert scene.opened().scene == SceneHints(30.0, 5.0, "Z", 0.01)
    assert scene.opened(selection=slice(1, None, 2)).scene == SceneHints(
        30.0, 6.0, "Z", 0.01, frame_step=2.0
    )


def test_frames_a_second_alone_are_time_codes_a_second_too(scene):
    scene.mesh()
    scene.stage.SetFramesPerSecond(12)
    assert scene.opened().scene.fps == 12


def test_time_codes_between_samples_are_the_step_of_frame_numbers(scene):
    scene.mesh(times=(1, 6, 11, 16))
    scene.stage.SetTimeCodesPerSecond(30)
    sequence = scene.opened()
    assert (len(sequence), sequence.scene) == (4, SceneHints(30.0, 1.0, frame_step=5.0))


def test_uneven_samples_are_taken_at_whole_time_codes(scene):
    scene.mesh(times=(0.5, 1, 4, 5.5))
    scene.stage.SetTimeCodesPerSecond(30)
    sequence = scene.opened()
    (note,) = texts(sequence.notes)
    assert note.startswith(
        "clip.usda: its 4 time samples are not evenly spaced; frames are at the whole"
    )
    thirds = [FRAMES[1] + part * (FRAMES[2] - FRAMES[1]) for part in (0, 1 / 3, 2 / 3, 1)]
    fifth = FRAMES[2] + (FRAMES[3] - FRAMES[2]) / 1.5
    np.testing.assert_allclose(frames_of(sequence), [*thirds, fifth], atol=1e-6)
    assert (sequence.scene.fps, sequence.scene.start) == (30.0, 1.0)


@pytest.mark.parametrize("times", [(0, 1, 1e9), (0.1, 0.2, 0.7)])
def test_a_span_of_uneven_samples_is_bounded(scene, times):
    scene.mesh(times=times)
    assert scene.refused().endswith("expected 1 to 100000; bake it to one sample per frame")


def test_as_many_whole_codes_as_the_bound_are_taken(scene, monkeypatch):
    monkeypatch.setattr("cageik_cli.formats.usd.reader.MAX_TIME_CODES", 5)
    scene.mesh(times=(1, 2, 5))
    assert len(scene.opened()) == 5


@pytest.mark.parametrize("is_left", [False, True])
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_faces_turn_outward_whatever_turns_them(scene, is_left, is_mirrored):
    """What faces outward in its own space does so in a mirror, whose faces then turn."""
    faces = MESH.faces[:, ::-1] if is_left else MESH.faces
    mesh = scene.mesh(frames=[MESH.vertices], times=(1,), faces=faces)
    if is_left:
        mesh.CreateOrientationAttr("leftHanded")
    if is_mirrored:
        mesh.AddScaleOp().Set((-1, 1, 1))
    sequence = scene.opened()
    np.testing.assert_allclose(sequence.first.volume, MESH.volume, rtol=1e-6)
    assert ("clip.usda: left-handed faces turned" in texts(sequence.notes)) == is_left


def test_a_mesh_in_an_instance_is_found(scene):
    scene.places["proto"] = str(scene.stage.CreateClassPrim("/proto").GetPath())
    scene.mesh(parent="proto")
    one = scene.stage.DefinePrim("/one", "Xform")
    one.GetReferences().AddInternalReference("/proto")
    one.SetInstanceable(True)
    sequence = scene.opened()
    np.testing.assert_array_equal(frames_of(sequence), FRAMES)


def test_faces_that_change_are_refused(scene):
    mesh = scene.mesh()
    corners = MESH.faces.ravel().tolist()
    mesh.GetFaceVertexIndicesAttr().Set(corners, 1)
    mesh.GetFaceVertexIndicesAttr().Set(corners, 2)
    assert len(scene.opened()) == 4
    mesh.GetFaceVertexIndicesAttr().Set(corners[::-1], 3)
    assert scene.refused().startswith("/mesh: the faces change at time 3; all frames must")


def no_points(scene):
    scene.mesh(frames=[], times=(1,))


def blocked_points(scene):
    scene.mesh().GetPointsAttr().Set(Sdf.ValueBlock(), 2)


def points_of_text(scene):
    scene.mesh()
    points = scene.stage.GetRootLayer().GetPrimAtPath("/mesh").properties["points"]
    scene.stage.GetRootLayer().GetPrimAtPath("/mesh").RemoveProperty(points)
    Sdf.AttributeSpec(
        scene.stage.GetRootLayer().GetPrimAtPath("/mesh"), "points", Sdf.ValueTypeNames.String
    ).default = "none"


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (no_points, "the mesh has no points at time"),
        (blocked_points, "the mesh has no points at time 2; export it again"),
        (points_of_text, "`points` is not of type point3f[] at time 0; export it again"),
    ],
)
def test_what_makes_no_clip_is_a_sentence(scene, spoil, sentence):
    spoil(scene)
    assert sentence in scene.refused()


def test_a_mirror_as_thin_as_a_plane_is_no_error(scene):
    scene.mesh().AddScaleOp().Set(Gf.Vec3f(1, 1, 0))
    assert (frames_of(scene.opened())[..., 2] == 0).all()


def test_what_usd_warns_of_is_noted_and_not_printed(scene, tmp_path, capfd):
    scene.mesh()
    scene.close()
    path = tmp_path / "shot.usda"
    path.write_text("#usda 1.0\n(\n    subLayers = [@clip.usda@, @gone.usda@]\n)\n")
    assert texts(open_sequence([str(path)]).notes) == (
        "warning: shot.usda: has the sublayer gone.usda, which is not there; it is left out",
    )
    assert capfd.readouterr().err == ""


def test_a_file_that_was_written_again_is_read_again(tmp_path):
    """While a clip of what it was is still open: USD keeps layers by their paths."""
    older = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        scene = UsdScene(tmp_path / name, "clip.usdc")
        scene.mesh(name)
        scene.close()
        (tmp_path / "clip.usdc").unlink(missing_ok=True)
        (tmp_path / name / "clip.usdc").rename(tmp_path / "clip.usdc")
        older.append(open_sequence([str(tmp_path / "clip.usdc")]))
    assert [clip.first.attributes.parts.names for clip in older] == [("/first",), ("/second",)]


def test_the_digest_is_over_all_files_that_a_stage_is_made_of(tmp_path, scene):
    scene.mesh()
    scene.close()
    shot = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    shot.GetRootLayer().subLayerPaths.append("clip.usda")
    shot.GetRootLayer().Save()
    path = tmp_path / "shot.usda"
    files = b"".join(
        hashlib.sha256(file.read_bytes()).digest() for file in (path, tmp_path / "clip.usda")
    )
    assert open_sequence([str(path)]).describe_source() == {
        "name": "shot.usda",
        "sha256": hashlib.sha256(files).hexdigest(),
        "files": 2,
    }


SINGLE = 2e-6
"""Of the diagonal: sums of joints in single precision."""


@pytest.fixture
def hero(character_result, tmp_path, monkeypatch):
    """The folder of the result of the character of four parts."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(character_result.path, tmp_path / "cages.h5")
    return tmp_path


def compare(run, command, same, member="", names=None):
    """Run a command; what its file holds is what `deform` gives, or the cages if that is None."""
    outcome = run(*command.split(), "--overwrite")
    assert outcome.code == 0, outcome.err
    expected = open_sequence(["cages.h5"])
    if same is not None:
        words = ("deform", "cages.h5", "-o", "same.npz", "-q", "--overwrite")
        assert run(*words, *same.split()).code == 0
        expected = open_sequence(["same.npz"])
    clip = open_sequence([f"rig.usdc{member}"])
    np.testing.assert_array_equal(clip.first.faces, expected.first.faces)
    np.testing.assert_allclose(
        frames_of(clip), frames_of(expected), rtol=0, atol=SINGLE * expected.first.diagonal
    )
    assert clip.scene.start == 1
    assert names is None or list_part_names(clip.first) == names
    return clip


@pytest.mark.usefixtures("input_elsewhere")
@pytest.mark.parametrize(
    ("command", "same", "member"),
    [
        ("deform cages.h5 -o rig.usdc", "", ""),
        ("export cages.h5 rig.usdc --with-model", "", "::/cage/model"),
        ("export cages.h5 rig.usdc --with-model", None, "::/cage/cage"),
        ("export cages.h5 rig.usdc --skeleton --influences 4", "--influences 4", ""),
        (
            "export cages.h5 rig.usdc --skeleton --influences 4 --with-model",
            "--influences 4",
            "::/cage/mesh",
        ),
    ],
)
def test_what_commands_write_is_read_back(extracted, run, command, same, member):
    clip = compare(run, command, same, member)
    mesh = load_mesh(f"rig.usdc{member}").mesh
    np.testing.assert_array_equal(mesh.vertices, clip.first.vertices)


@pytest.mark.usefixtures("input_elsewhere")
def test_a_guide_is_left_out(extracted, run):
    command = "export cages.h5 rig.usdc --skeleton --influences 4 --with-model --guide"
    clip = compare(run, command, "--influences 4")
    assert "rig.usdc: left out /cage/cage (purpose guide)" in texts(clip.notes)


def test_a_character_is_read_back_in_its_parts(hero, run):
    compare(run, "deform cages.h5 -o rig.usdc", "", names=NAMES)
    skeleton = "export cages.h5 rig.usdc --skeleton --influences 4"
    clip = compare(run, skeleton, "--influences 4", names=NAMES)
    assert "rig.usdc: posed by the skeleton /hero/skeleton" in texts(clip.notes)
    compare(run, f"{skeleton} --with-model --guide", "--influences 4", names=NAMES)
    compare(run, "export cages.h5 rig.usdc --with-model --guide", "", names=NAMES)


def test_warnings_are_kept_without_folders_and_addresses(capfd):
    with capture_diagnostics(InputError) as warnings:
        Tf.Warn("Could not load @/home/me/a.usda@\n (Opening stage on stage @/b@ <0x7f>)")
        assert warnings == []
    assert warnings == ["USD warns: Could not load a.usda"]
    assert capfd.readouterr().err == ""


def test_errors_become_the_given_one(capfd):
    with pytest.raises(InputError) as caught, capture_diagnostics(InputError):
        Tf.RaiseRuntimeError("@/x/a.usda@:1: parse error matching pxrInternal::Rule at 'x'")
    assert str(caught.value) == "Python runtime error: a.usda:1: parse error at 'x'"
    assert capfd.readouterr().err == ""


def test_warnings_before_an_error_are_not_printed(capfd):
    def warn_and_fail():
        Tf.Warn("first")
        Tf.RaiseRuntimeError("then")

    with pytest.raises(InputError), capture_diagnostics(InputError):
        warn_and_fail()
    assert capfd.readouterr().err == ""


def test_names_that_are_not_text_are_an_error_too():
    with pytest.raises(InputError, match="its text is not UTF-8"), capture_diagnostics(InputError):
        b"\xb8".decode()


def test_other_errors_pass():
    with pytest.raises(KeyError), capture_diagnostics(InputError):
        raise KeyError
