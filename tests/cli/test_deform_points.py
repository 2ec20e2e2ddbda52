"""`cageik deform` and `cageik pose` of points without faces and of Gaussian splats."""

import gzip
import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh

from cageik_cli import load_mesh
from cageik_cli.formats.ply_points import parse_points
from tests.splats import covariances, encode_rows, make_splat_rows

HANDLES = {
    "handles": [
        {"name": "a", "vertex": 3, "offset": [0.1, 0.2, 0]},
        {"name": "b", "vertex": 40, "pin": True},
    ]
}


@pytest.fixture
def splats(extracted, animation):
    Path("h.json").write_text(json.dumps(HANDLES))
    rows = make_splat_rows(animation.rest, 60)
    Path("splats.ply").write_bytes(encode_rows(rows))
    return rows


@pytest.fixture
def cloud(splats):
    rows = np.zeros(60, [*((axis, "<f4") for axis in "xyz"), ("red", "u1"), ("heat", "<f8")])
    for axis in "xyz":
        rows[axis] = splats[axis]
    rows["red"], rows["heat"] = np.arange(60), np.linspace(0, 1, 60)
    Path("cloud.ply").write_bytes(encode_rows(rows))
    return rows


def read(path):
    return parse_points(Path(path).read_bytes()).rows


def places(rows):
    return np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)


def frames_in(folder):
    return [read(path) for path in sorted(Path(folder).iterdir())]


def test_points_move_with_their_properties(run, cloud):
    outcome = run("deform", "cages.h5", "--mesh", "cloud.ply", "-o", "out")
    assert outcome.code == 0, outcome.err
    assert "wrote out: 5 frames of 60 points" in outcome.err
    frames = frames_in("out")
    assert len(frames) == 5
    for rows in frames:
        np.testing.assert_array_equal(rows["red"], cloud["red"])
        np.testing.assert_array_equal(rows["heat"], cloud["heat"])
    assert abs(places(frames[4]) - places(cloud)).max() > 0.01


@pytest.mark.parametrize("name", ["cloud.npz", "cloud.pc2", "cloud.mdd"])
def test_positions_of_points_are_written_in_other_formats(run, cloud, name):
    outcome = run("deform", "cages.h5", "--mesh", "cloud.ply", "-o", name)
    assert outcome.code == 0, outcome.err
    assert run("deform", "cages.h5", "--mesh", "cloud.ply", "-o", "out", "-q").code == 0
    if name.endswith("npz"):
        with np.load(name) as arrays:
            expected = np.stack([places(rows) for rows in frames_in("out")])
            np.testing.assert_allclose(arrays["vertices"], expected, rtol=0, atol=1e-6)


COMMANDS = {
    "deform": ("deform", "cages.h5", "--mesh", "n.ply", "-o", "out"),
    "pose": ("pose", "n.ply", "h.json", "--cage", "cage.obj", "-o", "posed.ply"),
}


def write_normals(cloud, normals, names=("nx", "ny", "nz"), kind="<f4"):
    rows = np.zeros(60, [*cloud.dtype.descr, *((axis, kind) for axis in names)])
    for name in cloud.dtype.names:
        rows[name] = cloud[name]
    for axis, value in zip(names, normals, strict=True):
        rows[axis] = value
    Path("n.ply").write_bytes(encode_rows(rows))
    return rows


def normals_in(rows):
    return np.stack([rows[axis] for axis in ("nx", "ny", "nz")], axis=1).astype(np.float64)


def write_moved_cage(name, linear):
    cage = load_mesh("cage.obj")
    lines = ["v {} {} {}".format(*point) for point in cage.vertices @ linear.T]
    lines += ["f {} {} {}".format(*face) for face in cage.faces + 1]
    Path(name).write_text("\n".join(lines) + "\n")


LINEAR = np.array([[0, -2.0, 0], [1, 0, 0], [0.5, 0, 1]])


