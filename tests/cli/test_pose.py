"""`cageik pose`, from the files to the files: a model, and the animation of a result."""

import gzip
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from cageik_cli.editing.edits import LayeredEdit
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mirror import find_mirror
from cageik_cli.store.result import read_animation, read_result, read_weights
from tests.assets import parse_asset
from tests.cli.terminal import on_a_terminal
from tests.shapes import quad_text
from tests.texts import texts

REST = ("pose", "frames/frame_1.obj", "handles.json", "--cage", "cage.obj", "-o", "posed.obj")
EDIT = ("pose", "cages.h5", "handles.json", "-o", "edited.h5")

LIFT = {"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]}
PINS = [{"name": f"pin {k}", "vertex": k, "pin": True} for k in (3, 7, 11, 15)]


@pytest.fixture
def handles(folder):
    """Write a file of handles."""

    def write(*entries, **others):
        Path("handles.json").write_text(json.dumps({"handles": entries} | others))

    write(LIFT, *PINS)
    return write


@pytest.fixture
def clip(extracted):
    """The result of the tiny clip, of five frames."""
    return read_result(Path("cages.h5"))


def cages(name):
    with h5py.File(name) as file:
        return file["verts"][:]


def test_a_model_is_posed(run, handles, animation):
    outcome = run(*REST, "--cage-out", "cage_posed.obj", "--hard")
    assert outcome.code == 0, outcome.err
    assert "wrote posed.obj" in outcome.err
    posed = load_mesh(Path("posed.obj")).mesh
    moved = posed.vertices - animation.rest.vertices
    np.testing.assert_allclose(moved[0], LIFT["offset"], rtol=0, atol=1e-5)
    np.testing.assert_allclose(moved[[3, 7, 11, 15]], 0, rtol=0, atol=1e-5)
    np.testing.assert_array_equal(posed.faces, animation.rest.faces)
    assert not np.allclose(load_mesh(Path("cage_posed.obj")).mesh.vertices, animation.cage.vertices)


def test_an_edit_is_mirrored(run, handles, animation):
    """The cage is a box: what a handle moves on one side moves on the other."""
    handles(LIFT)
    outcome = run(*REST, "--cage-out", "cage_posed.obj", "--mirror", "-v")
    assert (
        "\n  mirror         both sides move as mirror images about the plane x = 0\n" in outcome.err
    )
    cage, posed = animation.cage.vertices, load_mesh(Path("cage_posed.obj")).mesh.vertices
    mirror = find_mirror(cage)
    partners = mirror.find_pairs(cage)
    np.testing.assert_allclose(mirror.reflect(posed), posed[partners], rtol=0, atol=1e-8)
    assert np.abs(posed - cage).max() > 0.05


def test_an_edit_of_a_clip_is_mirrored_and_recorded(run, handles, clip):
    Path("edits.json").write_text(
        json.dumps({"edits": [{"name": "a", "moves": [{"vertex": 0, "offset": [0.1, 0, 0]}]}]})
    )
    words = ("pose", "cages.h5", "--cage-edits", "edits.json", "-o", "edited.h5", "--mirror")
    assert run(*words).code == 0
    moved = cages("edited.h5") - cages("cages.h5")
    assert (moved.any(axis=2).sum(axis=1) == 2).all()
    assert read_animation(Path("edited.h5")).settings["mirror"] is True


def test_all_that_was_written_is_named(run, handles):
    outcome = run(*REST, "--cage-out", "c.obj", "--plot", "p.png", "--json", "j.json")
    names = ("posed.obj", "c.obj", "p.png", "j.json")
    assert outcome.err.splitlines()[-1] == f"wrote {', '.join(names)}"
    assert all(Path(name).exists() for name in names)
    for option, start in (("--json", "{"), ("--plot", "\ufffdPNG")):
        outcome = run(*REST, option, "-", "--overwrite")
        assert outcome.err.splitlines()[-1] == "wrote posed.obj"
        assert outcome.out.startswith(start)


def test_the_same_input_gives_the_same_bytes(run, handles, clip):
    for first, *words in ((REST[-1], *REST[:-1]), (EDIT[-1], *EDIT[:-1])):
        assert run(*words, first).code == 0
        assert run(*words, f"again_{first}").code == 0
        assert Path(first).read_bytes() == Path(f"again_{first}").read_bytes()


@pytest.mark.parametrize("words", [REST, EDIT])
def test_one_thread_multiplies(run, handles, clip, monkeypatch, words):
    """The last digits of a product depend on how many do."""
    edit_frames, counts = LayeredEdit.edit_frames, []

    def counted(*arguments):
        counts.extend(p["num_threads"] for p in threadpool_info() if p["user_api"] == "blas")
        return edit_frames(*arguments)

    monkeypatch.setattr(LayeredEdit, "edit_frames", counted)
    assert run(*words).code == 0
    assert counts
    assert set(counts) == {1}


def test_a_terminal_sees_a_bar_of_the_frames(handles, clip):
    code, drawn = on_a_terminal(*EDIT)
    assert code == 0
    assert "edit: " in drawn
    assert "5/5" in drawn


def test_names_in_a_note_are_of_one_line(run, handles, clip):
    Path("handles.json").rename("a\x1b\nb.json")
    assert run("pose", "cages.h5", "a\x1b\nb.json", "-o", "edited.h5").code == 0
    assert "edited by a\ufffd b.json: figures" in texts(read_animation(Path("edited.h5")).notes)[-1]


@pytest.mark.parametrize("packed", [False, True])
def test_models_and_cages_keep_what_their_obj_files_say(run, handles, packed):
    """Quads, texture coordinates, groups, materials; a cage is turned outward."""
    texts = {"model.obj": quad_text(1.0), "quads.obj": quad_text(2.0, inward=True)}
    for name, text in texts.items():
        Path(name).write_text(text)
        Path(f"{name}.gz").write_bytes(gzip.compress(text.encode()))
    model, cage = (f"{name}{'.gz' * packed}" for name in texts)
    handles(LIFT, *PINS[:2])
    words = ("pose", model, "handles.json", "--cage", cage)
    assert run(*words, "-o", "posed.obj", "--cage-out", "posed_cage.obj").code == 0
    for text, name in zip(texts.values(), ("posed", "posed_cage"), strict=True):
        found, expected = parse_asset(Path(f"{name}.obj").read_text()), parse_asset(text)
        assert found.names == expected.names
        assert found.library == "skins/box.mtl"
        turned = [sorted(polygon) for polygon in expected.corner_uvs]
        assert [sorted(polygon) for polygon in found.corner_uvs] == turned
    assert found.polygons == [[q[0], *q[:0:-1]] for q in expected.polygons]
    assert load_mesh(Path("posed_cage.obj")).mesh.volume > 0


def test_a_binding_keeps_what_the_model_is(run, handles):
    Path("model.obj").write_text(quad_text(1.0))
    handles(LIFT, *PINS[:2])
    assert run("bind", "--cage", "cage.obj", "--rest", "model.obj", "-o", "b.h5").code == 0
    assert run("pose", "b.h5", "handles.json", "-o", "posed.obj").code == 0
    words = ("pose", "model.obj", "handles.json", "--cage", "cage.obj", "-o", "same.obj")
    assert run(*words).code == 0
    assert Path("posed.obj").read_bytes() == Path("same.obj").read_bytes()
    assert parse_asset(Path("posed.obj").read_text()).polygons == parse_asset(quad_text(1)).polygons


def test_an_animation_keeps_its_other_frames(run, handles, clip):
    handles(LIFT, *PINS, frames=[3, 3], falloff=2)
    outcome = run(*EDIT, "--hard", "--no-hold")
    assert outcome.code == 0, outcome.err
    before, after = cages("cages.h5"), cages("edited.h5")
    assert np.flatnonzero((before != after).any(axis=(1, 2))).tolist() == [1, 2, 3]
    weights = read_weights(clip)
    moved = (weights @ after - weights @ before)[:, 0]
    strength = np.linalg.norm(moved, axis=1) / np.linalg.norm(LIFT["offset"])
    np.testing.assert_allclose(strength, [0, 0.5, 1, 0.5, 0], rtol=0, atol=1e-9)
    assert "frame_2.obj to frame_4.obj; all other" in outcome.err
    assert "cageik view edited.h5" in outcome.err


def test_an_edit_is_taken_wherever_a_result_is(run, handles, clip):
    assert run(*EDIT).code == 0
    edited = read_animation(Path("edited.h5"))
    assert edited.frames == clip.frames
    assert edited.scene == clip.scene
    assert edited.edited_from == "cages.h5"
    assert set(edited.sources) == {*clip.sources, "result", "handles"}
    assert "edited by handles.json" in texts(edited.notes)[-1]
    assert run("report", "edited.h5", "--json", "-", "--html", "page.html").code == 0
    assert run("export", "edited.h5", "cages.pc2").code == 0
    assert run("deform", "edited.h5", "-o", "mesh.npz").code == 0
    assert "an edit of cageik pose " in run("info", "edited.h5").out
    again = run("pose", "edited.h5", "handles.json", "-o", "twice.h5")
    assert read_animation(Path("twice.h5")).edited_from == "edited.h5"
    assert again.code == 0, again.err
    twice = 2 * (cages("edited.h5") - cages("cages.h5"))
    np.testing.assert_allclose(cages("twice.h5") - cages("cages.h5"), twice, rtol=0, atol=1e-12)


def test_figures_tell_how_far_the_mesh_was_moved(run, handles, clip):
    handles(LIFT, *PINS, frames=[4, 5])
    assert run(*EDIT).code == 0
    weights, edited = read_weights(clip), read_animation(Path("edited.h5"))
    moved = np.linalg.norm(weights @ (cages("edited.h5") - cages("cages.h5")), axis=2)
    rms = np.sqrt((moved**2).mean(axis=1))
    np.testing.assert_allclose(edited.metrics.rms, rms, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(edited.metrics.rms[:3], 0)
    np.testing.assert_allclose(
        edited.vertex_rms, np.sqrt((moved**2).mean(axis=0)), rtol=1e-9, atol=1e-15
    )
    assert np.all(edited.metrics.volume[:3] == edited.metrics.volume_reconstructed[:3])


def test_sets_are_layers(run, handles, clip):
    """One file with two sets is what one run after the other makes."""
    second = {"name": "side", "vertex": 5, "offset": [0.3, 0, 0]}
    handles(LIFT, *PINS, frames=[2, 3])
    assert run(*EDIT).code == 0
    handles(second, *PINS, frames=[3, 5], falloff=1)
    assert run("pose", "edited.h5", "handles.json", "-o", "chain.h5").code == 0
    sets = [
        {"handles": [LIFT, *PINS], "frames": [2, 3]},
        {"handles": [second, *PINS], "frames": [3, 5], "falloff": 1},
    ]
    Path("both.json").write_text(json.dumps({"sets": sets}))
    assert run("pose", "cages.h5", "both.json", "-o", "both.h5").code == 0
    np.testing.assert_array_equal(cages("both.h5"), cages("chain.h5"))


def test_gaps_stay_gaps(run, handles, folder):
    (folder / "frames" / "frame_3.obj").write_text("v 1 2\n")
    words = ("extract", "frames", "--cage", "cage.obj", "-o", "cages.h5", "--on-bad-frame", "skip")
    assert run(*words).code == 0
    outcome = run(*EDIT)
    assert outcome.code == 0, outcome.err
    edited = read_animation(Path("edited.h5"))
    assert list(edited.skipped) == [2]
    assert np.isnan(cages("edited.h5")[2]).all()
    assert np.isfinite(np.delete(cages("edited.h5"), 2, axis=0)).all()


def test_blocks_do_not_change_the_result(run, handles, clip, monkeypatch):
    handles(LIFT, *PINS, frames=[2, 4], falloff=1)
    assert run(*EDIT, "--rigidity", "3").code == 0
    monkeypatch.setattr("cageik_cli.run.executor.MAX_BLOCK_FRAMES", 2)
    assert run(*EDIT[:-1], "small.h5", "--rigidity", "3").code == 0
    np.testing.assert_array_equal(cages("edited.h5"), cages("small.h5"))
    whole, parted = (read_animation(Path(name)) for name in ("edited.h5", "small.h5"))
    np.testing.assert_array_equal(whole.metrics.rms, parted.metrics.rms)
    np.testing.assert_allclose(whole.vertex_rms, parted.vertex_rms, rtol=1e-12, atol=0)


def test_figures_as_json(run, handles, clip):
    outcome = run(*EDIT, "--json", "-", "-q")
    record = json.loads(outcome.out)
    assert outcome.err == ""
    assert [anchor["name"] for anchor in record["anchors"]] == ["tip", *(p["name"] for p in PINS)]
    length = np.linalg.norm(LIFT["offset"])
    assert record["anchors"][0]["moved"] == pytest.approx(length, rel=1e-3)
    assert 0 < record["anchors"][0]["residual_percent"] < 0.1
    assert record["changed"] == ["frame_1.obj", "frame_5.obj"]


def test_hard_handles_are_met_exactly(run, handles, clip):
    record = json.loads(run(*EDIT, "--json", "-", "--hard", "-q").out)
    assert max(anchor["residual_percent"] for anchor in record["anchors"]) < 1e-10


def test_rigidity_changes_what_turns(run, handles, clip):
    assert run(*EDIT).code == 0
    assert run(*EDIT[:-1], "turned.h5", "--rigidity", "5").code == 0
    assert not np.allclose(cages("edited.h5"), cages("turned.h5"), rtol=0, atol=1e-3)


NEAR = {"name": "near", "position": [0.1, 0.2, 1.3], "pin": True}
"""0.308 from a ball of radius 1, 15.4 % of the diagonal of its first frame."""


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ((), 1),
        (("--snap",), 1),
        (("--snap", "1"), 1),
        (("--snap", "30%"), 0),
        (("--snap=30",), 0),
    ],
)
def test_positions_snap_to_the_surface_if_it_is_near(run, handles, words, code):
    handles(LIFT, NEAR)
    outcome = run(*REST, *words, "-v")
    assert outcome.code == code, outcome.err
    assert Path("posed.obj").exists() == (code == 0)
    assert "handle 'near': position" in outcome.err


