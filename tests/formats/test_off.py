"""OFF: keywords, comments and rows as programs write them."""

import codecs

import numpy as np
import pytest

from cageik_cli.formats.off import Reader, parse_off
from cageik_cli.formats.open import load_mesh
from cageik_cli.util.errors import FormatError
from tests.refusals import refused
from tests.shapes import QUADS, box

BOX = box()
VERTICES = [[f"{x:g}" for x in vertex] for vertex in BOX.vertices.tolist()]
FACES = [["4", *map(str, quad)] for quad in QUADS]


def lines(rows):
    return "".join(f"{' '.join(row)}\n" for row in rows)


def off(head="OFF\n8 6 12\n", vertices=None, faces=None):
    return head + lines(vertices or VERTICES) + lines(faces or FACES)


def beside(*more):
    """The vertices with more numbers behind each."""
    return [[*vertex, *more] for vertex in VERTICES]


def flow(rows, width):
    """Numbers in rows of other lengths."""
    words = [word for row in rows for word in row]
    return lines(words[k : k + width] for k in range(0, len(words), width))


TEXTS = {
    "plain": off(),
    "glued, as ModelNet has it": off("OFF8 6 12\n"),
    "on one row": off("OFF 8 6 12\n"),
    "no keyword": off("8 6 12\n"),
    "no edges": off("OFF\n8 6\n"),
    "edges on a row of their own": off("OFF\n8 6\n12\n"),
    "counts on three rows": off("OFF\n8\n6\n12\n"),
    "comments": off("# by hand\nOFF # here\n\n8 6 12 # counts\n"),
    "colours": off("COFF\n8 6 12\n", beside("255", "0", "0", "255")),
    "colours of three numbers": off("COFF\n8 6 12\n", beside("0.5", "0", "0")),
    "normals": off("NOFF\n8 6 12\n", beside("0", "0", "1")),
    "texture": off("STOFF\n8 6 12\n", beside("0.5", "0.25")),
    "all of these": off("STCNOFF 8 6 12\n", beside(*"123456789")),
    "colours without the letter": off(vertices=beside("9", "9", "9")),
    "colours of some vertices": off(vertices=[*VERTICES[:3], *beside("9", "9", "9")[3:]]),
    "colours of faces": off(faces=[[*face, "255", "0", "0"] for face in FACES]),
    "an index of a colour": off(faces=[[*FACES[0], "3"], *FACES[1:]]),
    "two vertices on a row": "OFF\n8 6 12\n" + flow(VERTICES, 6) + lines(FACES),
    "a number on each row": "OFF\n8\n6\n12\n" + flow(VERTICES, 1) + flow(FACES, 1),
    "all vertices on a row": "OFF\n8 6 12\n" + flow(VERTICES, 24) + lines(FACES),
    "all on one row": f"OFF 8 6 12 {flow(VERTICES, 24).strip()} {flow(FACES, 30)}",
    "rows of five": "OFF\n8 6 12\n" + flow(VERTICES, 5) + flow(FACES, 7),
    "normals on any rows": "NOFF\n8 6 12\n" + flow(beside("0", "0", "1"), 16) + lines(FACES),
    "colours on any rows": "COFF\n8 6 12\n" + flow(beside("9", "9", "9"), 24) + lines(FACES),
    "colours and faces on any rows": "COFF 8 6 12\n" + flow([*beside(*"9999"), *FACES], 11),
    "colours of three numbers and all": "COFF\n8 6 12\n" + flow([*beside(*"999"), *FACES], 99),
    "normals, colours and faces": "CNOFF 8 6 12\n" + flow([*beside(*"1234567"), *FACES], 13),
    "colours that are not there": f"COFF 8 6 12 {flow(VERTICES, 24).strip()} {flow(FACES, 30)}",
    "faces that go on": off(faces=[FACES[0][:2], FACES[0][2:], *FACES[1:]]),
    "something behind": off() + "and a remark\n",
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_every_layout_is_the_box(text, end):
    vertices, polygons = parse_off(text.replace("\n", end).encode())
    np.testing.assert_array_equal(vertices, BOX.vertices)
    assert [polygon.tolist() for polygon in polygons] == [list(quad) for quad in QUADS]


@pytest.mark.parametrize(
    "data",
    [
        codecs.BOM_UTF8 + off().encode(),
        off("OFF\n# grün\n8 6 12\n").encode("latin-1"),
        off("OFF\n# grün\n8 6 12\n").encode(),
        off().encode("utf-16"),
    ],
)
def test_marks_and_letters_of_any_encoding(tmp_path, data):
    path = tmp_path / "a.off"
    path.write_bytes(data)
    assert load_mesh(path).mesh.volume == pytest.approx(BOX.volume)


FAULTS = {
    "hello": (b"hello", "it does not begin with OFF"),
    "another word": (b"OFFSET 1 2 3", "it does not begin with OFF"),
    "binary": (b"OFF BINARY\n\0\0\0\4", "it is binary"),
    "four dimensions": (off("4OFF\n8 6 12\n").encode(), "of another number of dimensions"),
    "no counts": (b"OFF\n8\n", "it does not say how many vertices and faces it has"),
    "a count below zero": (off("OFF\n8 -6 12\n").encode(), "it announces 8 vertices and -6 faces"),
    "a count that is a word": (off("OFF\n8 many 12\n").encode(), "`many` is not a whole number"),
    "a face that is cut off": (off().encode()[:-4], "the face `4 "),
    "a face less": (off(faces=FACES[:-1]).encode(), "8 vertices and 6 faces, but holds 8 and 5"),
    "a vertex less": (off(vertices=VERTICES[1:]).encode(), "6 faces, but holds 8 and 5"),
    "a short vertex": (
        off(vertices=[VERTICES[0][:2], *VERTICES[1:]]).encode(),
        "the vertex `-1 -1` has 2 numbers, expected 3",
    ),
    "a word": (off(vertices=[["x", "0", "0"], *VERTICES[1:]]).encode(), "`x` is not a number"),
    "a huge corner": (off(faces=[["4", "0", "1", "2", "9" * 30], *FACES[1:]]).encode(), "`9999"),
    "half a corner": (off(faces=[["4", "0", "1", "2", "1.5"], *FACES[1:]]).encode(), "`1.5` is no"),
}


@pytest.mark.parametrize(("data", "says"), FAULTS.values(), ids=FAULTS)
def test_faults_have_a_sentence(data, says):
    with refused(FormatError, says):
        Reader.parse(data)
