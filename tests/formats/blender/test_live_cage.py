"""The folder of a live cage: its arrays give the mesh that `deform` writes, and Blender's files."""

import ast
import errno
import io
import json
import os
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli import deform, export
from cageik_cli.formats.blender import live_cage
from cageik_cli.formats.blender.live_cage import find_sharp_edges, make_extension
from cageik_cli.geometry.attributes import FaceLabels, SurfaceAttributes, UvMap
from cageik_cli.geometry.shape import shade_smoothly
from cageik_cli.util.errors import OutputError
from cageik_cli.util.version import __version__
from tests.character import COLOURS, NAMES, make_parts
from tests.refusals import refused
from tests.shapes import quad_box

FILES = ["cageik_live_cage.zip", "live_cage.npz", "open_in_blender.py"]
TO_BLENDER = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
"""Rows with y up times it are rows with z up: (x, y, z) becomes (x, -z, y)."""


def read(folder):
    """What is said of a live cage, and its arrays."""
    with np.load(folder / "live_cage.npz", allow_pickle=False) as file:
        arrays = dict(file)
    return json.loads(str(arrays.pop("about"))), arrays


def move(about, arrays):
    """The frames (F, m, 3) that Blender computes, but for its rounding."""
    held = {name: array.astype(float) for name, array in arrays.items()}
    moves, turns = held["moves"][:, :-3], held["moves"][:, -3:]
    return (
        np.array(about["origin"])
        + held["rest"]
        + np.einsum("nm,fnx->fmx", held["weights"], moves)
        + held["offsets"] @ turns
    )


def compare(result, folder, **settings):
    """How far the frames of a live cage are from those of `deform`, in diagonals."""
    export(result, folder / "live", blender=True, **settings)
    deform(result, folder / "mesh.npz", to="m,z", **settings)
    with np.load(folder / "mesh.npz") as file:
        expected = file["vertices"]
    found = move(*read(folder / "live"))
    return np.abs(found - expected).max() / np.linalg.norm(np.ptp(expected[0], axis=0))


@pytest.fixture(scope="session")
def few(make_fitted):
    """A result with weights of few influences, and so with offsets that turn."""
    return make_fitted(influences=3)


@pytest.fixture(scope="session")
def plain(closed):
    return closed.result


@pytest.fixture(scope="session")
def ranked(make_fitted):
    return make_fitted(rank=3)


@pytest.mark.parametrize("kind", ["plain", "fitted", "few", "ranked", "edited", "character_result"])
@pytest.mark.parametrize("settings", [{}, {"up_axis": "Z", "metres_per_unit": 0.01}], ids=str)
def test_every_kind_of_result_moves_as_deform_does(request, tmp_path, kind, settings):
    result = request.getfixturevalue(kind)
    assert compare(result, tmp_path, **settings) < 3e-7
    assert (kind == "few") == result.has_offsets


@pytest.mark.parametrize("array", ["rest", "weights", "moves", "offsets"])
def test_arrays_that_are_wrong_move_otherwise(few, tmp_path, array):
    compare(few, tmp_path)
    about, arrays = read(tmp_path / "live")
    right = move(about, arrays)
    arrays[array] = arrays[array].copy()
    arrays[array].flat[-1] += 1e-3
    assert np.abs(move(about, arrays) - right).max() > 1e-5


def test_offsets_and_their_turns_are_zero_where_there_are_none(plain, few, tmp_path):
    for result, is_there in ((plain, False), (few, True)):
        export(result, tmp_path / "live", blender=True, overwrite=True)
        _, arrays = read(tmp_path / "live")
        assert arrays["offsets"].any() == is_there
        assert arrays["moves"][:, -3:].any() == is_there


def test_rest_is_in_metres_with_z_up(plain, tmp_path):
    written = export(plain, tmp_path / "live", blender=True, metres_per_unit=0.01)
    said = str(written.notes[0])
    assert said == "live: converted from centimetres, y up to metres, z up"
    about, arrays = read(tmp_path / "live")
    expected = 0.01 * plain.cage.vertices @ TO_BLENDER
    np.testing.assert_allclose(arrays["cage"], expected, rtol=1e-6, atol=0)
    np.testing.assert_allclose(
        arrays["rest"], 0.01 * plain.rest.vertices @ TO_BLENDER, rtol=0, atol=1e-6
    )
    assert about["origin"] == [0, 0, 0]


