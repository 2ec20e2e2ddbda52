"""Texts that are cut or shuffled are refused in our words, not in those of Python and NumPy."""

import re

import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh
from cageik_cli.inputs.source import load_model
from cageik_cli.util.errors import CageikError, FormatError
from tests.refusals import refused
from tests.shapes import QUADS, box
from tests.texts import texts

BOX = box()
ROWS = "".join("{:g} {:g} {:g}\n".format(*vertex) for vertex in BOX.vertices)
COLOURED = ROWS.replace("\n", " 7\n")
RINGS = "".join(f"4 {' '.join(map(str, quad))}\n" for quad in QUADS)
XYZ = "property float x\nproperty float y\nproperty float z\n"
PLY = f"ply\nformat ascii 1.0\nelement vertex 8\n{XYZ}"
FACE = "element face 6\nproperty list uchar short vertex_indices\nend_header\n"

TEXTS = {
    "a.obj": "".join(f"v {row}\n" for row in ROWS.splitlines())
    + "vt 0 0\nvn 0 0 1\ng all\n"
    + "".join(f"f {' '.join(f'{corner + 1}/1/1' for corner in quad)}\n" for quad in QUADS),
    "a.off": f"OFF\n8 6 12\n{ROWS}{RINGS}",
    "a.ply": f"{PLY}property uchar red\n{FACE}{COLOURED}{RINGS}",
    "points.ply": f"{PLY}property uchar red\nend_header\n{COLOURED}",
    "strips.ply": f"{PLY}property list uchar int near\nelement tristrips 1\n"
    "property list int int vertex_indices\nend_header\n"
    + ROWS.replace("\n", " 2 1 2\n")
    + "12 0 1 2 3 -1 3 4 5 6 -1 1 2\n",
    "a.stl": "solid a\n"
    + "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join("vertex {:g} {:g} {:g}\n".format(*BOX.vertices[corner]) for corner in face)
        + "endloop\nendfacet\n"
        for face in BOX.faces
    )
    + "endsolid a\n",
}

FOREIGN = re.compile(
    r"unpack|invalid literal|could not convert|codec|out of (range|bounds)|NoneType|base 10|dtype|"
    r"numpy|Python|int\(\)|float\(\)|\bb'|argument|iterable|broadcast|reshape|object|subscript|"
    r"operand|at row|bytes-like|Errno|\w+Error\b|<class|\bNone\b|string to|buffer|requested size"
)

ODD = ("x", "-1", "1e400", "9" * 20, "nan", "\n", "1.5", "é", "", "0x1f", "1_0", "-", "4294967296")


def spoil(words, generator):
    """Cut, swap, drop, add or replace some words, or turn a few round."""
    words = list(words)
    place = int(generator.integers(len(words)))
    odd = ODD[int(generator.integers(len(ODD)))]
    match int(generator.integers(6)):
        case 0:
            words = words[:place]
        case 1:
            for i, j in generator.integers(len(words), size=(2, 2)):
                words[i], words[j] = words[j], words[i]
        case 2:
            del words[place]
        case 3:
            words.insert(place, odd)
        case 4:
            words[place] = odd
        case 5:
            words[place : place + 5] = words[place : place + 5][::-1]
    data = " ".join(words).encode()
    return data[: int(generator.integers(len(data)))] if generator.random() < 0.2 else data


@pytest.mark.parametrize("name", TEXTS)
def test_no_message_has_the_words_of_a_library(tmp_path, name):
    path, generator = tmp_path / name, np.random.default_rng(7)
    words = re.findall(r"\S+|\n", TEXTS[name])
    refusals = 0
    for _ in range(250):
        path.write_bytes(spoil(words, generator))
        try:
            load_model(path)
        except CageikError as error:
            refusals += 1
            said = str(error).replace(str(tmp_path), "")
            assert not FOREIGN.search(said), said
            assert said.isprintable()
    assert refusals > 50


def test_the_words_of_a_library_would_be_found():
    for said in ("not enough values to unpack (expected 2, got 1)", "'utf-8' codec can't decode"):
        assert FOREIGN.search(said)