def test_the_chosen_place_is_in_text_and_json(run, handles):
    """The place can be put into the file instead of the position."""
    handles(LIFT, NEAR)
    outcome = run(*REST, "--snap", "30%", "--json", "-", "-v")
    tip, near = json.loads(outcome.out)["anchors"]
    assert (tip["vertex"], tip["face"], tip["barycentric"]) == (0, None, None)
    assert near["vertex"] is None
    assert f"handle 'near': position snapped to face {near['face']} (bary" in outcome.err
    place = {name: near[name] for name in ("face", "barycentric")}
    handles(LIFT, {"name": "near", "pin": True} | place)
    assert run(*REST[:-1], "again.obj").code == 0
    assert Path("again.obj").read_bytes() == Path("posed.obj").read_bytes()


def test_the_schema_is_printed(run):
    schema = json.loads(run("pose", "--schema").out)
    assert schema["$schema"].startswith("https://json-schema.org/")


@pytest.mark.parametrize(
    ("name", "place", "told"),
    [
        ("verts", (3, 0, 0), "Error: cages.h5: the cage of frame_4.obj is not finite"),
        (
            "handles.json",
            None,
            "Error: handles.json: handle 'eye': screen.offset: frame 5: the point is",
        ),
    ],
)
def test_the_file_at_fault_is_named(run, handles, clip, name, place, told):
    """What only the last frames show: a cage that is damaged, or a handle that nothing sees."""
    if place is not None:
        with h5py.File("cages.h5", "r+") as file:
            file[name][place] = np.nan
    else:
        with h5py.File("cages.h5", "r+") as file:
            file["verts"][4] += [0, 0, 20.0]
        camera = {
            "position": [0, 0, 9], "look_at": [0, 0, 0], "up": [0, 1, 0],
            "fov_degrees": 40, "width": 100, "height": 100,
        }  # fmt: skip
        handles({"name": "eye", "screen": {"source": [50, 50], "offset": [9, 0]}}, camera=camera)
    outcome = run(*EDIT)
    assert outcome.code == 1
    assert outcome.err.startswith(told)
    assert not Path("edited.h5").exists()