@pytest.mark.parametrize("words", [(), ("--recentre",), ("--memory", "1MB")])
def test_normals_of_points_are_turned(run, cloud, words):
    """By the inverse transpose of an affine map, here."""
    given = np.random.default_rng(3).standard_normal((3, 60))
    rows = write_normals(cloud, given)
    rows["nx"][4] = rows["ny"][4] = rows["nz"][4] = 0
    Path("n.ply").write_bytes(encode_rows(rows))
    for frame, linear in enumerate((np.eye(3), LINEAR)):
        write_moved_cage(f"affine_{frame}.obj", linear)
    outcome = run(*COMMANDS["deform"], "--cages", "affine_*.obj", *words)
    assert outcome.code == 0, outcome.err
    assert "normals" not in outcome.err
    still, moved = frames_in("out")
    shift = [0.0, 0, 0]
    if "--recentre" in words:
        shift = json.loads(Path("out.offset.json").read_text())["offset"]
    np.testing.assert_allclose(places(still) + shift, places(cloud), rtol=0, atol=1e-6)
    np.testing.assert_allclose(places(moved) + shift, places(cloud) @ LINEAR.T, rtol=0, atol=1e-6)
    expected = normals_in(rows) @ np.linalg.inv(LINEAR)
    lengths = np.linalg.norm(expected, axis=1, keepdims=True)
    expected = np.divide(expected, lengths, out=np.zeros_like(expected), where=lengths > 0)
    np.testing.assert_allclose(normals_in(moved), expected, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(moved["heat"], cloud["heat"])


def test_normals_of_posed_points_are_turned(run, cloud):
    rows = write_normals(cloud, [[0.0], [1.0], [0.0]])
    outcome = run(*COMMANDS["pose"])
    assert outcome.code == 0, outcome.err
    posed = read("posed.ply")
    assert abs(normals_in(posed) - normals_in(rows)).max() > 0.01
    np.testing.assert_allclose(np.linalg.norm(normals_in(posed), axis=1), 1, rtol=1e-6)
    write_normals(cloud, [[0.0], [0.0], [0.0]])
    assert run(*COMMANDS["pose"], "--overwrite", "-q").code == 0
    np.testing.assert_allclose(places(read("posed.ply")), places(posed), rtol=0, atol=1e-6)


def test_normals_of_splats_are_turned(run, splats):
    splats["nz"] = 1
    Path("splats.ply").write_bytes(encode_rows(splats))
    assert run("deform", "cages.h5", "--mesh", "splats.ply", "-o", "out", "-q").code == 0
    found = normals_in(frames_in("out")[4])
    assert abs(found - [0, 0, 1]).max() > 0.01
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-6)


