"""Morph targets: few, within the error that is said, and what other programs read of them."""

import numpy as np
import pygltflib
import pytest
import trimesh

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.gltf.morphs import Writer
from cageik_cli.formats.open import load_mesh, open_sequence
from cageik_cli.formats.settings import MAX_MORPHS, ClipSettings, MorphSettings, Scene
from cageik_cli.formats.write import Output
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import split_parts
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.util.errors import OutputError
from tests.character import NAMES, make_character
from tests.clips import frames_of
from tests.formats.gltf.decoded import Glb
from tests.formats.written import write
from tests.texts import texts

RANDOM = np.random.default_rng(5)


@pytest.fixture
def scene():
    return Scene(fps=30.0, start=7.0, up_axis="Z", metres_per_unit=0.01)


@pytest.fixture
def restless(animation):
    """Forty frames that differ in every way, by less and less."""
    scales = 0.8 ** np.arange(40)
    moves = np.linalg.qr(RANDOM.normal(size=(54, 54)))[0][:40] * scales[:, None]
    loads = RANDOM.normal(size=(40, 40))
    return animation.rest.vertices + (loads @ moves).reshape(40, -1, 3)


def save(path, mesh, frames, size=7, **morphs):
    """Write frames, and return the file and the note on the targets."""
    animation = Animation(mesh, len(frames), Scene(), "thing", morphs=MorphSettings(**morphs))
    with Output(path, overwrite=True).open_writer(animation) as writer:
        for start in range(0, len(frames), size):
            writer.append(frames[start : start + size])
    (note,) = [note for note in texts(writer.notes) if "morph target" in note]
    return Glb(path), note


def measure(file, mesh, frames):
    """The rms and the largest error, percent of the diagonal."""
    distances = np.linalg.norm(file.frames()[1] - frames, axis=2)
    return 100 * np.array([np.sqrt(np.mean(distances**2)), distances.max()]) / mesh.diagonal


def test_the_frames_come_back_at_their_times(tmp_path, animation, scene):
    moved = TriMesh(animation.rest.vertices + 5, animation.rest.faces)
    file = Glb(write(tmp_path / "a.glb", moved, animation.frames, scene=scene))
    times, frames = file.frames()
    np.testing.assert_allclose(times, np.arange(5) / 30, rtol=1e-6)
    np.testing.assert_allclose(frames, animation.frames, rtol=0, atol=2e-6)
    np.testing.assert_array_equal(file.faces(), animation.rest.faces)
    np.testing.assert_array_equal(file.attribute("POSITION"), moved.vertices.astype("f4"))
    for index in [file.primitives[0]["attributes"], *file.primitives[0]["targets"]]:
        assert {"min", "max"} <= set(file.json["accessors"][index["POSITION"]])
    assert file.json["asset"]["version"] == "2.0"


@pytest.mark.parametrize("count", [2, 3, 10, 25])
def test_the_error_is_the_one_that_is_said(tmp_path, animation, restless, count):
    file, note = save(tmp_path / "a.glb", animation.rest, restless, morphs=count)
    assert len(file.targets("POSITION")) == count
    rms, largest = measure(file, animation.rest, restless)
    said = f"{count} morph targets; error: rms {rms:.2g}, largest {largest:.2g} % of the diagonal"
    assert note == said
    extras = file.json["meshes"][0]["extras"]
    assert extras["cageik"]["morphs"] == len(extras["targetNames"]) == count
    found = [extras["cageik"][name] for name in ("rms_percent", "largest_percent")]
    np.testing.assert_allclose(found, [rms, largest], rtol=0.01)


@pytest.mark.parametrize("count", [2, 3, 10, 25])
def test_no_other_targets_are_nearer(tmp_path, animation, restless, count):
    """The rms error is that of the mean and the largest singular vectors around it."""
    file, _ = save(tmp_path / "a.glb", animation.rest, restless, morphs=count)
    spread = (restless - restless.mean(axis=0)).reshape(40, -1)
    left = np.linalg.svd(spread, compute_uv=False)[count - 1 :]
    best = 100 * np.sqrt(np.square(left).sum() / (40 * 18)) / animation.rest.diagonal
    np.testing.assert_allclose(measure(file, animation.rest, restless)[0], best, rtol=1e-4)