def test_hard_handles_that_cannot_be_met_are_refused_by_name(run, handles):
    """A box of eight vertices cannot meet nine points each for itself."""
    handles(*({"name": f"h{k}", "vertex": k, "offset": [0, 0, 0.1 * k]} for k in range(9)))
    outcome = run(*REST, "--hard")
    assert outcome.code == 1
    assert "handles.json: anchors " in outcome.err
    assert "conflict (condition number" in outcome.err
    assert not Path("posed.obj").exists()
    assert run(*REST).code == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "used"), [((), []), (("--plot", "p.png"), ["matplotlib"])], ids=["bare", "plot"]
)
def test_only_pictures_need_the_library_that_draws(run_process, handles, words, used):
    code = (
        "import sys; from cageik_cli.cli import main; "
        f"main({[*REST, *words]!r}, standalone_mode=False); "
        "print(sorted({'matplotlib', 'scipy.optimize', 'scipy.interpolate'} & set(sys.modules)))"
    )
    outcome = run_process("-c", code)
    assert outcome.code == 0, outcome.err
    assert outcome.out == f"{used}\n"


@pytest.mark.slow
def test_the_picture_is_of_the_frame_that_was_moved_most(run, handles, clip):
    from PIL import Image

    handles(LIFT, *PINS, frames=[4, 4])
    assert run(*EDIT, "--plot", "edit.png", "-q").code == 0
    with Image.open("edit.png") as picture:
        assert picture.size[0] > picture.size[1] > 500
    again = run(*EDIT, "--plot", "z.png", "--up-axis", "Z", "--overwrite", "-q")
    assert again.code == 0
    assert Path("z.png").read_bytes() != Path("edit.png").read_bytes()


