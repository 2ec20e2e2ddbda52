"""A shader draws the frames that were written: places, normals and the size of motions."""

import json
from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.settings import TEXTURES, Scene
from cageik_cli.formats.vat import layout as layouts
from cageik_cli.formats.vat.writer import IMAGES
from cageik_cli.formats.write import Output, write_animation
from cageik_cli.geometry.attributes import number_normal_fans
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import OutputError
from cageik_cli.util.progress import ProgressListener
from tests.character import make_character
from tests.formats.vat.shader import draw
from tests.formats.vat.truth import SCENES, Z_UP, angle_between, list_triangles, shade
from tests.formats.written import bytes_under, write
from tests.listeners import Listener
from tests.shapes import ball, box, rotation
from tests.surfaces import ASSET, change

pytest.importorskip("png")
pytest.importorskip("OpenEXR")


def open_sheet():
    """A sheet with a boundary."""
    u, v = np.meshgrid(np.linspace(0, 1, 12), np.linspace(0, 1, 9))
    corner = (12 * np.arange(8)[:, None] + np.arange(11)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 13], 1),
            np.stack([corner, corner + 13, corner + 12], 1),
        ]
    )
    return TriMesh(np.stack([u, v, 0.1 * np.sin(4 * u)], -1).reshape(-1, 3), faces)


def hard_box():
    """A box with the normals of its faces."""
    mesh = box(0.7)
    polygons = mesh.polygons
    fans = number_normal_fans(polygons.corners, np.repeat(np.arange(len(mesh.faces)), 3))
    return replace(mesh, attributes=replace(polygons, normal_fans=fans))


MESHES = {
    "closed": ball(2),
    "open": open_sheet(),
    "hard edges": hard_box(),
    "parts": make_character()[0],
    "seams and materials": ASSET,
    "seams alone": change(ASSET, normal_fans=None, materials=None),
    "in several blocks": ball(3),
}


def bend(mesh, count):
    """Frames in which a mesh bends, twists and moves away."""
    middle = mesh.vertices.mean(axis=0)
    x, y, z = ((mesh.vertices - middle) / mesh.diagonal).T
    frames = []
    for k in range(count):
        angle = 1.5 * k / count * (1 + 2 * z)
        rows = np.stack(
            [np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y,
             z * (1 + 0.3 * np.sin(k)) + 0.4 * k / count], axis=1,
        )  # fmt: skip
        frames.append(middle + mesh.diagonal * rows)
    return np.array(frames)


def corners(drawn, values):
    """Values of vertices, (..., k, 3), at the corners of all triangles."""
    found = [getattr(each, values)[..., each.faces, :] for each in drawn]
    return np.concatenate(found, axis=-3)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("kind", MESHES)
def test_a_shader_draws_the_frames(tmp_path, kind, scene):
    mesh, (settings, change) = MESHES[kind], SCENES[scene]
    frames = bend(mesh, 60 if kind == "in several blocks" else 7)
    folder = write(tmp_path / "a.vat", mesh, frames, scene=settings)
    drawn = draw(folder)
    remap = json.loads((folder / "a-remap_info.json").read_text())["os-remap"]
    steps = (np.array(remap["Max"]) - remap["Min"]) / 65535
    order = list_triangles(mesh)
    expected = (frames @ change)[:, mesh.faces[order]]
    found = corners(drawn, "positions")
    # Half a step along each axis, and single precision of what is added.
    allowed = steps[[0, 2, 1]] / 2 + 1e-6 * mesh.diagonal * settings.metres_per_unit
    assert (np.abs(found - expected) <= allowed).all()
    np.testing.assert_allclose(
        corners(drawn, "rest"), (mesh.vertices @ change)[mesh.faces[order]], rtol=1e-6, atol=1e-7
    )
    turn = change / settings.metres_per_unit
    normals = shade(mesh, frames)[:, order] @ turn
    assert angle_between(corners(drawn, "normals"), normals) < 0.01
    assert (
        angle_between(corners(drawn, "rest_normals"), shade(mesh, mesh.vertices)[order] @ turn)
        < 0.01
    )


def test_the_check_of_normals_sees_those_that_do_not_turn(tmp_path):
    mesh = MESHES["closed"]
    frames = mesh.vertices @ np.array([rotation(k) for k in range(3)])
    drawn = draw(write(tmp_path / "a.vat", mesh, frames))
    still = shade(mesh, mesh.vertices)[list_triangles(mesh)]
    assert angle_between(corners(drawn, "normals"), still) > 20
    turned = still @ np.array([rotation(k) for k in range(3)])[:, None]
    assert angle_between(corners(drawn, "normals"), turned) < 0.01


@pytest.mark.parametrize("kind", ["closed", "seams and materials"])
def test_floats_are_exact_to_single_precision(tmp_path, kind):
    mesh = MESHES[kind]
    frames = bend(mesh, 5)
    animation = Animation(mesh, 5, Scene(), "a", texture="exr")
    output = Output(tmp_path / "a.vat")
    write_animation(output, animation, iter([frames]), ProgressListener())
    assert sorted(path.name for path in output.path.iterdir()) == [
        "a-remap_info.json", "a.glb", "a_vat.exr", "a_vnrm.exr"
    ]  # fmt: skip
    found = corners(draw(output.path), "positions")
    expected = frames[:, mesh.faces[list_triangles(mesh)]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * mesh.diagonal)