def test_time_is_that_of_the_result_unless_settings_say_more(plain, tmp_path):
    names = ("fps", "start", "frame_step", "frame_count")
    export(plain, tmp_path / "live", blender=True)
    assert [read(tmp_path / "live")[0][name] for name in names] == [24, 1, 1, 5]
    more = {"fps": 29.97, "start": 7, "frame_step": 2, "overwrite": True}
    export(plain, tmp_path / "live", blender=True, **more)
    assert [read(tmp_path / "live")[0][name] for name in names] == [29.97, 7, 2, 5]


def test_a_model_far_away_is_near_the_origin_of_its_object(make_case, animation, tmp_path):
    """In single precision, positions a thousand diagonals away would be off by 6e-5 of one."""
    away = np.array([5000.0, 0, 300])
    frames, cage = animation.frames + away, animation.cage.vertices + away
    case = make_case(frames, animation.rest.faces, cage)
    assert compare(case.result, tmp_path) < 3e-7
    about, arrays = read(tmp_path / "live")
    assert about["origin"] == [5000, -300, 0]
    assert max(np.abs(arrays[name]).max() for name in ("rest", "cage")) < 10


def test_parts_keep_their_surfaces(character_result, tmp_path):
    export(character_result, tmp_path / "live", blender=True)
    about, arrays = read(tmp_path / "live")
    assert [part["name"] for part in about["parts"]] == [n.rpartition("/")[2] for n in NAMES]
    for key, (part, mesh) in enumerate(zip(about["parts"], make_parts(), strict=True)):
        given = mesh.attributes
        assert part["vertex_count"] == len(mesh.vertices)
        (name,) = given.materials.names
        assert part["materials"] == [[name, pytest.approx([*COLOURS[name][:3], 1])]]
        np.testing.assert_array_equal(arrays[f"{key}_counts"], given.corner_counts)
        np.testing.assert_array_equal(arrays[f"{key}_corners"], given.corners)
        np.testing.assert_array_equal(arrays[f"{key}_materials"], 0)
        uvs = given.uvs.values[given.uvs.indices]
        np.testing.assert_allclose(arrays[f"{key}_uvs"], uvs, rtol=1e-6, atol=1e-7)


def list_surface(**layers):
    """What is written of a surface of two quads, by name."""
    surface = SurfaceAttributes(np.array([4, 4]), np.array([0, 1, 2, 3, 1, 4, 5, 2]), **layers)
    return live_cage._list_surface("x", surface), live_cage._list_materials(surface)


def test_faces_without_a_material_have_an_empty_slot():
    labels = FaceLabels(("red",), np.array([0, -1]))
    found, slots = list_surface(materials=labels, material_colours=np.array([[1, 0, 0, 0.5]]))
    assert found["x_materials"].tolist() == [0, 1]
    assert slots == [("red", [1, 0, 0, 0.5]), (None, [0.8, 0.8, 0.8, 1])]
    whole = FaceLabels(("red", "blue"), np.array([1, 0]))
    found, slots = list_surface(materials=whole)
    assert found["x_materials"].tolist() == [1, 0]
    assert [name for name, _ in slots] == ["red", "blue"]


def test_colours_have_an_alpha_and_corners_without_uvs_are_at_zero():
    colours = np.linspace(0, 1, 18).reshape(6, 3)
    uvs = UvMap(np.array([[0.5, 1]]), np.array([0, 0, -1, 0, 0, 0, 0, 0]))
    found, slots = list_surface(colours=colours, uvs=uvs)
    np.testing.assert_allclose(found["x_colours"], np.insert(colours, 3, 1, axis=1), rtol=1e-6)
    assert found["x_uvs"][1:3].tolist() == [[0.5, 1], [0, 0]]
    assert slots == []
    assert "x_materials" not in found


def test_edges_are_sharp_where_faces_do_not_share_normals():
    box = quad_box()
    flat = replace(box.polygons, normal_fans=np.arange(len(box.polygons.corners)))
    sides = {tuple(pair) for pair in box.polygon_sides.tolist()}
    assert {tuple(pair) for pair in find_sharp_edges(flat).tolist()} == sides
    assert len(sides) == 12
    for smooth in (box.polygons, shade_smoothly(box).polygons):
        assert len(find_sharp_edges(smooth)) == 0
    surface = SurfaceAttributes(np.array([4, 4]), np.array([0, 1, 2, 3, 1, 4, 5, 2]))
    split = replace(surface, normal_fans=np.array([0, 1, 2, 3, 6, 4, 5, 7]))
    assert find_sharp_edges(split).tolist() == [[1, 2]]  # not the edges of one face


