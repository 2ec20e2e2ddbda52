"""`cageik deform`: what the cages of a result do to a mesh."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.run import deform as deforming
from tests.assets import parse_asset
from tests.clips import frames_of
from tests.conftest import EXTRACT
from tests.formats.gltf.decoded import Glb
from tests.shapes import box, finer, quad_text

OUT = ("-o", "m.npz")


def arrays(*names, path="cages.h5"):
    with h5py.File(path) as file:
        return [file[name][:] for name in names]


def frames_in(path="m.npz"):
    return frames_of(open_sequence([str(path)]))


def test_weights_times_cages(run, extracted):
    outcome = run("deform", "cages.h5", *OUT)
    assert (outcome.code, outcome.out) == (0, "")
    size = Path("m.npz").stat().st_size
    assert outcome.err == f"wrote m.npz: 5 frames of 18 vertices, {size / 1000:.3g} kB\n"
    weights, cages, faces = arrays("weights", "verts", "rest/tris")
    np.testing.assert_allclose(frames_in(), weights @ cages, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(open_sequence(["m.npz"]).first.faces, faces)


def test_frames_made_from_cages_come_back(run, extracted, write_obj, animation):
    """They are extracted without loss, and so deform gives what was extracted from."""
    (weights,) = arrays("weights")
    random = np.random.default_rng(5)
    cages = animation.cage.vertices + random.normal(0, 0.3, (4, 8, 3))
    cages[0] = animation.cage.vertices
    for k, frame in enumerate(weights @ cages):
        write_obj(Path("posed") / f"f_{k}.obj", frame, animation.rest.faces)
    words = ["extract", "posed", "--cage", "cage.obj", "--alpha", "0", "-o", "posed.h5", "-q"]
    assert run(*words, "--rest", "frames/frame_1.obj").code == 0
    np.testing.assert_allclose(arrays("verts", path="posed.h5")[0], cages, rtol=0, atol=1e-12)
    assert run("deform", "posed.h5", "-o", "back/b_#.ply").code == 0
    np.testing.assert_allclose(frames_in("back"), weights @ cages, rtol=0, atol=1e-12)


def test_rigid_cages_move_the_mesh_rigidly(run, extracted, write_obj, animation):
    angle = np.radians(40)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    moved = animation.cage.vertices @ turn.T + [3, -2, 5]
    write_obj(Path("edit") / "c_1.obj", animation.cage.vertices, animation.cage.faces)
    write_obj(Path("edit") / "c_2.obj", moved, animation.cage.faces)
    assert run("deform", "cages.h5", "--cages", "edit", *OUT).code == 0
    rest = animation.rest.vertices
    np.testing.assert_allclose(frames_in()[0], rest, rtol=0, atol=1e-13)
    np.testing.assert_allclose(frames_in()[1], rest @ turn.T + [3, -2, 5], rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["e.npz", "e/e_%02d.ply", "e/e_####.obj"])
def test_the_results_own_cages_change_nothing(run, extracted, name):
    assert run("deform", "cages.h5", *OUT).code == 0
    assert run("export", "cages.h5", name).code == 0
    place = name.split("/")[0]
    assert run("deform", "cages.h5", "--cages", place, "-o", "again.npz").code == 0
    exact = name.endswith(("npz", "ply"))
    tolerance = 0 if exact else 1e-8
    np.testing.assert_allclose(frames_in("again.npz"), frames_in(), rtol=0, atol=tolerance)


def test_frames_of_the_cages_are_chosen(run, extracted):
    assert run("export", "cages.h5", "e.npz").code == 0
    assert run("deform", "cages.h5", *OUT).code == 0
    words = ["--cages", "e.npz", "--frames", "1::2", "--layout", "fvx", "--allow-gaps"]
    assert run("deform", "cages.h5", *words, "-o", "some.npz").code == 0
    np.testing.assert_allclose(frames_in("some.npz"), frames_in()[1::2], rtol=0, atol=1e-14)


def test_what_a_finer_mesh_shares_with_the_model_moves_with_it(
    run, extracted, write_obj, animation
):
    """To the precision of weights, which are computed in other blocks."""
    fine = finer(animation.rest, 1)
    np.testing.assert_array_equal(fine.vertices[:18], animation.rest.vertices)
    write_obj(Path("9 jacket.obj"), fine.vertices, fine.faces)
    outcome = run("deform", "cages.h5", "--mesh", "9 jacket.obj", *OUT)
    assert outcome.code == 0, outcome.err
    assert run("deform", "cages.h5", "-o", "model.npz").code == 0
    assert frames_in().shape == (5, len(fine.vertices), 3)
    np.testing.assert_allclose(frames_in()[:, :18], frames_in("model.npz"), rtol=0, atol=1e-7)


def test_any_mesh_follows_affine_cages(run, extracted, write_obj, animation):
    """Weights of any mesh in the cage are exact on affine maps."""
    random = np.random.default_rng(7)
    points = random.uniform(-1.5, 1.5, (6, 3))
    write_obj(Path("teeth.obj"), points, np.array([[0, 1, 2], [3, 4, 5]]))
    affine = random.normal(0, 1, (3, 3))
    write_obj(Path("edit") / "c_1.obj", animation.cage.vertices @ affine, animation.cage.faces)
    assert run("deform", "cages.h5", "--mesh", "teeth.obj", "--cages", "edit", *OUT).code == 0
    np.testing.assert_allclose(frames_in()[0], points @ affine, rtol=0, atol=1e-12)


def test_polygons_are_cut_and_said_so(run, extracted, write_obj):
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    write_obj(Path("card.obj"), square, np.array([[0, 1, 2, 3]]))
    outcome = run("deform", "cages.h5", "--mesh", "card.obj", *OUT)
    assert outcome.code == 0
    assert (
        "  note           card.obj: 1 polygon cut into triangles to compute with"
        in outcome.err.splitlines()
    )
    assert len(open_sequence(["m.npz"]).first.faces) == 2


def test_frames_keep_what_the_obj_file_of_the_mesh_says(run, extracted):
    Path("card.obj").write_text(quad_text(0.5))
    words = ("deform", "cages.h5", "--mesh", "card.obj")
    assert run(*words, "-o", "out/####.obj").code == 0
    assert run(*words, *OUT).code == 0
    expected = parse_asset(quad_text(0.5))
    files = sorted(Path("out").iterdir())
    assert len(files) == 5
    for file, positions in zip(files, frames_in(), strict=True):
        found = parse_asset(file.read_text())
        np.testing.assert_allclose(found.vertices, positions, rtol=1e-8, atol=1e-12)
        assert (found.polygons, found.corner_uvs) == (expected.polygons, expected.corner_uvs)
        assert (found.names, found.library) == (expected.names, expected.library)


@pytest.mark.parametrize("mesh", [(), ("--mesh", "card.ply")], ids=["rest", "ply"])
def test_frames_of_what_was_no_obj_file_are_triangles(run, extracted, mesh):
    import trimesh

    trimesh.Trimesh(box(0.5).vertices, box(0.5).faces, process=False).export("card.ply")
    assert run("deform", "cages.h5", *mesh, "-o", "out/####.obj").code == 0
    words = [
        {line.split()[0] for line in file.read_text().splitlines()}
        for file in Path("out").iterdir()
    ]
    assert words == [{"v", "f"}] * 5


def test_a_mesh_outside_is_refused_with_the_remedy(run, extracted, write_obj, animation):
    vertices = animation.rest.vertices.copy()
    vertices[4] *= 2.5
    write_obj(Path("coat.obj"), vertices, animation.rest.faces)
    outcome = run("deform", "-v", "cages.h5", "--mesh", "coat.obj", *OUT)
    assert outcome.code == 1
    assert outcome.err.startswith("Error: coat.obj: 1 of 18 vertices are outside the cage")
    assert "--outside project" in outcome.err
    assert not Path("m.npz").exists()
    outcome = run("deform", "-v", "cages.h5", "--mesh", "coat.obj", "--outside", "project", *OUT)
    assert outcome.code == 0
    assert "note           coat.obj: 1 of 18 vertices of the model are outside" in outcome.err


def test_a_result_without_weights_is_bound_again(run, extracted, cache):
    assert run("deform", "-v", "cages.h5", *OUT).code == 0
    assert run(*EXTRACT, "--no-weights", "-o", "small.h5").code == 0
    before = len(list(cache.glob("*.weights")))
    outcome = run("deform", "-v", "small.h5", "-o", "small.npz")
    assert outcome.code == 0
    assert "  cache          " in outcome.err  # the weights that extract kept
    assert len(list(cache.glob("*.weights"))) == before
    assert Path("small.npz").read_bytes() == Path("m.npz").read_bytes()


def test_the_results_own_settings_hold_unless_others_are_given(run, extracted, monkeypatch):
    asked = []
    made = deforming.bind_cached

    def listen(mesh, cage, how, watch, **more):
        asked.append((how.bind.coordinates, how.bind.accuracy, how.bind.outside, how.cache))
        return made(mesh, cage, how, watch, **more)

    monkeypatch.setattr(deforming, "bind_cached", listen)
    words = ["--coordinates", "mean-value", "--accuracy", "preview", "--outside", "project"]
    assert run(*EXTRACT, *words, "-o", "other.h5").code == 0
    mesh = ["--mesh", "frames/frame_1.obj"]
    assert run("deform", "other.h5", *mesh, "--no-cache", "-o", "1.npz").code == 0
    assert run("deform", "other.h5", "-o", "2.npz").code == 0
    assert asked == [("mean-value", "preview", "project", None)]
    assert run("deform", "other.h5", "--coordinates", "harmonic", "--accuracy", "fine",
               "--outside", "refuse", "--cache", "kept", "-o", "3.npz").code == 0  # fmt: skip
    assert asked[1:] == [("harmonic", "fine", "refuse", Path("kept"))]
    assert np.abs(frames_in("3.npz") - frames_in("2.npz")).max() > 1e-3


@pytest.mark.parametrize("frames", [5, 21])
def test_neither_threads_nor_memory_change_the_bytes(run, extracted, write_obj, animation, frames):
    random = np.random.default_rng(3)
    cages = animation.cage.vertices + random.normal(0, 0.1, (frames, 8, 3))
    np.savez("e.npz", vertices=cages, faces=animation.cage.faces)
    fine = finer(animation.rest, 3)
    write_obj(Path("fine.obj"), fine.vertices, fine.faces)
    words = ["deform", "cages.h5", "--cages", "e.npz", "--mesh", "fine.obj"]
    assert run(*words, *OUT).code == 0
    for k, more in enumerate((["--jobs", "1"], ["--jobs", "2"], ["--memory", "10K"])):
        assert run(*words, *more, "-o", f"{k}.npz").code == 0
        assert Path(f"{k}.npz").read_bytes() == Path("m.npz").read_bytes()


def test_a_glb_has_normals_unless_it_is_flat(run, extracted):
    outcome = run("deform", "cages.h5", "-o", "m.glb")
    assert outcome.code == 0, outcome.err
    file = Glb(Path("m.glb"))
    weights, cages, faces = arrays("weights", "verts", "rest/tris")
    np.testing.assert_allclose(file.frames()[1], weights @ cages, rtol=0, atol=1e-5)
    assert set(file.primitives[0]["attributes"]) == {"POSITION", "NORMAL"}
    frames = weights @ cages
    polygons = TriMesh(frames[0], faces).polygons
    normals = [compute_vertex_normals(polygons, frame) for frame in frames]
    np.testing.assert_allclose(file.morph("NORMAL"), normals, rtol=0, atol=0.02)
    assert np.abs(file.attribute("NORMAL") - normals[-1]).max() > 0.1
    assert run("deform", "cages.h5", "-o", "flat.glb", "--flat", "--tolerance", "1%").code == 0
    flat = Glb(Path("flat.glb"))
    assert set(flat.primitives[0]["attributes"]) == {"POSITION"}
    assert flat.json["meshes"][0]["extras"]["cageik"]["largest_percent"] <= 1


def test_skipped_frames_of_a_glb_are_interpolated(run, folder):
    """They are in time, and say so."""
    Path("frames/frame_3.obj").unlink()
    assert run(*EXTRACT, "--allow-gaps").code == 0
    outcome = run("deform", "-v", "cages.h5", "-o", "m.glb")
    assert "1 of 5 frames skipped (frame_3.obj)" in outcome.err
    times, frames = Glb(Path("m.glb")).frames()
    np.testing.assert_allclose(times, np.arange(5) / 24, rtol=1e-6)
    np.testing.assert_allclose(frames[2], (frames[1] + frames[3]) / 2, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("memory", "vertices", "expected"),
    [
        (1 << 30, 10_000, 16),
        (1 << 20, 10_000, 4),
        (1, 10_000, 4),
        (8 * 96 * 100, 100, 8),
        (12 * 96 * 100 - 1, 100, 8),
    ],
)
def test_blocks_are_bounded_and_of_whole_groups(memory, vertices, expected):
    assert deforming.choose_block_size(memory, vertices) == expected


def scene_of(path):
    with np.load(path) as file:
        return [file[name].item() for name in ("fps", "start", "up_axis", "metres_per_unit")]


def test_the_scene_is_the_results_unless_options_say_more(run, folder):
    assert run(*EXTRACT, "--fps", "30", "--start", "7", "--up-axis", "Z").code == 0
    assert run("deform", "cages.h5", *OUT).code == 0
    assert scene_of("m.npz") == [30, 7, "Z", 1]
    words = ["--fps", "25", "--start", "2", "--up-axis", "Y", "--metres-per-unit", "0.01"]
    assert run("deform", "cages.h5", *words, "-o", "n.npz").code == 0
    assert scene_of("n.npz") == [25, 2, "Y", 0.01]


def test_what_the_clip_of_cages_says_of_the_scene_comes_first(run, extracted):
    assert run("export", "cages.h5", "e.npz", "--start", "4", "--fps", "60").code == 0
    assert run("deform", "cages.h5", "--cages", "e.npz", *OUT).code == 0
    assert scene_of("m.npz") == [60, 4, "Y", 1]
    assert run("deform", "cages.h5", "--cages", "e.npz", "--fps", "12", "-o", "n.npz").code == 0
    assert scene_of("n.npz")[0] == 12


def edited(write_obj, vertices, faces):
    write_obj(Path("edit") / "c_1.obj", vertices, faces)


def test_cages_in_another_order_are_refused(run, extracted, write_obj, animation):
    cage = animation.cage
    order = np.array([3, 0, 7, 1, 2, 6, 5, 4])
    edited(write_obj, cage.vertices[order], np.argsort(order)[cage.faces])
    outcome = run("deform", "cages.h5", "--cages", "edit", *OUT)
    assert outcome.code == 1
    assert outcome.err.startswith(
        "Error: edit: as many vertices and triangles as the result's cage, in another order; "
    )


def test_cages_may_come_back_as_quads(run, extracted, write_obj, animation):
    """Programs that edit quads write quads, from whatever corner."""
    quads = np.array([(3, 2, 0, 1), (4, 6, 7, 5), (0, 4, 5, 1), (7, 6, 2, 3), (0, 2, 6, 4),
                      (1, 5, 7, 3)])  # fmt: skip
    edited(write_obj, 2 * animation.cage.vertices, quads)
    outcome = run("deform", "-v", "cages.h5", "--cages", "edit", *OUT)
    assert outcome.code == 0, outcome.err
    assert (
        "note           c_1.obj: 6 polygons cut into triangles to compute with, as in all frames"
        in outcome.err
    )
    np.testing.assert_allclose(frames_in()[0], 2 * animation.rest.vertices, rtol=0, atol=1e-13)


def test_a_damaged_frame_of_cages_is_named(run, extracted, write_obj, animation):
    edited(write_obj, animation.cage.vertices, animation.cage.faces)
    Path("edit/c_2.obj").write_text("v 0 0 nan\n")
    outcome = run("deform", "cages.h5", "--cages", "edit", *OUT)
    assert outcome.code == 1
    assert outcome.err.startswith("Error: edit/c_2.obj: ")
    assert not Path("m.npz").exists()


def test_a_result_whose_settings_are_damaged_is_refused(run, extracted):
    with h5py.File("cages.h5", "r+") as file:
        file.attrs["settings"] = '{"coordinates": []}'
    outcome = run("deform", "cages.h5", *OUT)
    assert outcome.code == 1
    damage = "Error: cages.h5: --coordinates is '[]', expected one of harmonic"
    assert outcome.err.startswith(damage)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("my jacket.obj", "my_jacket"), ("9.ply", "_9"), ("é-1.off", "__1"), (None, "mesh")],
)
def test_objects_are_called_what_all_formats_take(name, expected):
    assert deforming._make_object_name((Path(name),) if name else ()) == expected


def test_a_mesh_of_any_kind_is_driven(run, extracted, animation):
    import trimesh

    for suffix in (".ply", ".off"):
        mesh = TriMesh(animation.rest.vertices, animation.rest.faces)
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(f"a{suffix}")
        assert (
            run("deform", "cages.h5", "--mesh", f"a{suffix}", "-o", f"{suffix[1:]}.pc2").code == 0
        )


@pytest.fixture
def edited_cages(bound, animation, write_obj):
    """`edit`: two cages from 1001 on, beside the result and the binding."""
    for k, cage in enumerate(arrays("verts")[0][2:4]):
        write_obj(bound / f"edit/c_{1001 + k}.obj", cage, animation.cage.faces)
    return bound


def test_a_binding_is_moved_by_cages(run, edited_cages):
    """As the result of the same binding is."""
    words = ("--cages", "edit", "-o")
    assert run("deform", "cages.h5", *words, "a.npz").code == 0
    assert run("deform", "binding.h5", *words, "b.npz").code == 0
    assert Path("a.npz").read_bytes() == Path("b.npz").read_bytes()
    assert run("deform", "binding.h5", *words, "m/m_####.obj").code == 0
    assert {path.name for path in Path("m").iterdir()} == {"m_1001.obj", "m_1002.obj"}


def test_another_mesh_is_moved_by_a_binding_and_cages(run, edited_cages, write_obj):
    inner = box(0.5)
    write_obj(edited_cages / "inner.obj", inner.vertices, inner.faces)
    words = ("--cages", "edit", "--mesh", "inner.obj", "-o")
    assert run("deform", "cages.h5", *words, "a.npz").code == 0
    assert run("deform", "binding.h5", *words, "b.npz").code == 0
    assert Path("a.npz").read_bytes() == Path("b.npz").read_bytes()


def test_a_binding_of_few_influences_needs_a_result(run, edited_cages):
    words = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj", "--fit", "frames")
    assert run(*words, "--influences", "3", "-o", "few.h5").code == 0
    outcome = run("deform", "few.h5", "--cages", "edit", *OUT)
    assert outcome.code == 1
    assert "few.h5: is a binding, with weights of few influences" in outcome.err


@pytest.mark.parametrize("words", [("--frames", "0:2"), ("--close-gaps",)])
def test_an_option_of_the_cages_without_them_is_named_alone(run, extracted, words):
    outcome = run("deform", "cages.h5", "-o", "m.pc2", *words)
    assert outcome.code == 2
    sentence = f"Error: {words[0]} is for the clip of --cages; leave it out, or give --cages\n"
    assert outcome.err.endswith(sentence)