def test_a_volume_that_changes_much_is_remarked_on_unless_parts_turn(run, handles, clip):
    """A handle goes through the model."""
    handles({"name": "in", "vertex": 0, "offset": [-1.5, 0, 0]}, *PINS)
    told = "the volume changes by -"
    for words in (REST, EDIT):
        assert told in (err := run(*words, "-v").err)
        assert "another radius" in err.replace("`", "").replace("--", "")
        words = (*words, "--no-hold", "--overwrite", "-v")
        assert "or let them rotate with --rigidity 10" in run(*words).err
        assert "let them rotate" not in run(*words, "--rigidity", "1").err
    handles(LIFT | {"offset": [0, 0, 0.01]}, *PINS)
    assert told not in run(*REST, "--overwrite", "-v").err


EDIT_CAGE = ("pose", "cages.h5", "--cage-edits", "edits.json", "-o", "edited.h5")


@pytest.fixture
def cage_edits(folder):
    """Write a file of one cage edit, which moves two vertices."""

    def write(**changes):
        moves = [{"vertex": k, "offset": [0.1, 0.2, -0.3]} for k in (0, 3)]
        document = {"edits": [{"name": "corner", "moves": moves} | changes]}
        Path("edits.json").write_text(json.dumps(document))

    write()
    return write