def test_the_same_result_gives_the_same_bytes(few, tmp_path):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        export(few, tmp_path / name / "live", blender=True)
    assert sorted(os.listdir(tmp_path / "one" / "live")) == FILES
    for file in FILES:
        pair = [(tmp_path / name / "live" / file).read_bytes() for name in ("one", "other")]
        assert pair[0] == pair[1]


def test_blocks_of_frames_change_nothing(few, tmp_path, monkeypatch):
    export(few, tmp_path / "one", blender=True)
    monkeypatch.setattr("cageik_cli.run.export.MAX_EXPORT_BYTES", 1)
    export(few, tmp_path / "other", blender=True)
    first, second = (read(tmp_path / name)[1]["moves"] for name in ("one", "other"))
    np.testing.assert_array_equal(first, second)


def test_progress_and_summary_count_frames(plain, tmp_path):
    seen = []
    written = export(
        plain, tmp_path / "live", blender=True, progress=lambda *done: seen.append(done)
    )
    assert seen[-1] == (5, 5)
    size = sum(path.stat().st_size for path in (tmp_path / "live").iterdir())
    assert (written.frame_count, written.byte_count) == (5, size)
    assert f"{written.vertex_count} {written.unit}" == (
        "26 vertices, 8 of the cage and 18 of the model"
    )
    assert "open_in_blender.py" in str(written.notes[-1])


def test_a_failure_leaves_what_was_there(plain, few, tmp_path, monkeypatch):
    folder = tmp_path / "live"
    export(plain, folder, blender=True)
    before = {path: path.read_bytes() for path in folder.iterdir()}

    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(live_cage, "_list_moves", fail)
    with refused(OutputError, "No space left on device", folder):
        export(few, folder, blender=True, overwrite=True)
    with pytest.raises(OutputError):
        export(few, tmp_path / "new", blender=True)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    assert list(tmp_path.iterdir()) == [folder]


def test_what_single_precision_cannot_hold_is_refused(plain, tmp_path):
    with refused(OutputError, "too large for the single precision"):
        export(plain, tmp_path / "live", blender=True, metres_per_unit=1e40)
    assert list(tmp_path.iterdir()) == []


def test_the_extension_is_the_script_and_a_manifest():
    with zipfile.ZipFile(io.BytesIO(make_extension())) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert sorted(files) == ["__init__.py", "blender_manifest.toml"]
    assert files["__init__.py"] == (live_cage.TEMPLATES / "open_in_blender.py").read_bytes()
    manifest = tomllib.loads(files["blender_manifest.toml"].decode())
    assert manifest["version"] == __version__
    assert manifest["id"] == Path(live_cage.EXTENSION).stem
    script = read_constants()
    assert manifest["blender_version_min"] == ".".join(map(str, script["OLDEST_BLENDER"]))


def test_the_script_knows_the_file_and_its_format():
    script = read_constants()
    assert (script["DATA_NAME"], script["DATA_FORMAT"]) == (
        live_cage.DATA,
        live_cage.LIVE_CAGE_FORMAT,
    )


def read_constants():
    """The constants of the script, which only Blender can import."""
    found = {}
    for node in ast.parse((live_cage.TEMPLATES / live_cage.SCRIPT).read_bytes()).body:
        name = node.targets[0] if isinstance(node, ast.Assign) else None
        if isinstance(name, ast.Name) and name.id.isupper():
            found[name.id] = ast.literal_eval(node.value)
    return found


def test_the_script_imports_nothing_that_blender_lacks():
    tree = ast.parse((live_cage.TEMPLATES / live_cage.SCRIPT).read_bytes())
    names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Import)]
    names |= {alias.name for node in nodes for alias in node.names}
    tops = {name.split(".")[0] for name in names}
    standard = {"json", "sys", "zipfile", "collections", "pathlib", "typing"}
    assert tops == {"bpy", "bpy_extras", "numpy", *standard}