def test_weights_are_sliders(tmp_path, animation, restless):
    """From 0 to 1: Blender cuts off others. The first is 1 throughout."""
    file, _ = save(tmp_path / "a.glb", animation.rest, restless, morphs=20)
    _, weights = file.track()
    assert weights.min() == 0
    assert weights.max() == 1
    np.testing.assert_array_equal(weights[:, 0], 1)
    np.testing.assert_array_equal(np.ptp(weights[:, 1:], axis=0), 1)
    assert not any(file.json["meshes"][0]["weights"])


@pytest.mark.parametrize("tolerance", [20.0, 5.0, 1.0, 0.5])
def test_a_tolerance_is_kept_with_few_targets(tmp_path, animation, restless, tolerance):
    file, _ = save(tmp_path / "a.glb", animation.rest, restless, tolerance=tolerance)
    count = len(file.targets("POSITION"))
    assert measure(file, animation.rest, restless)[1] <= tolerance
    fewer, _ = save(tmp_path / "b.glb", animation.rest, restless, morphs=count - 1)
    assert measure(fewer, animation.rest, restless)[1] > tolerance


def test_a_tolerance_that_cannot_be_kept_is_refused(tmp_path, animation, restless):
    says = (
        r"a.glb: 5 morph targets leave a largest error of .* % of the diagonal, above the "
        r"tolerance of 0.01 %; give a higher `tolerance=` or a higher `morphs=`, or write"
    )
    with pytest.raises(OutputError, match=says):
        save(tmp_path / "a.glb", animation.rest, restless, morphs=5, tolerance=0.01)
    says = r"a.glb: \d+ morph targets leave .* give a higher `tolerance=`, or write"
    with pytest.raises(OutputError, match=says):
        save(tmp_path / "a.glb", animation.rest, restless, tolerance=1e-12)
    assert not list(tmp_path.iterdir())


def test_no_more_targets_than_motion_needs(tmp_path, animation):
    """A motion along two directions has the mean and these, whatever number is allowed."""
    loads, moves = RANDOM.normal(size=(30, 2)), RANDOM.normal(size=(2, 54))
    frames = animation.rest.vertices + (loads @ moves).reshape(30, -1, 3)
    file, note = save(tmp_path / "a.glb", animation.rest, frames)
    assert note == "3 morph targets; exact to single precision"
    assert len(file.targets("POSITION")) == 3


def test_sixty_targets_are_enough_unless_more_are_asked_for(tmp_path):
    mesh = trimesh.creation.icosphere(3)
    rest = TriMesh(mesh.vertices, mesh.faces)
    frames = rest.vertices + RANDOM.normal(size=(90, *rest.vertices.shape))
    for morphs, count in (({}, 60), ({"morphs": 80}, 80), ({"tolerance": 1e-3}, 90)):
        file, _ = save(tmp_path / "a.glb", rest, frames, **morphs)
        assert len(file.json["meshes"][0]["extras"]["targetNames"]) == count


def test_a_tolerance_has_as_many_targets_as_viewers_take(tmp_path):
    mesh = trimesh.creation.icosphere(3)
    rest = TriMesh(mesh.vertices, mesh.faces)
    frames = rest.vertices + RANDOM.normal(size=(MAX_MORPHS + 40, *rest.vertices.shape))
    with pytest.raises(OutputError, match=f"{MAX_MORPHS} morph targets leave"):
        save(tmp_path / "a.glb", rest, frames, tolerance=0.01)


@pytest.mark.parametrize("is_turned", [False, True])
def test_many_frames_have_vectors_of_some(tmp_path, monkeypatch, animation, is_turned):
    """A smooth motion is followed although only every third frame was looked at."""
    monkeypatch.setattr("cageik_cli.formats.gltf.morphs.MAX_SAMPLED_FRAMES", 30)
    turn = np.linspace(0, 3, 90)
    loads = np.stack([np.cos(turn), np.sin(turn), turn**2], axis=1)
    frames = animation.rest.vertices + (loads @ RANDOM.normal(size=(3, 54))).reshape(90, -1, 3)
    file, note = save(tmp_path / "a.glb", animation.rest, frames[:: -1 if is_turned else 1])
    assert note == "4 morph targets; exact to single precision"
    assert measure(file, animation.rest, frames[:: -1 if is_turned else 1])[1] < 1e-4