def test_cage_vertices_of_an_animation_are_moved(run, clip, cage_edits):
    cage_edits(frames=[3, 3], falloff=2)
    outcome = run(*EDIT_CAGE, "--plot", "p.png", "--json", "j.json", "-v")
    assert outcome.code == 0, outcome.err
    before, after = cages("cages.h5"), cages("edited.h5")
    assert np.flatnonzero((before != after).any(axis=(1, 2))).tolist() == [1, 2, 3]
    moved = (after - before)[2]
    np.testing.assert_allclose(moved[[0, 3]], 2 * [[0.1, 0.2, -0.3]], rtol=0, atol=1e-12)
    assert not moved[[1, 2, *range(4, 8)]].any()
    assert (
        "corner: 2 vertices of the cage by at most 0.374166 in frame_3.obj (vertex 0)"
        in outcome.err
    )
    assert "frame_2.obj to frame_4.obj; all other" in outcome.err
    assert "system" not in outcome.err
    (told,) = json.loads(Path("j.json").read_text())["cage_edits"]
    assert (told["name"], told["vertices"], told["frame"]) == ("corner", 2, "frame_3.obj")
    edited = read_animation(Path("edited.h5"))
    assert set(edited.sources) == {*clip.sources, "result", "cage_edits"}
    assert "edited by edits.json: " in texts(edited.notes)[-1]
    assert run("report", "edited.h5", "--html", "page.html").code == 0