def test_the_note_states_the_largest_error_of_a_place(tmp_path):
    mesh, listener = MESHES["closed"], Listener()
    frames = bend(mesh, 40)
    animation = Animation(mesh, 40, Scene(), "a")
    write_animation(Output(tmp_path / "a.vat"), animation, iter([frames]), listener)
    (note,) = [str(text) for _, text in listener.notes if "texels" in str(text)]
    stated = float(note.split("up to ")[1].split(" %")[0])
    found = corners(draw(tmp_path / "a.vat"), "positions")
    missed = np.linalg.norm(found - frames[:, mesh.faces], axis=-1).max() / mesh.diagonal
    assert 0.4 * stated < 100 * missed < 1.03 * stated


def test_a_model_that_rests_has_no_bounds_to_divide_by(tmp_path):
    mesh = MESHES["closed"]
    drawn = draw(write(tmp_path / "a.vat", mesh, np.stack([mesh.vertices] * 2)))
    expected = mesh.vertices[mesh.faces]
    np.testing.assert_allclose(corners(drawn, "positions")[1], expected, rtol=0, atol=1e-7)


def test_what_the_json_says(tmp_path):
    mesh, scene = MESHES["closed"], Scene(fps=30, frame_step=2, up_axis="Z")
    frames = bend(mesh, 9)
    folder = write(tmp_path / "walk.vat", mesh, frames, scene=scene, name="hero")
    info = json.loads((folder / "walk-remap_info.json").read_text())
    moves = frames - mesh.vertices  # textures have z up, as the scene
    assert info["os-remap"]["Frames"] == 9
    np.testing.assert_allclose(info["os-remap"]["Min"], moves.min(axis=(0, 1)), rtol=1e-6)
    np.testing.assert_allclose(info["os-remap"]["Max"], moves.max(axis=(0, 1)), rtol=1e-6)
    clip = {"startFrame": 0, "endFrame": 8, "framerate": 15.0, "looping": True}
    assert info["animations"] == {"hero": clip}
    bounds = info["cageik"].pop("Bounds")
    assert info["cageik"] == {"Vertices": 66, "Width": 32, "Height": 32}
    np.testing.assert_allclose(bounds["Min"], (frames @ Z_UP).min(axis=(0, 1)), rtol=1e-12)
    np.testing.assert_allclose(bounds["Max"], (frames @ Z_UP).max(axis=(0, 1)), rtol=1e-12)


def test_vertices_at_which_only_uvs_differ_share_texels(tmp_path):
    uvs = change(ASSET, normal_fans=number_normal_fans(*[ASSET.attributes.corners] * 2))
    folder = write(tmp_path / "a.vat", uvs, bend(uvs, 2))
    used = len(np.unique(uvs.faces))
    assert json.loads((folder / "a-remap_info.json").read_text())["cageik"]["Vertices"] == used
    assert sum(len(each.rest) for each in draw(folder)) > used


def test_neither_folder_nor_time_change_the_bytes(tmp_path):
    mesh, found = MESHES["seams and materials"], []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        found.append(bytes_under(write(tmp_path / folder / "a.vat", mesh, bend(mesh, 3))))
    assert found[0] == found[1]


def test_frames_without_a_place_are_refused_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(layouts, "MAX_SIDE", 16)
    mesh = MESHES["closed"]
    with pytest.raises(OutputError, match="9 frames of 66 vertices have no place in a texture"):
        write(tmp_path / "a.vat", mesh, bend(mesh, 9))
    assert list(tmp_path.iterdir()) == []


def test_a_large_side_is_noted(tmp_path, monkeypatch):
    monkeypatch.setattr("cageik_cli.formats.vat.writer.SAFE_SIDE", 8)
    mesh, listener = MESHES["closed"], Listener()
    animation = Animation(mesh, 3, Scene(), "a")
    write_animation(Output(tmp_path / "a.vat"), animation, iter([bend(mesh, 3)]), listener)
    assert any("more than 8 texels" in str(text) for _, text in listener.notes)


def test_each_format_of_textures_has_an_encoder():
    assert set(IMAGES) == set(TEXTURES)


@pytest.mark.parametrize("scene", SCENES)
def test_the_offset_of_what_was_moved_is_in_the_space_of_the_mesh(tmp_path, scene):
    mesh, (settings, change) = MESHES["closed"], SCENES[scene]
    far = TriMesh(mesh.vertices + np.array([4000.0, 300, 20]), mesh.faces)
    frames = bend(far, 3)
    output = Output(tmp_path / "a.vat", recentre=True)
    animation = Animation(far, 3, settings, "a", texture="exr")
    write_animation(output, animation, iter([frames]), ProgressListener())
    offset = json.loads((tmp_path / "a.vat.offset.json").read_text())["offset"]
    found = corners(draw(tmp_path / "a.vat"), "positions") + offset
    allowed = 1e-6 * mesh.diagonal * settings.metres_per_unit
    np.testing.assert_allclose(found, (frames @ change)[:, far.faces], rtol=1e-12, atol=allowed)