def test_a_rigid_motion_needs_no_more_than_its_matrices(tmp_path, animation):
    """Nine entries of the matrix and three of the place, around the mean."""
    turns = trimesh.transformations.random_rotation_matrix
    frames = [animation.rest.vertices @ turns(RANDOM.random(3))[:3, :3] + k / 10 for k in range(40)]
    _, note = save(tmp_path / "a.glb", animation.rest, np.array(frames))
    assert int(note.split()[0]) <= 13
    assert note.endswith("exact to single precision")


def test_a_clip_of_one_frame(tmp_path, animation):
    file, note = save(tmp_path / "a.glb", animation.rest, animation.frames[2:3])
    times, frames = file.frames()
    assert times == [0]
    np.testing.assert_allclose(frames[0], animation.frames[2], rtol=0, atol=1e-6)
    assert note == "1 morph target; exact to single precision"


def test_a_clip_that_stands_still(tmp_path, animation):
    frames = np.repeat(animation.rest.vertices[None], 4, axis=0)
    file, note = save(tmp_path / "a.glb", animation.rest, frames, has_normals=True)
    np.testing.assert_allclose(file.frames()[1], frames, rtol=0, atol=1e-6)
    assert len(file.track()[0]) == 4
    assert note == "1 morph target; exact to single precision"


def test_blocks_of_vertices_change_rounding_only(tmp_path, monkeypatch, animation, restless):
    before, _ = save(tmp_path / "a.glb", animation.rest, restless, morphs=9, has_normals=True)
    monkeypatch.setattr("cageik_cli.formats.gltf.file.MAX_SPOOL_BYTES", 24 * 40 * 5)
    after, _ = save(tmp_path / "b.glb", animation.rest, restless, morphs=9, has_normals=True)
    for name in ("POSITION", "NORMAL"):
        np.testing.assert_allclose(after.morph(name), before.morph(name), rtol=0, atol=1e-5)


# --- normals


def test_normals_follow_the_frames(tmp_path, animation, restless):
    """As many targets as frames give each its normals; those of the rest pose would not do."""
    frames = 0.2 * restless[:12] + 0.8 * animation.rest.vertices
    polygons = animation.rest.polygons
    file, _ = save(tmp_path / "a.glb", animation.rest, frames, has_normals=True)
    assert len(file.targets("NORMAL")) == 12
    expected = np.array([compute_vertex_normals(polygons, frame) for frame in frames])
    np.testing.assert_allclose(file.morph("NORMAL"), expected, rtol=0, atol=1e-4)
    assert np.abs(file.attribute("NORMAL") - expected[-1]).max() > 0.03
    lengths = np.linalg.norm(file.attribute("NORMAL"), axis=1)
    np.testing.assert_allclose(lengths, 1, rtol=0, atol=1e-6)


def test_few_targets_have_the_nearest_normals(tmp_path, animation, restless):
    file, _ = save(tmp_path / "a.glb", animation.rest, restless, morphs=4, has_normals=True)
    polygons = animation.rest.polygons
    wanted = np.array([compute_vertex_normals(polygons, frame) for frame in restless])
    wanted = (wanted - compute_vertex_normals(polygons, animation.rest.vertices)).reshape(40, -1)
    weights = file.track()[1].astype(float)
    nearest = np.linalg.lstsq(weights, wanted, rcond=None)[0].reshape(4, -1, 3)
    np.testing.assert_allclose(file.targets("NORMAL"), nearest, rtol=0, atol=1e-5)


def test_without_normals_there_are_none(tmp_path, animation):
    file, _ = save(tmp_path / "a.glb", animation.rest, animation.frames)
    assert set(file.primitives[0]["attributes"]) == {"POSITION"}
    assert all(set(target) == {"POSITION"} for target in file.primitives[0]["targets"])


