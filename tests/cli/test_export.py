"""`cageik export`: the cages of a result, in the formats of others."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.write import DEFAULT_FORMAT, Output, frame_formats
from cageik_cli.run import export as exporting
from cageik_cli.store.result import read_result
from tests.clips import frames_of
from tests.conftest import EXTRACT
from tests.formats.clips import faults_of
from tests.formats.gltf.decoded import Glb


@pytest.fixture
def result(run, folder):
    """A result with a scene of its own."""
    assert run(*EXTRACT, "--fps", "30", "--start", "7", "--up-axis", "Z",
               "--metres-per-unit", "0.01").code == 0  # fmt: skip
    return folder


def verts(path="cages.h5"):
    with h5py.File(path) as file:
        return file["verts"][:]


def test_one_line_says_what_was_written(run, result):
    outcome = run("export", "cages.h5", "cage.npz")
    size = Path("cage.npz").stat().st_size
    assert (outcome.code, outcome.out) == (0, "")
    assert outcome.err == f"wrote cage.npz: 5 frames of 8 vertices, {size / 1000:.3g} kB\n"
    assert run("export", "cages.h5", "other.npz", "-q").err == ""


def test_what_to_mind_stands_below(run, result):
    first, *notes = run("export", "cages.h5", "c.pc2").err.splitlines()
    assert first.startswith("wrote c.pc2: 5 frames of 8 vertices, 512 bytes")
    assert notes == [
        "  note           c.pc2: Blender's Mesh Cache puts the first frame at scene frame 0; "
        "set its Frame Start to 7"
    ]


@pytest.mark.parametrize(
    ("out", "tolerance"),
    [
        ("c.npz", 0),
        ("c/c_####.ply", 0),
        ("c/c.$F3.obj", 1e-8),
        ("c", 1e-8),
        ("c.usdc", 1e-6),
        ("c.abc", 1e-6),
    ],
)
def test_the_cages_come_back(run, result, out, tolerance):
    """Read in the space of the result, whose scene is in centimetres with z up."""
    assert run("export", "cages.h5", out).code == 0
    clip = open_sequence([str(Output(Path(out)).target_path)])
    np.testing.assert_allclose(frames_of(clip), verts(), rtol=0, atol=tolerance)
    with h5py.File("cages.h5") as file:
        np.testing.assert_array_equal(clip.first.faces, file["tris"][:])


@pytest.mark.parametrize(
    ("words", "scene"),
    [
        ("", [30, 7, "Z", 0.01]),
        ("--fps 25 --start 0 --up-axis Y --metres-per-unit 1", [25, 0, "Y", 1]),
    ],
)
def test_the_scene_is_the_results_unless_options_say_more(run, result, words, scene):
    assert run("export", "cages.h5", "c.npz", *words.split()).code == 0
    with np.load("c.npz") as file:
        found = [file[name].item() for name in ("fps", "start", "up_axis", "metres_per_unit")]
    assert found == scene


def test_files_are_numbered_from_the_scenes_start(run, result):
    assert run("export", "cages.h5", "c", "--format", "ply").code == 0
    assert sorted(p.name for p in Path("c").iterdir()) == [f"c_{k:04d}.ply" for k in range(7, 12)]
    assert run("export", "cages.h5", "d/x.%03d.obj", "--start", "0").code == 0
    assert sorted(p.name for p in Path("d").iterdir()) == [f"x.{k:03d}.obj" for k in range(5)]


def test_the_cage_of_a_glb_moves_as_the_results(run, result):
    assert run("export", "cages.h5", "c.glb").code == 0
    file = Glb(Path("c.glb"))
    _, frames = file.frames()
    np.testing.assert_allclose(frames, verts(), rtol=0, atol=1e-6)
    assert file.json["nodes"][0]["name"] == "cage"


def test_options_of_morph_targets_reach_the_writer(run, result):
    outcome = run("export", "cages.h5", "c.glb", "--morphs", "2")
    assert outcome.code == 0, outcome.err
    note = outcome.err.splitlines()[-1]
    assert note.startswith("  note           c.glb: 2 morph targets; error: rms ")
    assert run("export", "cages.h5", "c.glb", "--tolerance", "0.5", "--overwrite").code == 0
    extras = Glb(Path("c.glb")).json["meshes"][0]["extras"]["cageik"]
    assert extras["largest_percent"] <= 0.5
    again = Path("c.glb").read_bytes()
    assert run("export", "cages.h5", "c.glb", "--tolerance", "0.5%", "--overwrite").code == 0
    assert Path("c.glb").read_bytes() == again


def test_a_cage_has_no_normals(run, result):
    """It is to look like what it is: flat faces."""
    assert run("export", "cages.h5", "c.glb").code == 0
    assert set(Glb(Path("c.glb")).primitives[0]["attributes"]) == {"POSITION"}


def test_blocks_of_cages_change_nothing(run, result, monkeypatch):
    outputs = ("a.npz", "a.glb", "a.mdd", "a/a_#.obj")
    for name in outputs:
        assert run("export", "cages.h5", name).code == 0
    monkeypatch.setattr(exporting, "MAX_EXPORT_BYTES", 2 * 8 * 24)
    for name in outputs:
        assert run("export", "cages.h5", name.replace("a", "b")).code == 0
    for name in outputs[:3]:
        assert Path(name).read_bytes() == Path(name.replace("a", "b")).read_bytes()
    for path in Path("a").iterdir():
        assert path.read_bytes() == Path("b", path.name.replace("a", "b")).read_bytes()


def test_a_skeleton_says_what_it_costs(run, result):
    outcome = run("export", "cages.h5", "c.usda", "--skeleton")
    assert outcome.code == 0, outcome.err
    first, *notes = outcome.err.splitlines()
    note = " ".join(" ".join(notes).split())
    assert first.startswith("wrote c.usda: 5 frames of 11 joints that move 18 vertices, ")
    assert note.startswith(
        "note c.usda: 11 joints (root, 2 limbs, 8 that move the mesh); up to 8 influences"
    )
    assert "degrees off (rms), 1 % of them more than " in note
    assert "def Skeleton" in Path("c.usda").read_text()
    words = ["--skeleton", "--influences", "3", "--overwrite"]
    outcome = run("export", "cages.h5", "c.usda", *words)
    note = " ".join(outcome.err.split())
    assert "; up to 3 influences per vertex; against the input, an rms of " in note
    Path("frames").rename(Path("..") / "away")
    outcome = run("export", "cages.h5", "c.usda", *words)
    note = " ".join(outcome.err.split())
    assert "; up to 3 influences per vertex; it adds an rms of " in note
    assert "; against the input, the rms is at most " in note
    assert "degrees off (rms), 1 % of them more than " in note
    added, total = (float(x) for x in re.findall(r"rms (?:of|is at most) (\S+) %", outcome.err))
    known = read_result(Path("cages.h5"))
    own = 100 * np.sqrt(np.mean(known.metrics.rms**2)) / known.rest.diagonal
    assert total == pytest.approx(own + added, rel=0.1)


def test_only_a_file_whose_normals_turn_says_how_far_they_are_off(run, result):
    for suffix in (".glb", ".usdc"):
        words = ("export", "cages.h5", f"c{suffix}", "--skeleton", "--influences", "3")
        assert "degrees off" in " ".join(run(*words).err.split())
        outcome = run(*words, "--joints", "translate", "--overwrite")
        assert "up to 3 influences per vertex" in " ".join(outcome.err.split())
        assert "normals" not in outcome.err


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_one_mesh_file_is_the_rest_cage(run, result, suffix):
    outcome = run("export", "cages.h5", f"rest{suffix}")
    assert outcome.code == 0, outcome.err
    assert f"rest/rest_####{suffix} writes all 5 frames" in outcome.err
    expected = read_result(Path("cages.h5")).cage.vertices
    np.testing.assert_allclose(load_mesh(Path(f"rest{suffix}")).mesh.vertices, expected, rtol=1e-6)
    assert f"rest{suffix}: exists already" in run("export", "cages.h5", f"rest{suffix}").err


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--with-model"], "--with-model; leave it out"),
        (["--recentre"], "--recentre; leave it out"),
        (["--format", "ply"], "--format ply; leave it out"),
        (["--fps", "30", "--start", "5"], "--fps or --start; leave them out"),
        (["--frame-step", "2"], "--frame-step; leave it out"),
        (["--skeleton"], "--skeleton works with USD and glTF only"),
        (["--morphs", "4"], "--morphs and --tolerance apply to .glb files"),
    ],
)
def test_the_rest_cage_takes_no_option_of_frames(run, result, words, named):
    """A refusal names it: without the option, the cage alone is written."""
    outcome = run("export", "cages.h5", "rest.obj", *words)
    assert (outcome.code != 0, Path("rest.obj").exists()) == (True, False)
    assert named in outcome.err
    if "leave" in named:
        assert "is the cage at rest alone" in outcome.err
        assert "rest/rest_####.obj" in outcome.err
        frames = ["--format", "obj"] if "--format" in words else words
        folder = "rest" if "--format" in words else "rest/rest_####.obj"
        assert run("export", "cages.h5", folder, *frames).code == 0


def test_another_output_of_extract_names_its_option(run, result):
    outcome = run("extract", "frames", "--cage", "cage.obj", "-o", "x.usdc")
    assert (outcome.code, "--export x.usdc" in outcome.err) == (1, True)


def test_more_numbers_of_influences_are_compared_when_asked(run, result):
    outcome = run("export", "cages.h5", "c.usda", "--skeleton", "--influences", "2", "-v")
    line = outcome.err.splitlines()[-2]
    assert line.split()[:2] == ["influences", "rms"]
    assert "4: " in line
    assert "8: " in line
    assert "16: " not in line  # the cage has 8 vertices


@pytest.mark.parametrize(
    ("name", "words", "named"),
    [
        ("c.glb", ["--joints", "12"], "has 4 joints at least and 11 at most; give 4 to 11"),
        ("c.usdc", ["--joints", "3"], "--joints 3, and the skeleton of a cage of 8 vertices has 4"),
        ("c.glb", ["--joints", "4", "--root-motion", "extract"], "give 5 to 12"),
        ("c.usdc", ["--joints", "4", "--with-model"], "are not the vertices of the cage"),
        ("c.usdc", ["--tolerance", "0.1"], "--morphs and --tolerance apply to .glb"),
        ("c.usdc", ["--quantize"], "--quantize of a skeleton works with glTF only"),
    ],
)
def test_options_of_skeletons_that_cannot_be_are_refused(run, result, name, words, named):
    outcome = run("export", "cages.h5", name, "--skeleton", *words)
    assert outcome.code != 0
    assert named in " ".join(outcome.err.split())
    assert not Path(name).exists()


@pytest.mark.parametrize("words", [["--joints", "4"], ["--root-motion", "extract"], ["--quantize"]])
def test_options_of_skeletons_need_one(run, result, words):
    outcome = run("export", "cages.h5", "c.glb", *words)
    assert (outcome.code, "needs --skeleton" in outcome.err) == (2, True)


def test_joints_are_a_word_or_a_number(run, result):
    outcome = run("export", "cages.h5", "c.glb", "--skeleton", "--joints", "bend")
    assert outcome.code == 2
    assert "a number of joints above 0, turn, or translate" in outcome.err


@pytest.mark.parametrize("suffix", [".glb", ".usda"])
def test_the_root_can_be_extracted(run, result, suffix):
    words = ("export", "cages.h5", f"c{suffix}", "--skeleton", "--influences", "4")
    assert run(*words).code == 0
    kept = Path(f"c{suffix}").read_bytes()
    assert run(*words, "--root-motion", "extract", "--overwrite").code == 0
    found = Path(f"c{suffix}").read_bytes()
    assert (b"body" in kept, b"body" in found) == (False, True)


def test_a_small_skeleton_is_smaller_and_says_what_that_costs(run, result):
    words = ("export", "cages.h5", "c.glb", "--skeleton", "--influences", "4", "--overwrite")
    sizes = []
    for more in (["--tolerance", "5"], ["--quantize", "--tolerance", "5"], ["--quantize"]):
        outcome = run(*words, *more)
        assert outcome.code == 0, outcome.err
        assert ("numbers are rounded" in " ".join(outcome.err.split())) == ("--quantize" in more)
        assert ("keys are kept" in " ".join(outcome.err.split())) == ("--tolerance" in more)
        sizes.append(Path("c.glb").stat().st_size)
    assert max(sizes[1:]) < sizes[0]


def test_kinds_of_frames_are_the_writers_own():
    assert set(frame_formats()) == {"obj", "ply"}
    assert DEFAULT_FORMAT in frame_formats()


def test_extract_exports_too(run, folder):
    outcome = run(*EXTRACT[:-1], "--export", "c.npz", "--export", "c/c_####.obj", "--fps", "30")
    assert outcome.code == 0, outcome.err
    lines = outcome.err.splitlines()
    assert lines[-5].startswith("wrote c.npz: 5 frames of 8 vertices, ")
    assert lines[-4].startswith("wrote c/c_####.obj: 5 frames of 8 vertices, ")
    assert lines[-3] == "wrote cages.h5"
    assert run("export", "cages.h5", "later.npz").code == 0
    assert Path("c.npz").read_bytes() == Path("later.npz").read_bytes()
    assert len(list(Path("c").iterdir())) == 5


@pytest.mark.parametrize(
    ("value", "made"), [('"c.npz"', ["c.npz"]), ('["c.npz", "d.pc2"]', ["c.npz", "d.pc2"])]
)
def test_a_file_may_hold_one_export_or_several(run, folder, value, made):
    Path("cageik.toml").write_text(f"[extract]\nexport = {value}\n")
    before = set(folder.iterdir())
    assert run(*EXTRACT, "--config", "cageik.toml").code == 0
    assert {p.name for p in set(folder.iterdir()) - before} == {"cages.h5", *made}


@pytest.mark.parametrize("value", ["5", '[["c.npz"]]'])
def test_other_values_of_export_are_wrong_usage(run, folder, value):
    Path("cageik.toml").write_text(f"[extract]\nexport = {value}\n")
    outcome = run(*EXTRACT, "--config", "cageik.toml")
    assert outcome.code == 2
    assert "is not a value of --export" in outcome.err


def read_stage(path):
    """Purposes, and the points of the meshes below the default prim at frame 9, by name."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(path)
    meshes = [UsdGeom.Mesh(p) for p in stage.GetDefaultPrim().GetChildren() if p.IsA(UsdGeom.Mesh)]
    return {
        mesh.GetPrim().GetName(): (
            mesh.ComputePurpose(),
            np.array(mesh.GetPointsAttr().Get(9)),
        )
        for mesh in meshes
    }