@pytest.mark.parametrize("name", [name for name in TEXTS if not name.startswith("points")])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_texts_with_a_mark_of_their_encoding_are_read(tmp_path, name, encoding):
    mark = "\ufeff" if encoding in ("utf-16-le", "utf-16-be") else ""
    path = tmp_path / name
    path.write_text(TEXTS[name], encoding="utf-8")
    plain = load_mesh(path).mesh
    path.write_bytes((mark + TEXTS[name]).encode(encoding))
    mesh = load_mesh(path).mesh
    np.testing.assert_array_equal(mesh.vertices, plain.vertices)
    np.testing.assert_array_equal(mesh.faces, plain.faces)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    "comment", ["Файл создан в Блендере, модель человека", "由搅拌机导出的模型"]
)
def test_a_text_may_begin_in_any_letters(tmp_path, encoding, comment):
    path = tmp_path / "a.obj"
    path.write_bytes(f"# {9 * comment}\n{TEXTS['a.obj']}".encode(encoding))
    assert load_mesh(path).mesh.volume == pytest.approx(BOX.volume)


@pytest.mark.parametrize("fill", [b"\0", b" ", b" \0"])
def test_a_binary_file_that_begins_like_a_mark_stays_as_it_is(tmp_path, fill):
    triangles = np.zeros(12, [("numbers", "<f4", (4, 3)), ("rest", "<u2")])
    triangles["numbers"][:, 1:] = BOX.vertices[BOX.faces]
    for head in (b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf"):
        path = tmp_path / "a.stl"
        head = (head + 80 * fill)[:80]
        path.write_bytes(head + (12).to_bytes(4, "little") + triangles.tobytes())
        assert load_mesh(path).mesh.volume == pytest.approx(BOX.volume)


SHORT = {
    "at the end": (TEXTS["a.obj"] + "f 1 2\n", 1),
    "in the middle": (TEXTS["a.obj"].replace("f ", "f 1/1/1 2\nf ", 1), 1),
    "of one corner and of none": (TEXTS["a.obj"].replace("f ", "f\nf 3\nf 1 2\nf ", 1), 3),
    "over two lines": (TEXTS["a.obj"].replace("f ", "f 1 \\\n 2\nf ", 1), 1),
    "with returns": (TEXTS["a.obj"].replace("f ", "f 1 2\nf ", 1).replace("\n", "\r\n"), 1),
    "between vertices": ("f 1 2\n" + TEXTS["a.obj"], 1),
}


@pytest.mark.parametrize(("text", "count"), SHORT.values(), ids=SHORT)
def test_faces_of_two_corners_are_left_out_of_obj_with_a_note(tmp_path, text, count):
    path = tmp_path / "a.obj"
    path.write_bytes(text.encode())
    loaded = load_mesh(path)
    path.write_text(TEXTS["a.obj"])
    plain = load_mesh(path).mesh
    np.testing.assert_array_equal(loaded.mesh.faces, plain.faces)
    np.testing.assert_array_equal(loaded.mesh.attributes.uvs.indices, plain.attributes.uvs.indices)
    assert loaded.mesh.attributes.groups.names == plain.attributes.groups.names
    noun = "face" if count == 1 else "faces"
    assert f"{count} {noun} of fewer than 3 corners left out" in " ".join(texts(loaded.notes))


@pytest.mark.parametrize("end", ["", "\n"])
def test_a_file_is_called_cut_off_only_where_it_ends_inside_a_line(tmp_path, end):
    path = tmp_path / "a.obj"
    path.write_text(TEXTS["a.obj"] + "v 1 2" + end)
    with refused(FormatError, "`v 1 2` has 2 coordinates"):
        load_mesh(path)
    path.write_text(f"{TEXTS['a.obj']}f 1 2{end}")
    if end:
        assert len(load_mesh(path).mesh.faces) == 12
    else:
        with refused(FormatError, "`f 1 2` has 2 corners, expected 3 or more; the file is cut off"):
            load_mesh(path)
    path.write_text(f"{TEXTS['a.obj']}v 1 2{end}")
    with pytest.raises(FormatError) as caught:
        load_mesh(path)
    assert ("cut off" in str(caught.value)) == (not end)
