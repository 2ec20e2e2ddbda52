"""`--exclude`, and `FILE::PATH`: parts of a clip, from files of several meshes."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from cageik_cli import extract_to_file, load_clip
from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import ClipSettings, Scene
from cageik_cli.formats.write import Output, write_animation
from cageik_cli.geometry.parts import join_meshes, list_part_names
from cageik_cli.run.settings import ViewSettings
from cageik_cli.store.result import read_result
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view.session import open_session
from tests.shapes import ball, box

BALL = ball(1, 0.8)
MODEL = join_meshes([BALL, box(0.3), box(0.4)], ["/hero/body", "/hero/eyes/eye_L", "/hero/prop"])


@pytest.fixture
def hero(folder):
    """The current folder, with a cage and a clip of three parts in several formats."""
    frames = np.stack([MODEL.vertices, 1.1 * MODEL.vertices])
    for name in ("hero.usdc", "hero.npz", "objs/hero_####.obj"):
        moved = Animation(MODEL, 2, Scene(), "hero")
        write_animation(Output(Path(name)), moved, iter([frames]), ProgressListener())
    return folder


EXTRACT = ("extract", "--cage", "cage.obj", "-o", "new.h5")


@pytest.mark.parametrize("clip", ["hero.usdc", "objs", "objs/*.obj"])
def test_parts_that_match_are_left_out_and_recorded(run, hero, clip):
    outcome = run(*EXTRACT, clip, "--exclude", "eye_?", "--exclude", "prop")
    assert outcome.code == 0, outcome.err
    result = read_result(Path("new.h5"))
    assert [name.rpartition("/")[2] for name in list_part_names(result.rest)] == ["body"]
    assert result.settings["exclude"] == ["eye_?", "prop"]
    assert "(--exclude eye_?)" in outcome.err
    np.testing.assert_allclose(result.rest.vertices, BALL.vertices, atol=1e-6)


def test_the_rest_pose_lacks_the_same_parts(run, hero):
    outcome = run(*EXTRACT, "objs", "--rest", "hero.usdc", "--exclude", "prop")
    assert outcome.code == 0, outcome.err
    assert list_part_names(read_result(Path("new.h5")).rest) == ("body", "eye_L")


def test_other_parts_are_another_run(run, hero):
    """Though the files are the same, and the numbers of frames."""
    assert run(*EXTRACT, "objs::eye_L").code == 0
    outcome = run(*EXTRACT, "objs::prop", "--resume")
    assert outcome.code == 1
    assert "new.h5: is the result of other files" in outcome.err
    assert run(*EXTRACT, "objs::prop", "--overwrite").code == 0
    assert list_part_names(read_result(Path("new.h5")).rest) == ("prop",)


def test_content_of_other_parts_has_another_digest(hero):
    digests = {
        open_sequence(["objs" + member], ClipSettings(exclude=exclude)).content_digest(0)
        for member, exclude in (("", ()), ("::prop", ()), ("::body", ()), ("", ("prop",)))
    }
    assert len(digests) == 4


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("hero.usdc", "--exclude", "hat"), "--exclude hat matches none of its meshes: /hero/body"),
        (("objs", "--exclude", "*"), "--exclude leaves none of its meshes"),
        (("hero.npz", "--exclude", "prop"), "holds no parts; remove --exclude prop"),
        (("frames", "--exclude", "prop"), "has no objects to choose from"),
        (("objs::hat",), "holds no mesh `hat`; choose one of body, eye_L, prop"),
        (("objs/*.obj::hat",), "holds no mesh `hat`; choose one of body, eye_L, prop"),
    ],
)
def test_a_choice_that_is_impossible_is_refused(run, hero, words, says):
    outcome = run(*EXTRACT, *words)
    assert outcome.code == 1
    assert says in outcome.err


@pytest.mark.parametrize(
    "words",
    [
        "check --cage cage.obj hero.usdc",
        "info hero.usdc",
        "info objs/hero_0001.obj",
        "bind --cage cage.obj --rest hero.usdc -o new.h5",
    ],
)
def test_every_command_that_reads_clips_leaves_out(run, hero, words):
    outcome = run(*words.split(), "--exclude", "eye*", "--exclude", "prop")
    assert outcome.code == 0, outcome.err
    assert re.search(r"\b18 vertices|vertices +18$", outcome.out + outcome.err, re.MULTILINE)


@pytest.mark.parametrize("clip", ["hero.usdc", "objs"])
def test_other_meshes_lack_what_the_patterns_match(run, hero, clip):
    assert run(*EXTRACT, "hero.usdc").code == 0
    mesh = "hero.usdc" if clip == "hero.usdc" else "objs/hero_0001.obj"
    out = ("--overwrite", "-o", "moved.usdc")
    words = ("deform", "new.h5", "--mesh", mesh, "--exclude", "eye*", *out)
    outcome = run(*words)
    assert outcome.code == 0, outcome.err
    names = list_part_names(open_sequence(["moved.usdc"]).first)
    assert [name.rpartition("/")[2] for name in names] == ["body", "prop"]
    outcome = run(*words, "--exclude", "hat")
    assert outcome.code == 1
    assert f"{mesh}: --exclude hat matches no part" in outcome.err
    outcome = run(*words, "--mesh", "frames/frame_1.obj", "--exclude", "prop")
    assert outcome.code == 0, outcome.err


def test_patterns_that_match_no_part_of_a_mesh_are_for_the_cages(run, hero):
    assert run(*EXTRACT, "hero.usdc").code == 0
    cage = load_mesh(Path("cage.obj")).mesh
    scene = join_meshes([cage, box(0.2)], ["/rig/cage", "/rig/light"])
    moved, frames = Animation(scene, 1, Scene(), "rig"), iter([scene.vertices[None]])
    write_animation(Output(Path("rig.usdc")), moved, frames, ProgressListener())
    words = ("deform", "new.h5", "--mesh", "hero.usdc", "--cages", "rig.usdc", "-o", "moved.usdc")
    assert run(*words, "--exclude", "prop").code == 1
    outcome = run(*words, "--exclude", "prop", "--exclude", "light")
    assert outcome.code == 0, outcome.err
    assert len(list_part_names(open_sequence(["moved.usdc"]).first)) == 2


@pytest.mark.parametrize("target", ["hero.usdc", "objs/hero_0001.obj"])
def test_a_posed_model_lacks_what_the_patterns_match(run, hero, target):
    handles = {"handles": [{"name": "top", "vertex": 0, "offset": [0, 0.1, 0]}]}
    Path("handles.json").write_text(json.dumps(handles))
    words = ("pose", target, "handles.json", "--cage", "cage.obj", "-o", "posed.obj")
    outcome = run(*words, "--exclude", "eye*", "--exclude", "prop")
    assert outcome.code == 0, outcome.err
    assert len(load_mesh(Path("posed.obj")).mesh.vertices) == 18
    outcome = run(*words, "--exclude", "hat", "--overwrite")
    assert "--exclude hat matches none of its meshes" in outcome.err


def test_a_viewed_model_lacks_what_the_patterns_match(hero):
    settings = ViewSettings(Path("hero.usdc"), cage=Path("cage.obj"), exclude=("eye*", "prop"))
    session = open_session(settings, ProgressListener())
    assert len(session.clip.base) == 18


def test_a_batch_leaves_out_clips_and_parts(run, hero, here):
    shutil.rmtree("frames")
    Path("clips/a").mkdir(parents=True)
    shutil.move("objs", "clips/a/objs")
    shutil.copytree("clips/a", "clips/b")
    words = ("batch", "clips", "--cage", "cage.obj", "-o", "out", "--exclude", "b/*")
    assert run(*words, "--exclude-parts", "prop", "--no-pages").code == 0
    assert here == ["a/objs"]
    assert list_part_names(read_result(Path("out/clips/a_objs.h5")).rest) == ("body", "eye_L")


def test_a_file_of_options_beside_a_clip_leaves_out_its_parts(run, hero, here):
    Path("objs/cageik.toml").write_text('exclude = ["prop"]\n')
    words = ("batch", "objs", "--cage", "cage.obj", "-o", "out", "--no-pages")
    assert run(*words).code == 0
    (name,) = here
    assert list_part_names(read_result(Path(f"out/clips/{name}.h5")).rest) == ("body", "eye_L")


def test_info_lists_the_parts_of_clips_meshes_results_and_bindings(run, hero):
    assert run(*EXTRACT, "hero.usdc").code == 0
    bind = ("bind", "--cage", "cage.obj", "--rest", "hero.usdc", "-o", "binding.h5")
    assert run(*bind).code == 0
    for name in ("hero.usdc", "new.h5", "binding.h5"):
        assert "part           /hero/eyes/eye_L: 8 vertices, 12 triangles" in run("info", name).out
    for name in ("objs", "objs/hero_0001.obj"):
        assert "part           eye_L: 8 vertices, 12 triangles" in run("info", name).out
    assert "part  " not in run("info", "cage.obj").out


def test_info_lists_twenty_parts(run, hero):
    model = join_meshes([box(0.1 * k) for k in range(1, 24)], [f"p{k}" for k in range(23)])
    moved = Animation(model, 1, Scene(), "many")
    frames = iter([model.vertices[None]])
    write_animation(Output(Path("many.usdc")), moved, frames, ProgressListener())
    rows = [row for row in run("info", "many.usdc").out.splitlines() if row.startswith("  part  ")]
    assert len(rows) == 21
    assert rows[-1].endswith("and 3 more")


def test_a_cage_in_a_scene_file_is_no_clip_of_a_batch(run, hero, here):
    cage = join_meshes([box(2.0)], ["/rig/cage"])
    moved = Animation(cage, 1, Scene(), "rig")
    frames = iter([cage.vertices[None]])
    write_animation(Output(Path("objs/rig.usdc")), moved, frames, ProgressListener())
    words = ("batch", "objs", "--cage", "objs/rig.usdc::/rig/cage", "-o", "out", "--no-pages")
    assert run(*words).code == 0
    assert here == ["objs"]


def test_python_leaves_out_parts(hero):
    clip = load_clip("objs", exclude=["eye_L", "prop"])
    assert list_part_names(clip.first) == ("body",)
    result = extract_to_file("objs", "cage.obj", "new.h5", exclude=["eye_L", "prop"])
    assert len(result.rest.vertices) == 18
