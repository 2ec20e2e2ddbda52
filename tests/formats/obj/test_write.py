"""OBJ texts at other positions: read line by line, all is as it was."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.obj.frames import make_obj_template
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.write import write_mesh
from cageik_cli.geometry.attributes import FaceLabels
from cageik_cli.geometry.shape import compute_fan_normals
from tests.assets import asset_text, parse_asset
from tests.shapes import quad_text
from tests.surfaces import change, read_obj
from tests.texts import texts


def rewrite(mesh, positions):
    normals = np.empty(0)
    if mesh.attributes is not None and mesh.attributes.normal_fans is not None:
        normals = compute_fan_normals(mesh.attributes, positions)
    numbers = [*positions.ravel().tolist(), *normals.ravel().tolist()]
    return (make_obj_template(mesh) % tuple(numbers)).decode()


def parts(asset):
    return asset.polygons, asset.corner_uvs, asset.names, asset.colours, asset.library


@pytest.mark.parametrize("text", [asset_text(), asset_text(normals=False), quad_text(0.5)])
def test_all_but_positions_and_normals_stays(text):
    mesh, before = read_obj(text), parse_asset(text)
    after = parse_asset(rewrite(mesh, 2 * mesh.vertices + 1))
    assert parts(after) == parts(before)
    np.testing.assert_allclose(after.vertices, 2 * before.vertices + 1, rtol=1e-8)


def test_normals_are_those_of_the_faces_that_shared_one():
    """The caps are flat and the side is smooth, so only the side has normals of two faces."""
    mesh = read_obj(asset_text())
    turned = mesh.vertices @ [[0, 0, -1.0], [0, 1, 0], [1, 0, 0]]  # x to -z, z to x
    asset = parse_asset(rewrite(mesh, turned))
    np.testing.assert_allclose(asset.corner_normals[-1], [[1, 0, 0]] * 5, atol=1e-6)
    np.testing.assert_allclose(asset.corner_normals[-2], [[-1, 0, 0]] * 5, atol=1e-6)
    for polygon, normals in zip(asset.polygons[:-2], asset.corner_normals, strict=False):
        radial = asset.vertices[polygon] * [0, 1, 1]
        radial /= np.linalg.norm(radial, axis=1, keepdims=True)
        np.testing.assert_allclose(normals, radial, atol=1e-5)


def test_a_file_without_normals_gets_none():
    assert "vn" not in rewrite(read_obj(asset_text(normals=False)), np.zeros((30, 3)))


V = "".join(f"v {x} {y} 0{{}}\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
BARE = V.replace("{}", "")
ODD = {
    "mixed corners": BARE + "vt 0 0\nvt 1 0\nvn 0 0 1\nf 1/1 2/2/1 3//1 4\n",
    "negative": BARE + "vt 0 0\nvt 1 0\nf -4/-2 -3/-1 -2/-2\nvt .5 .25\nf 1/-1 3/-1 4/3\n",
    "colours": V.replace("{}", " 0.25 0.5 1") + "f 1 2 3 4\n",
    "colours with alpha": V.replace("{}", " 0.25 0.5 1 0.125") + "f 1 2 3 4\n",
    "names behind names": BARE + "g a\ng b c\nusemtl m\nf 1 2 3\ng a\ns 4\nf 1 3 4\n",
    "three numbers": BARE + "vt 0.5 0.25 9\nf 1/1 2/1 3/1 4/1\n",
    "a percent sign": "mtllib 100%s.mtl\n" + BARE + "usemtl %d\nf 1 2 3 4\n",
    "triangles": BARE + "usemtl m\nf 1 2 3\nf 1 3 4\n",
}


@pytest.mark.parametrize("text", ODD.values(), ids=ODD)
def test_odd_texts_stay(text):
    mesh = read_obj(text)
    assert mesh.attributes is not None
    assert parts(parse_asset(rewrite(mesh, mesh.vertices))) == parts(parse_asset(text))


@pytest.mark.parametrize(
    "line", ["", "# 1\n", "l 1 2\n", "s off\n", "g\n", "vt 0 0\n", "vn 1 0 0\n"]
)
def test_triangles_that_say_nothing_have_no_attributes(line):
    assert read_obj(BARE + line + "f 1 2 3\n").attributes is None


@pytest.mark.parametrize("weight", ["", " 1.0"])
def test_weights_of_vertices_are_no_colours(weight):
    assert read_obj(V.replace("{}", weight) + "f 1 2 3 4\n").attributes.colours is None


LEFT_OUT = {
    "a texture coordinate that is not there": ("vt 0 0\nf 1/2 2/1 3/1\n", "texture coordinates"),
    "index 0": ("vt 0 0\nf 1/0 2/1 3/1\n", "texture coordinates"),
    "an index that is no number": ("vt 0 0\nf 1/x 2/1 3/1\n", "texture coordinates"),
    "an index beyond 64 bits": (f"vt 0 0\nf 1/{9**40} 2/1 3/1\n", "texture coordinates"),
    "no number": ("vt\nf 1/1 2/1 3/1\n", "texture coordinates"),
    "infinite": ("vt inf 0\nf 1/1 2/1 3/1\n", "texture coordinates"),
    "beyond the largest number": ("vt 1e400 0\nf 1/1 2/1 3/1\n", "texture coordinates"),
    "a normal that is not there": ("vn 0 0 1\nf 1//1 2//1 3//7\n", "normals"),
    "a long name": (f"usemtl {'m' * 2000}\nf 1 2 3\n", "names of faces"),
    "a long library": (f"mtllib {'m' * 2000}\nf 1 2 3\n", "material library"),
}


@pytest.mark.parametrize(("lines", "what"), LEFT_OUT.values(), ids=LEFT_OUT)
def test_what_is_damaged_is_left_out_and_said_so(tmp_path, lines, what):
    (tmp_path / "a.obj").write_text(BARE + lines)
    loaded = load_mesh(tmp_path / "a.obj")
    assert loaded.mesh.attributes is None
    assert len(texts(loaded.notes)) == 1
    assert f"{what} " in texts(loaded.notes)[0]
    assert "left out (" in texts(loaded.notes)[0]


def test_colours_that_are_no_numbers_are_left_out(tmp_path):
    (tmp_path / "a.obj").write_text(V.replace("{}", " 0 0 red") + "f 1 2 3\n")
    assert "colours are left out" in texts(load_mesh(tmp_path / "a.obj").notes)[0]


def test_names_that_obj_would_misread_are_changed(tmp_path):
    mesh = read_obj(BARE + "f 1 2 3\nf 1 3 4\nf 1 2 4 3\n")
    names = FaceLabels(("a#b", "c\\"), np.array([0, 1, -1]))
    mesh = change(mesh, materials=names)
    write_mesh(tmp_path / "b.obj", mesh, mesh.vertices, overwrite=False)
    asset = parse_asset((tmp_path / "b.obj").read_text())
    assert [name[2] for name in asset.names] == ["a_b", "c_", "default"]


def test_names_in_other_encodings_are_text(tmp_path):
    (tmp_path / "a.obj").write_bytes(BARE.encode() + b"g caf\xe9 \x01b\nf 1 2 3 4\n")
    assert load_mesh(tmp_path / "a.obj").mesh.attributes.groups.names == ("caf\xe9 ?b",)


CORNER = st.tuples(st.integers(1, 4), st.integers(0, 3), st.integers(0, 2))
NAME = st.sampled_from(["usemtl a", "usemtl b c", "g x", "g y", "s 1", "s off", "o q"])
FACES = st.lists(st.one_of(NAME, st.lists(CORNER, min_size=3, max_size=6)), min_size=1, max_size=9)


def spell(corner):
    v, t, n = corner
    return f"{v}/{t or ''}/{n}" if n else f"{v}/{t}" if t else str(v)


@given(FACES)
def test_any_text_is_the_same_elsewhere(faces):
    lines = [part if isinstance(part, str) else "f " + " ".join(map(spell, part)) for part in faces]
    head = BARE + "vt 0 0\nvt .5 0\nvt 0 1\nvn 0 0 1\nvn 0 1 0\n"
    text = head + "\n".join([*lines, "f 1 2 3 4"]) + "\n"
    mesh = read_obj(text)
    before, after = parse_asset(text), parse_asset(rewrite(mesh, mesh.vertices + 1))
    assert parts(after) == parts(before)
    given = [[n is not None for n in normals] for normals in before.corner_normals]
    assert [[n is not None for n in normals] for normals in after.corner_normals] == given
    again = read_obj(rewrite(mesh, mesh.vertices))
    np.testing.assert_array_equal(again.faces, mesh.faces)