def test_a_vertex_without_faces_has_a_normal(tmp_path, animation):
    rest = TriMesh(np.vstack([animation.rest.vertices, [[3, 3, 3]]]), animation.rest.faces)
    file, _ = save(tmp_path / "a.glb", rest, rest.vertices[None], has_normals=True)
    np.testing.assert_array_equal(file.attribute("NORMAL")[-1], [0, 0, 1])


# --- others


def test_pygltflib_and_trimesh_read_it(tmp_path, animation):
    path = write(tmp_path / "a.glb", animation.rest, animation.frames, name="cage")
    loaded = pygltflib.GLTF2().load(str(path))
    assert loaded.nodes[0].name == loaded.meshes[0].name == "cage"
    assert loaded.nodes[0].rotation is loaded.nodes[0].scale is None
    assert len(loaded.meshes[0].primitives[0].targets) == len(loaded.meshes[0].weights) == 2
    mesh = trimesh.load(path, process=False, force="mesh")
    np.testing.assert_allclose(mesh.vertices, animation.rest.vertices, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, animation.rest.faces)


def test_it_stands_upright_and_in_metres(tmp_path, animation, scene):
    """What is up in the file's own space is +y, and a hundred units are a metre."""
    path = write(tmp_path / "a.glb", animation.rest, animation.frames, scene=scene)
    whole = trimesh.load(path, process=False)
    (node,) = whole.graph.nodes_geometry
    transform, _ = whole.graph[node]
    up = transform @ [0, 0, 100, 1]
    np.testing.assert_allclose(up, [0, 1, 0, 1], rtol=0, atol=1e-7)
    np.testing.assert_allclose(transform @ [100, 0, 0, 1], [1, 0, 0, 1], rtol=0, atol=1e-7)


# --- refusals and notes


@pytest.mark.parametrize(("start", "count"), [(0, 0), (1, 0), (1001, 1), (-5, 1)])
def test_the_first_frame_is_at_zero_seconds_and_its_number_is_kept(
    tmp_path, animation, start, count
):
    described = Animation(animation.rest, 5, Scene(start=start), "a")
    with Output(tmp_path / "a.glb").open_writer(described) as writer:
        writer.append(animation.frames)
    notes = [note for note in texts(writer.notes) if f"frame {start} is at 0 s" in note]
    assert len(notes) == count == len(texts(writer.notes)) - 1
    assert Glb(tmp_path / "a.glb").frames()[0][0] == 0
    assert open_sequence([str(tmp_path / "a.glb")]).scene.start == start