@pytest.mark.parametrize(
    ("options", "purpose"), [((), "default"), (("--guide",), "guide")], ids=["shown", "guide"]
)
def test_cage_and_model_in_one_stage(run, result, options, purpose):
    outcome = run("export", "cages.h5", "both.usdc", "--with-model", *options)
    assert outcome.code == 0, outcome.err
    assert "5 frames of 26 vertices, 8 of the cage and 18 of the model, " in outcome.err
    assert faults_of("both.usdc") == []
    found = read_stage("both.usdc")
    assert {name: held[0] for name, held in found.items()} == {"cage": purpose, "model": "default"}
    assert run("deform", "cages.h5", "-o", "model.npz", "-q").code == 0
    with np.load("model.npz") as file:
        model = file["vertices"]
    np.testing.assert_allclose(found["cage"][1], verts()[2], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found["model"][1], model[2], rtol=1e-6, atol=1e-6)


def test_a_skinned_model_beside_its_cage(run, result):
    words = ("export", "cages.h5", "s.usda", "--skeleton", "--influences", "4")
    assert run(*words, "--with-model", "--guide").code == 0
    assert faults_of("s.usda") == []
    found = read_stage("s.usda")
    assert {name: held[0] for name, held in found.items()} == {"cage": "guide", "mesh": "default"}
    # The joints are where the vertices of this cage are.
    assert run(*words[:2], "alone.usda", *words[3:]).code == 0
    assert set(read_stage("alone.usda")) == {"mesh"}