def test_cage_vertices_of_a_model_are_moved(run, cage_edits, animation, handles):
    words = (*REST[:2], *REST[3:], "--cage-edits", "edits.json", "--cage-out", "moved.obj")
    outcome = run(*words)
    assert outcome.code == 0, outcome.err
    moved = load_mesh(Path("moved.obj")).mesh.vertices - animation.cage.vertices
    np.testing.assert_allclose(moved[[0, 3]], 2 * [[0.1, 0.2, -0.3]], rtol=0, atol=1e-6)
    assert not np.abs(moved[[1, 2, *range(4, 8)]]).max() > 1e-6
    handles(LIFT, *PINS)
    outcome = run(*REST, "--cage-edits", "edits.json", "--overwrite", "-v", "--plot", "p.png")
    assert outcome.code == 0, outcome.err
    assert "cage edit" in outcome.err
    assert "tip: moved" in outcome.err


def test_handles_and_cage_edits_are_both_sources(run, clip, cage_edits, handles):
    assert run(*EDIT, "--cage-edits", "edits.json").code == 0
    edited = read_animation(Path("edited.h5"))
    assert set(edited.sources) == {*clip.sources, "result", "handles", "cage_edits"}
    assert "edited by handles.json and edits.json: " in texts(edited.notes)[-1]
    words = ("pose", "edited.h5", "handles.json", "-o", "twice.h5")
    assert run(*words).code == 0
    assert set(read_animation(Path("twice.h5")).sources) == {*clip.sources, "result", "handles"}


def test_an_edit_needs_handles_or_cage_edits(run, clip):
    outcome = run("pose", "cages.h5", "-o", "edited.h5")
    assert outcome.code == 2
    assert "Missing argument 'HANDLES', or option '--cage-edits'" in outcome.err


def test_the_schema_of_cage_edits_is_printed(run, folder):
    outcome = run("pose", "--cage-edits-schema")
    assert json.loads(outcome.out)["title"] == "a cage edits file"
    assert json.loads(run("pose", "--schema").out)["title"] == "a handles file"


def test_cage_edits_that_are_wrong_are_refused_by_name(run, clip, cage_edits):
    cage_edits(frames=[0, 99])
    outcome = run(*EDIT_CAGE)
    assert outcome.code == 1
    assert "edits.json: edit 'corner': frames: " in outcome.err
    assert not Path("edited.h5").exists()


def test_a_cage_edit_of_nothing_is_told(run, clip, cage_edits):
    cage_edits(moves=[{"vertex": 1, "offset": [0, 0, 0]}])
    outcome = run(*EDIT_CAGE)
    assert "corner: no motion" in outcome.err
    assert "no motion: all offsets of the cage edits are zero" in outcome.err
    cage_edits(moves=[{"vertex": 1, "offset": [500, 0, 0]}])
    outcome = run(*EDIT_CAGE, "--overwrite", "-v")
    assert "times the model's diagonal (expected at most 5)" in outcome.err
