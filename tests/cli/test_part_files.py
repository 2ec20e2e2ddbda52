"""`deform` of several meshes, and a file of each part by `{part}`."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import Output, name_part_files, write_animation
from cageik_cli.geometry.parts import join_meshes, list_part_names, split_parts
from cageik_cli.util.progress import ProgressListener
from tests.shapes import ball, box

TURNED = np.array([[0, 0.5, 0, 0], [-0.5, 0, 0, 0], [0, 0, 0.5, 0], [0.3, 0.1, 0.2, 1.0]])
MODEL = join_meshes(
    [ball(1, 0.8), box(0.2), box(0.1)],
    ["/hero/body", "/hero/L/eye", "/hero/R/eye"],
    [np.eye(4), TURNED, np.eye(4)],
)
FILES = ("body", "hero_L_eye", "hero_R_eye")


@pytest.fixture
def hero(extracted):
    """The folder of the tiny result, with a model of three parts in its cage, and two hats."""
    moved = Animation(MODEL, 1, Scene(), "hero")
    frames = MODEL.vertices[None]
    for name in ("hero.usdc", "hats/hat_####.obj"):
        write_animation(Output(Path(name)), moved, iter([frames]), ProgressListener())
    for name, size in (("hat.ply", 0.3), ("cap.ply", 0.4)):
        hat = Animation(box(size), 1, Scene(), "hat")
        write_animation(
            Output(Path("one/a_####.ply"), overwrite=True),
            hat,
            iter([hat.rest.vertices[None]]),
            ProgressListener(),
        )
        shutil.move("one/a_0001.ply", name)
    Path("out").mkdir()
    return extracted


DEFORM = ("deform", "cages.h5", "--mesh", "hero.usdc", "-o")


def read_whole(run):
    assert run(*DEFORM, "whole.npz", "--overwrite").code == 0
    return np.load("whole.npz")["vertices"]


@pytest.mark.parametrize("pattern", ["{part}.pc2", "{part}/a_####.obj"])
def test_the_folder_of_the_files_of_parts_is_made(run, hero, pattern):
    outcome = run(*DEFORM, f"new/{pattern}")
    assert outcome.code == 0, outcome.err
    assert sorted(path.stem for path in Path("new").iterdir()) == list(FILES)


def test_a_folder_is_not_made_where_there_is_none_above_it_or_no_writer(run, hero):
    outcome = run(*DEFORM, "new/deep/{part}.pc2")
    assert outcome.code == 1
    assert "the folder new does not exist" in outcome.err
    assert run("deform", "cages.h5", "-o", "new/cage.pc2").code == 1
    assert not Path("new").exists()


def test_a_skeleton_in_gltf_has_no_cage_beside_it(run, hero):
    outcome = run("export", "cages.h5", "rig.glb", "--skeleton", "--with-model")
    assert outcome.code == 1
    assert "leave out --with-model, or write .usdc" in outcome.err


def test_a_folder_that_was_made_is_removed_after_a_failure(tmp_path):
    output = Output(tmp_path / "new" / "{part}.pc2")
    moved = Animation(MODEL, 1, Scene(), "hero")
    with pytest.raises(ZeroDivisionError):
        write_animation(output, moved, (1 / 0 for _ in "a"), ProgressListener())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["pc2", "mdd"])
def test_point_caches_of_parts_are_in_the_space_of_each(run, hero, kind):
    """So that one goes onto the object of the asset, whose transform stays."""
    outcome = run(*DEFORM, f"out/{{part}}.{kind}")
    assert outcome.code == 0, outcome.err
    assert sorted(path.name for path in Path("out").iterdir()) == [f"{n}.{kind}" for n in FILES]
    assert "a file of each part: body" in outcome.err
    whole = read_whole(run)
    for name, part in zip(FILES, split_parts(MODEL), strict=True):
        rest = load_mesh(Path(f"hero.usdc::{part.name}"))
        own = np.stack(list(open_sequence([f"out/{name}.{kind}"], rest=rest)))
        placed = own @ part.transform[:3, :3] + part.transform[3, :3]
        np.testing.assert_allclose(placed, whole[:, part.vertices], atol=2e-6)


def test_other_formats_of_parts_are_in_the_space_of_the_scene(run, hero):
    assert run(*DEFORM, "out/{part}.npz").code == 0
    whole = read_whole(run)
    parts = [np.load(f"out/{name}.npz")["vertices"] for name in FILES]
    np.testing.assert_array_equal(np.concatenate(parts, axis=1), whole)


def test_a_folder_of_each_part(run, hero):
    outcome = run(*DEFORM, "out/{part}_####.ply")
    assert outcome.code == 1
    assert "each part needs a folder of its own; put {part} into its name, as in out_{part}/" in (
        outcome.err
    )
    assert run(*DEFORM, "out_{part}/{part}_####.ply").code == 0
    assert len(list(Path("out_body").glob("body_*.ply"))) == 5


def test_every_file_is_checked_before_any_is_written(run, hero):
    Path("out/hero_R_eye.pc2").write_bytes(b"kept")
    outcome = run(*DEFORM, "out/{part}.pc2")
    assert outcome.code == 1
    assert "out/hero_R_eye.pc2: exists already" in outcome.err
    assert [path.name for path in Path("out").iterdir()] == ["hero_R_eye.pc2"]
    assert run(*DEFORM, "out/{part}.pc2", "--overwrite").code == 0
    shutil.copy("hero.usdc", "body.usdc")
    shutil.copy("body.usdc", "out/body.usdc")
    words = ("deform", "cages.h5", "--mesh", "out/body.usdc", "--overwrite")
    outcome = run(*words, "-o", "out/{part}.usdc")
    assert "out/body.usdc: is read or written by this command already" in outcome.err


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("all.pc2", "holds its 3 parts as one mesh: body, hero/L/eye, hero/R/eye; all_{part}.pc2"),
        ("all/all_####.ply", "all_{part}/all_####.ply writes one of each"),
        ("frames_out", None),
        ("all.usdc", None),
    ],
)
def test_formats_that_do_not_know_parts_say_so(run, hero, name, says):
    outcome = run(*DEFORM, name)
    assert outcome.code == 0, outcome.err
    assert ("as one mesh" in outcome.err) == (says is not None)
    assert says is None or says in outcome.err


def test_several_meshes_are_parts_of_what_is_written(run, hero):
    words = ("deform", "cages.h5", "--mesh", "hat.ply", "--mesh", "hero.usdc", "--mesh", "cap.ply")
    outcome = run(*words, "-o", "all.abc")
    assert outcome.code == 0, outcome.err
    written = load_mesh(Path("all.abc")).mesh
    names = [name.split("/")[-1] for name in list_part_names(written)]
    assert [name.removesuffix("Shape") for name in names] == ["hat", "body", "eye", "eye", "cap"]
    assert len(written.vertices) == 8 + 34 + 8
    whole = read_whole(run)
    assert run(*words, "-o", "all.npz").code == 0
    # Products of single precision round by the rows that are computed beside a vertex, too.
    beside = np.load("all.npz")["vertices"][:, 8:42]
    np.testing.assert_allclose(beside, whole, rtol=0, atol=2e-7)


def test_meshes_and_points_are_not_joined(run, hero):
    from numpy.lib.recfunctions import repack_fields

    from tests.splats import encode_rows, make_splat_rows

    rows = make_splat_rows(box(0.5), 9)
    Path("cloud.ply").write_bytes(encode_rows(repack_fields(rows[["x", "y", "z"]])))
    words = ("deform", "cages.h5", "--mesh", "hat.ply", "--mesh", "cloud.ply", "-o", "a.npz")
    outcome = run(*words)
    assert outcome.code == 1
    assert "cloud.ply: is a cloud of points, which cannot be a part" in outcome.err
    outcome = run("deform", "cages.h5", "--mesh", "cloud.ply", "-o", "{part}.npz")
    assert "which has no parts; leave {part} out" in outcome.err


def test_a_cage_has_no_parts_but_with_its_model(run, hero):
    outcome = run("export", "cages.h5", "out/{part}.pc2")
    assert "a cage has no parts" in outcome.err
    outcome = run("export", "cages.h5", "--with-model", "out/{part}.pc2")
    assert outcome.code == 0, outcome.err
    assert sorted(path.name for path in Path("out").iterdir()) == ["cage.pc2", "model.pc2"]
    outcome = run("deform", "cages.h5", "--recentre", "-o", "out/{part}.pc2", "--overwrite")
    assert "--recentre cannot move" in outcome.err


def test_names_of_files_are_short_safe_and_different_on_all_systems():
    assert name_part_files(["/a/body", "/a/Eye", "/b/eye", "/b/con", "/c/x?y"]) == [
        "body",
        "Eye",
        "eye_2",
        "_con",
        "x_y",
    ]
    assert name_part_files(["/a/eye", "/b/eye"]) == ["a_eye", "b_eye"]


MARKED = ["/a##b", "/c#", "/####", "/d%04d", "/$F4", "/e#1", "/ "]


@pytest.mark.parametrize("pattern", ["{part}.npz", "{part}/m_####.obj", "k{part}/{part}_%02d.ply"])
def test_marks_of_numbers_in_the_names_of_parts_stand_for_none(tmp_path, pattern):
    model = join_meshes([box(0.1)] * len(MARKED), MARKED, [np.eye(4)] * len(MARKED))
    moved = Animation(model, 2, Scene(), "hero")
    frames = np.stack([model.vertices, model.vertices + 0.1])
    write_animation(Output(tmp_path / pattern), moved, iter([frames]), ProgressListener())
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(files) == len(MARKED) * (1 if pattern.endswith("npz") else 2)
    assert not any(mark in str(path.relative_to(tmp_path)) for path in files for mark in "#%$")