@pytest.mark.parametrize(
    ("morphs", "says"),
    [({}, "0.2 GiB"), ({"morphs": 256}, "0.7 GiB"), ({"has_normals": True}, "0.3 GiB"),
     ({"tolerance": 1.0}, None)],
)  # fmt: skip
def test_what_there_is_no_room_for_is_refused_at_once(
    tmp_path, monkeypatch, animation, morphs, says
):
    monkeypatch.setattr("cageik_cli.formats.gltf.morphs.MAX_GLB_BYTES", 1 << 27)
    rest = TriMesh(np.tile(animation.rest.vertices, (240_000 // 18, 1)), animation.rest.faces)
    described = Animation(rest, 1000, Scene(), "a", morphs=MorphSettings(**morphs))
    if says is None:
        Writer(tmp_path / "a.glb", described).abandon()
    else:
        with pytest.raises(OutputError, match=f"it would take {says}, and a .glb holds less"):
            Writer(tmp_path / "a.glb", described)
    assert not list(tmp_path.iterdir())


def test_a_file_that_has_grown_too_large_is_refused(tmp_path, monkeypatch, animation):
    monkeypatch.setattr("cageik_cli.formats.gltf.file.MAX_GLB_BYTES", 500)
    with pytest.raises(OutputError, match=r"a.glb: it would take 0.0 GiB"):
        save(tmp_path / "a.glb", animation.rest, animation.frames, tolerance=1.0)
    assert not list(tmp_path.iterdir())


UPRIGHT = 0.01 * np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
"""From z up and centimetres to y up and metres, for rows."""


@pytest.fixture(scope="module")
def character():
    return make_character()


def find_places(points, others):
    """Which of other points each point is."""
    return np.array([np.abs(others - point).sum(axis=1).argmin() for point in points])


def list_corners(mesh):
    """The places and texture coordinates of the corners of all triangles, in any order."""
    look, rows = mesh.attributes, []
    for face, polygon in zip(mesh.faces.tolist(), look.triangle_polygons, strict=True):
        start = look.starts[polygon]
        ring = look.corners[start : start + look.corner_counts[polygon]].tolist()
        for vertex in face:
            uv = look.uvs.values[look.uvs.indices[start + ring.index(vertex)]]
            rows.append([*mesh.vertices[vertex], *uv])
    rows = np.array(rows)
    return rows[np.lexsort(rows.round(4).T)]


@pytest.mark.parametrize(
    ("scene", "axes"),
    [(Scene(30.0, 11.0, frame_step=2.0), np.eye(3)), (Scene(25.0, 3.0, "Z", 0.01), UPRIGHT)],
)
def test_a_character_comes_back_with_its_parts(tmp_path, character, scene, axes):
    model, frames = character
    clip = open_sequence([str(write(tmp_path / "a.glb", model, frames, scene=scene))])
    assert len(clip) == len(frames)
    found = clip.scene
    assert (found.fps, found.start, found.frame_step or 1) == (
        scene.fps,
        scene.start,
        scene.frame_step,
    )
    assert clip.first.attributes.parts.names == NAMES
    diagonal = clip.first.diagonal
    for mine, part in zip(split_parts(clip.first), split_parts(model), strict=True):
        look, expected = mine.mesh.attributes, part.mesh.attributes
        assert look.materials.names == expected.materials.names
        np.testing.assert_allclose(look.material_colours, expected.material_colours, rtol=1e-6)
        placed = part.mesh.move(part.mesh.vertices @ axes)
        places = find_places(mine.mesh.vertices, placed.vertices)
        assert sorted(places) == list(range(len(placed.vertices)))
        np.testing.assert_allclose(
            np.array([frame[mine.vertices] for frame in clip]),
            frames[:, part.vertices][:, places] @ axes,
            rtol=0,
            atol=1e-6 * diagonal,
        )
        corners = list_corners(mine.mesh)
        np.testing.assert_allclose(corners, list_corners(placed), rtol=0, atol=1e-6)


@pytest.mark.parametrize("fps", [None, 30.0, 15.0])
def test_a_late_start_comes_back_at_the_rate_that_is_stated(tmp_path, character, fps):
    scene = Scene(30.0, 123_456.0)
    path = write(tmp_path / "a.glb", *character, scene=scene)
    found = open_sequence([str(path)], ClipSettings(fps=fps)).scene
    assert found.start == (0 if fps == 15 else 123_456)


@pytest.mark.usefixtures("input_elsewhere")
@pytest.mark.parametrize(
    ("command", "same", "member"),
    [
        ("deform cages.h5 -o rig.glb --morphs 6", "", ""),
        ("export cages.h5 rig.glb --with-model", "", "::/cage/model"),
        ("export cages.h5 rig.glb --skeleton --influences 4", "--influences 4", ""),
        ("export cages.h5 rig.glb", None, ""),
    ],
)
def test_what_commands_write_is_read_back(extracted, run, command, same, member):
    outcome = run(*command.split())
    assert outcome.code == 0, outcome.err
    expected = open_sequence(["cages.h5"])
    if same is not None:
        assert run("deform", "cages.h5", "-o", "same.npz", *same.split(), "-q").code == 0
        expected = open_sequence(["same.npz"])
    clip = open_sequence([f"rig.glb{member}"])
    np.testing.assert_array_equal(clip.first.faces, expected.first.faces)
    np.testing.assert_allclose(
        frames_of(clip), frames_of(expected), rtol=0, atol=1e-6 * expected.first.diagonal
    )
    assert clip.scene.start == 1
    mesh = load_mesh(f"rig.glb{member}").mesh
    np.testing.assert_array_equal(mesh.vertices, clip.first.vertices)