def test_the_folder_for_blender_says_how_to_open_it(run, result):
    outcome = run("export", "cages.h5", "live", "--blender")
    assert outcome.code == 0, outcome.err
    said = " ".join(outcome.err.split())
    assert "5 frames of 26 vertices, 8 of the cage and 18 of the model, " in said
    assert "live: converted from centimetres to metres" in said
    assert "open open_in_blender.py in the text editor and run it" in said
    assert len(list(Path("live").iterdir())) == 3
    assert run("export", "cages.h5", "live", "--blender", "--overwrite", "-q").err == ""


@pytest.mark.parametrize(
    ("name", "words", "named"),
    [
        ("live", ["--skeleton"], "--blender and --skeleton write different rigs; give one"),
        ("live", ["--with-model"], "--blender writes the cage and the model; leave out --with"),
        ("live", ["--to", "cm"], "is for Blender, which has metres and z up, and a place for each"),
        ("live", ["--to", "cm", "--recentre"], "leave out --recentre and --to"),
        ("live", ["--format", "ply"], "leave out --format ply"),
        ("live", ["--morphs", "4"], "--morphs and --tolerance apply to .glb"),
        (
            "live.glb",
            [],
            "--blender writes a folder, expected a name without a suffix, such as live",
        ),
        ("cage.obj", [], "--blender writes a folder, expected a name without a suffix"),
        ("live/c_####.obj", [], "--blender writes a folder"),
        ("no/live", [], "the folder no does not exist"),
        ("frames", [], "holds frame_1.obj, which is none of the files to be written"),
    ],
)
def test_what_the_folder_for_blender_cannot_have_is_refused(run, result, name, words, named):
    before = sorted(Path().rglob("*"))
    outcome = run("export", "cages.h5", name, "--blender", *words)
    assert outcome.code != 0
    assert named in " ".join(outcome.err.split())
    assert sorted(Path().rglob("*")) == before


def test_the_folder_for_blender_is_of_one_result_with_weights(run, result):
    assert run(*EXTRACT, "--no-weights", "-o", "bare.h5").code == 0
    outcome = run("export", "bare.h5", "live", "--blender")
    assert outcome.code == 1
    assert "bare.h5: has no weights, which the model in Blender needs; extract it" in outcome.err
    outcome = run("export", "cages.h5", "bare.h5", "live", "--blender")
    assert "live: holds the cages of one result (found 2)" in outcome.err
    assert not Path("live").exists()