KEPT = {
    "no gradients": ({}, ["--coordinates", "mean-value"], "its normals keep their values: turning"),
    "whole numbers": ({"kind": "<i2"}, [], "(nx, ny, nz) are whole numbers and keep their values"),
    "two of three": ({"names": ("nx", "ny")}, [], "(nx, ny) are not all of nx, ny, nz and keep"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("case", KEPT)
def test_normals_that_are_not_turned_are_noted(run, cloud, command, case):
    how, words, note = KEPT[case]
    count = len(how.get("names", "xyz"))
    write_normals(cloud, [0] * count, **how)
    outcome = run(*COMMANDS[command], *words)
    assert outcome.code == 0, outcome.err
    assert "normals" not in outcome.err, "they are all zero"
    rows = write_normals(cloud, [0, 1, 0][:count], **how)
    outcome = run(*COMMANDS[command], *words, "--overwrite", "-v")
    assert outcome.code == 0, outcome.err
    assert note in " ".join(outcome.err.split())
    posed = read("posed.ply") if command == "pose" else frames_in("out")[4]
    np.testing.assert_array_equal(posed["ny"], rows["ny"])


def test_points_in_a_cage_turned_inside_out_are_counted(run, cloud):
    write_normals(cloud, [0, 1, 0])
    write_moved_cage("mirror_0.obj", np.diag([1, 1, -1]))
    outcome = run(*COMMANDS["deform"], "--cages", "mirror_0.obj")
    assert outcome.code == 0, outcome.err
    expected = "60 of 60 moved points are turned inside out: the cage folds over there"
    assert expected in " ".join(outcome.err.split())


def test_packed_points_are_read(run, cloud):
    Path("cloud.ply.gz").write_bytes(gzip.compress(Path("cloud.ply").read_bytes()))
    words = ("deform", "cages.h5", "--mesh", "cloud.ply.gz", "-q")
    assert run(*words, "-o", "all").code == 0
    np.testing.assert_array_equal(frames_in("all")[2]["heat"], cloud["heat"])


def test_points_are_moved_to_the_origin(run, cloud):
    words = ("deform", "cages.h5", "--mesh", "cloud.ply", "-q")
    assert run(*words, "-o", "here").code == 0
    outcome = run(*words, "-o", "there", "--recentre")
    assert outcome.code == 0, outcome.err
    offset = json.loads(Path("there.offset.json").read_text())["offset"]
    for one, other in zip(frames_in("here"), frames_in("there"), strict=True):
        np.testing.assert_allclose(places(other) + offset, places(one), rtol=0, atol=1e-6)


def test_points_of_a_mesh_move_as_its_vertices(run, extracted, animation):
    rest = animation.rest
    Path("points.ply").write_bytes(trimesh.PointCloud(rest.vertices).export(file_type="ply"))
    assert run("deform", "cages.h5", "--mesh", "points.ply", "-o", "points.npz", "-q").code == 0
    assert run("deform", "cages.h5", "-o", "mesh.npz", "-q").code == 0
    found, expected = (np.load(name)["vertices"] for name in ("points.npz", "mesh.npz"))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_points_outside_are_refused_or_taken_to_the_cage(run, cloud):
    cloud["x"][7] += 20
    Path("cloud.ply").write_bytes(encode_rows(cloud))
    words = ("deform", "cages.h5", "--mesh", "cloud.ply", "-o", "out")
    refused = run(*words)
    assert refused.code == 1
    assert "Error: cloud.ply: 1 of 60 vertices are outside the cage" in refused.err
    assert refused.err.count("cloud.ply") == 1
    assert "--outside project" in refused.err
    assert not Path("out").exists()
    assert run(*words, "--outside", "project").code == 0


def test_splats_move_as_their_rest_pose_says(run, splats):
    """The first frame is the rest pose: nothing changes."""
    outcome = run("deform", "cages.h5", "--mesh", "splats.ply", "-o", "out/s_####.ply")
    assert outcome.code == 0, outcome.err
    assert "5 frames of 60 splats" in outcome.err
    frames = frames_in("out")
    assert len(frames) == 5
    with h5py.File("cages.h5") as file:
        moved = abs(file["verts"][0] - file["cage/verts"][:]).max()
    np.testing.assert_allclose(places(frames[0]), places(splats), rtol=0, atol=2 * moved + 1e-6)
    for rows in frames:
        for name in ("opacity", "nx", "f_dc_0"):
            np.testing.assert_array_equal(rows[name], splats[name])
    assert abs(covariances(frames[4]) / covariances(splats) - 1).max() > 1e-3


def test_splats_have_the_same_bytes_with_any_memory_and_threads(run, splats):
    words = ("deform", "cages.h5", "--mesh", "splats.ply", "-q")
    assert run(*words, "-o", "one", "--jobs", "1").code == 0
    assert run(*words, "-o", "two", "--jobs", "2", "--memory", "1MiB").code == 0
    names = sorted(path.name.removeprefix("one_") for path in Path("one").iterdir())
    assert len(names) == 5
    for name in names:
        assert Path("one", f"one_{name}").read_bytes() == Path("two", f"two_{name}").read_bytes()


def test_splats_are_written_as_usd(run, splats):
    usd = pytest.importorskip("pxr.Usd")
    outcome = run("deform", "cages.h5", "--mesh", "splats.ply", "-o", "s.usdc")
    assert outcome.code == 0, outcome.err
    stage = usd.Stage.Open("s.usdc")
    prim = stage.GetPrimAtPath("/splats/splats")
    assert prim.GetAttribute("positions").GetNumTimeSamples() == 5


def test_splats_that_are_turned_inside_out_are_counted(run, splats, write_obj, animation):
    cage = animation.cage
    write_obj(Path("mirrored/c_1.obj"), cage.vertices * [-1, 1, 1], cage.faces)
    write_obj(Path("mirrored/c_2.obj"), cage.vertices * [1, 0, 1], cage.faces)
    words = ("deform", "cages.h5", "--mesh", "splats.ply", "-o", "out", "--cages", "mirrored")
    outcome = run(*words, "-v")
    assert outcome.code == 0, outcome.err
    text = " ".join(outcome.err.split())
    assert "60 of 120 moved splats are turned inside out" in text
    assert "60 of 120 moved splats are flattened" in text


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
@pytest.mark.parametrize("name", ["out", "s.usdc"])
def test_splats_too_far_for_their_type_are_refused(run, splats, write_obj, animation, name, kind):
    rows = splats.astype([(each, kind) for each in splats.dtype.names])
    Path("splats.ply").write_bytes(encode_rows(rows))
    write_obj(Path("far/c_1.obj"), 1e45 * animation.cage.vertices, animation.cage.faces)
    words = ("deform", "cages.h5", "--mesh", "splats.ply", "--cages", "far")
    outcome = run(*words, "-o", name)
    if name == "out" and kind == "<f8":
        assert outcome.code == 0, outcome.err
        return
    assert outcome.code == 1
    assert outcome.err.startswith(f"Error: {name}: a ")
    assert "too large for" in outcome.err
    assert not Path(name).exists()


@pytest.mark.parametrize("content", [b"", b"ply\nformat ascii 1.0\nelement vertex many\n"])
def test_a_file_that_is_no_model_is_named_once(run, extracted, content):
    Path("bad.ply").write_bytes(content)
    outcome = run("deform", "cages.h5", "--mesh", "bad.ply", "-o", "out")
    assert outcome.code == 1
    assert outcome.err.count("bad.ply") == 1


REFUSED = {
    "points as a mesh": ("cloud.ply", ["-o", "out/a_#.obj"], "a cloud of points; write .ply, .npz"),
    "points as a mesh, without a number": (
        "cloud.ply",
        ["-o", "a.obj"],
        "a.obj: a `.obj` cannot hold cloud.ply, which is a cloud of points; write .ply, .npz",
    ),
    "splats as a mesh": (
        "splats.ply",
        ["-o", "a.obj"],
        "a.obj: a `.obj` cannot hold splats.ply, which is a file of Gaussian splats; write .ply",
    ),
    "splats in a folder of a mesh": (
        "splats.ply",
        ["-o", "out", "--format", "obj"],
        "out: a `.obj` cannot hold splats.ply",
    ),
    "splats in one file": (
        "splats.ply",
        ["-o", "a.ply"],
        "a.ply: a `.ply` file holds one frame; name files in a folder, such as a/a_####.ply",
    ),
    "points in place of themselves": (
        "cloud.ply",
        ["-o", "./cloud_##.ply"],
        "is a folder with files that this command reads or writes",
    ),
    "one point": ("one.ply", ["-o", "out"], "one.ply: all points of the model are at one place"),
    "points as USD": ("cloud.ply", ["-o", "a.usdc"], "a cloud of points; write .ply, .npz"),
    "splats as arrays": ("splats.ply", ["-o", "a.npz"], "Gaussian splats; write .ply, .usd"),
    "splats of few influences": (
        "splats.ply",
        ["-o", "out", "--influences", "4"],
        "splats.ply: is a file of Gaussian splats, and weights of few influences are",
    ),
    "points of few influences": (
        "cloud.ply",
        ["-o", "out", "--influences", "4"],
        "cloud.ply: is a cloud of points, and weights of few influences are",
    ),
    "splats of mean values": (
        "splats.ply",
        ["-o", "out", "--coordinates", "mean-value"],
        "splats.ply: splats need gradients of weights",
    ),
    "splats moved to the origin": (
        "splats.ply",
        ["-o", "out", "--recentre"],
        "splats.ply: is a file of Gaussian splats, which --recentre cannot move",
    ),
    "damaged": ("damaged.ply", ["-o", "out"], "damaged.ply: announces 60 points"),
    "splats without a property": ("part.ply", ["-o", "out"], "part.ply: is a file of Gaussian"),
    "not finite": ("nan.ply", ["-o", "out"], "nan.ply: vertex 3 is (nan"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_done_is_said(run, cloud, splats, case):
    name, words, expected = REFUSED[case]
    Path("damaged.ply").write_bytes(Path("splats.ply").read_bytes()[:-9])
    Path("part.ply").write_bytes(Path("splats.ply").read_bytes().replace(b"rot_3", b"rat_3"))
    Path("one.ply").write_bytes(encode_rows(cloud[:1]))
    cloud["x"][3] = np.nan
    Path("nan.ply").write_bytes(encode_rows(cloud))
    outcome = run("deform", "cages.h5", "--mesh", name, *words)
    assert outcome.code == 1, outcome.err
    text = " ".join(outcome.err.split())
    assert expected in text
    assert "are they swapped" not in text
    assert not Path("out").exists()


def test_points_are_posed(run, cloud):
    words = ("pose", "cloud.ply", "h.json", "--cage", "cage.obj")
    outcome = run(*words, "-o", "posed.ply", "--plot", "posed.png")
    assert outcome.code == 0, outcome.err
    assert "volume" not in outcome.err, "points have none"
    rows = read("posed.ply")
    np.testing.assert_array_equal(rows["heat"], cloud["heat"])
    np.testing.assert_allclose(places(rows)[3] - places(cloud)[3], [0.1, 0.2, 0], rtol=0, atol=1e-2)
    for name in ("posed.obj", "posed.usdc"):
        refused = run(*words, "-o", name)
        assert refused.code == 1
        assert "which is a cloud of points; write a .ply" in " ".join(refused.err.split())


def test_splats_are_posed(run, splats):
    outcome = run("pose", "splats.ply", "h.json", "--cage", "cage.obj", "-o", "posed.ply")
    assert outcome.code == 0, outcome.err
    rows = read("posed.ply")
    np.testing.assert_array_equal(rows["opacity"], splats["opacity"])
    moved = places(rows)[3] - places(splats)[3]
    np.testing.assert_allclose(moved, [0.1, 0.2, 0], rtol=0, atol=1e-2)
    assert abs(covariances(rows) / covariances(splats) - 1).max() > 1e-3


def test_a_pose_of_splats_needs_gradients(run, splats):
    words = ("--cage", "cage.obj", "-o", "posed.ply", "--coordinates", "mean-value")
    outcome = run("pose", "splats.ply", "h.json", *words)
    assert outcome.code == 1
    assert "splats.ply: splats need gradients of weights" in outcome.err
    assert not Path("posed.ply").exists()


def test_info_says_what_a_file_of_points_holds(run, cloud):
    outcome = run("info", "cloud.ply")
    assert outcome.code == 0
    assert "a cloud of points" in outcome.out
    assert "x, y, z, red, heat" in outcome.out
    outcome = run("info", "splats.ply")
    assert "a file of Gaussian splats" in outcome.out
    assert "splats         60" in outcome.out
    assert "spherical harmonics up to band 3" in outcome.out


PLACES = {
    "face": {"face": 0, "barycentric": [0.2, 0.3, 0.5]},
    "position": {"position": [0.5, 0.5, 0.5]},
}


@pytest.mark.parametrize("place", PLACES)
def test_handles_of_points_are_vertices(run, cloud, place):
    handle = {"name": "a", "offset": [0.1, 0, 0], **PLACES[place]}
    Path("h.json").write_text(json.dumps({"handles": [handle]}))
    words = ("--cage", "cage.obj", "-o", "posed.ply", "--snap", "5%")
    outcome = run("pose", "cloud.ply", "h.json", *words)
    assert outcome.code == 1
    assert "a cloud of points and has no surface; name one of its points" in outcome.err
