"""OBJ texts with other positions: what stays, what goes, and that it is the mesh it was."""

import codecs
import re

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from cageik_cli.formats.obj import write as obj_text
from cageik_cli.formats.obj.parse import parse_obj
from cageik_cli.formats.obj.write import make_obj_template
from cageik_cli.util.errors import InputError

POSITIONS = [[0.5, -1, 2], [3, 4.25, -5], [1 / 3, 1e-9, 1e9], [7, 8, 9]]
V = [b"0.5 -1 2", b"3 4.25 -5", b"0.333333333 1e-09 1e+09", b"7 8 9"]
"""The same with nine digits."""

QUADS = b"""\
# one%quad, 100 % of it / all\r
mtllib ../my model%20.mtl other.mtl\r
o caf\xe9 \xff\r
v 0 0 0\r
v   1.000000 0\t+0.5e0   # a/b/c v 1 2 3\r
\tv 1 1 0 0.25 .5 1.0\r
v -0 1 0 1.0\r
\r
vt 0 0\r
vt 1 0\r
vn 0 0 1 # up\r
  vn 0 0 -1\r
vp 0.5\r
g left/side/a right\r
usemtl skin/a//b%d\r
s 1\r
f 1/1/1 2/2/1 3/2/1 4/1/2  # 1/1/1\r
s off\r
f 1//1 2//1 -1//-1\r
f 1/1 2/2 4/1\r
f 1 2 4\r
l 1/1 2/2 4/1\r
p 1 3\r
curv 0 1 1 2"""

MOVED = b"""\
# one%quad, 100 % of it / all\r
mtllib ../my model%20.mtl other.mtl\r
o caf\xe9 \xff\r
v 0.5 -1 2\r
v   3 4.25\t-5   # a/b/c v 1 2 3\r
\tv 0.333333333 1e-09 1e+09 0.25 .5 1.0\r
v 7 8 9 1.0\r
\r
vt 0 0\r
vt 1 0\r
vp 0.5\r
g left/side/a right\r
usemtl skin/a//b%d\r
s 1\r
f 1/1 2/2 3/2 4/1  # 1/1/1\r
s off\r
f 1 2 -1\r
f 1/1 2/2 4/1\r
f 1 2 4\r
l 1/1 2/2 4/1\r
p 1 3\r
curv 0 1 1 2"""


def moved(text, positions=POSITIONS):
    return make_obj_template(text) % tuple(np.asarray(positions, float).ravel().tolist())


def four(*lines):
    """The text of four vertices, and of other lines behind them; and the same moved."""
    return [
        b"\n".join([*(b"v " + numbers for numbers in vertices), *lines])
        for vertices in ([b"0 0 0"] * 4, V)
    ]


@pytest.mark.parametrize("mark", [b"", codecs.BOM_UTF8])
@pytest.mark.parametrize("line_break", [b"\r\n", b"\n", b"\r"])
def test_positions_change_normals_go_and_all_else_stays(mark, line_break):
    before, after = (mark + text.replace(b"\r\n", line_break) for text in (QUADS, MOVED))
    assert moved(before) == after


def test_a_text_without_normals_with_its_own_positions_is_itself():
    text = MOVED + b"\n\n# end"
    assert moved(text) == text


ODD = {
    "no third index behind the slash": (b"f 1/1/ 2/2/ 3/3/", b"f 1/1 2/2 3/3"),
    "no index behind the slashes": (b"f 1// 2// 3//", b"f 1 2 3"),
    "no index behind one slash": (b"f 1/ 2/ 3/", b"f 1/ 2/ 3/"),
    "kinds of corners in one face": (b"f 1 2//4 3/2 4/2/1", b"f 1 2 3/2 4/2"),
    "more indices": (b"f 1/1/1/1 2//2/2 3", b"f 1/1 2 3"),
    "a backslash at the end": (b"f 1/1/1 2/2/2 3/3/3\\", b"f 1/1 2/2 3/3\\"),
    "negative": (b"f -4/-4/-1 -3//-1 -2/-2", b"f -4/-4 -3 -2/-2"),
    "a comment at a corner": (b"f 1/1/1 2/2/2 3/3/3#4/4/4", b"f 1/1 2/2 3/3#4/4/4"),
    "a line that goes on": (b"f 1/1/1 \\\n2/2/2\\\n 3/3/3 \\", b"f 1/1 \\\n2/2\\\n 3/3 \\"),
    "CR that goes on": (b"f 1/1/1\\\r\n2/2/2\\\r3/3/3\n", b"f 1/1\\\r\n2/2\\\r3/3\n"),
    "normals that go on": (b"f 1 2 3\nvn 0 \\\n 0 1\nvt 0", b"f 1 2 3\nvt 0"),
    "names that go on": (b"f 1 2 3\ng a \\\nvn b\\\nf c/d/e", b"f 1 2 3\ng a \\\nvn b\\\nf c/d/e"),
    "a path in a comment": (b"f 1 2 3\n# C:\\\nvn 0 0 1\nvt 0", b"f 1 2 3\n# C:\\\nvt 0"),
    "a comment behind a line that goes on": (
        b"f 1 2\\\n 3//3 # \\\nvn 0 0 1\n",
        b"f 1 2\\\n 3 # \\\n",
    ),
    "a backslash inside": (b"f 1 2 3\nusemtl a\\b/c/d\nvn 1", b"f 1 2 3\nusemtl a\\b/c/d\n"),
    "a control byte": (b"f 1 2 3\ng \x01vn\x1c\nvn\x01 1", b"f 1 2 3\ng \x01vn\x1c\nvn\x01 1"),
    "other keywords": (b"f 1 2 3\nvnx 1/1/1\nfo 1/1\nvn\n", b"f 1 2 3\nvnx 1/1/1\nfo 1/1\n"),
    "feeds": (b"\vf\f1//1\t2//2 3//3\f\n", b"\vf\f1\t2 3\f\n"),
}


@pytest.mark.parametrize(("before", "after"), ODD.values(), ids=ODD)
def test_odd_lines(before, after):
    whole = [four(text)[k] for k, text in enumerate((before, after))]
    assert moved(whole[0]) == whole[1]
    found, expected = parse_obj(whole[1]), parse_obj(whole[0])
    np.testing.assert_array_equal(found.faces, expected.faces)


@pytest.mark.parametrize("first", [b"", b"vn 0 0 1\n"])
def test_a_mark_may_stand_before_a_vertex_or_a_normal(first):
    """Further on it is no mark, but part of a word."""
    before, after = four(b"f 1 2 3", codecs.BOM_UTF8 + b"vn 0 0 1")
    assert moved(codecs.BOM_UTF8 + first + before) == codecs.BOM_UTF8 + after


def test_vertices_that_go_on():
    text = b"v 0 \\\n 0\\\r\n0\nv\\\n0 0 0 \\\n.5 .5 .5\nv 0 0 0\\\n\nv 0 0 0\nf 1 2 3"
    expected = b"v 0.5 \\\n -1\\\r\n2\nv\\\n3 4.25 -5 \\\n.5 .5 .5\nv %b\\\n\nv %b\nf 1 2 3"
    assert moved(text) == expected % tuple(V[2:])


def test_every_vertex_is_asked_for_and_no_other():
    text, _ = four(b"f 1 2 3")
    for positions in (POSITIONS[:3], POSITIONS + POSITIONS[:1]):
        with pytest.raises(TypeError, match="arguments"):
            moved(text, positions)


@pytest.mark.parametrize("block", [1, 7, 100])
def test_blocks_do_not_change_the_format(monkeypatch, block):
    text = b"\n".join([QUADS, *(four(lines)[0] for lines, _ in ODD.values())])
    whole = make_obj_template(text)
    monkeypatch.setattr(obj_text, "_BLOCK_BYTES", block)
    assert make_obj_template(text) == whole


BREAK = st.sampled_from([b"\n", b"\r\n", b"\r"])
GAP = st.sampled_from([b" ", b"  ", b"\t", b" \\\n", b"\\\r\n "])
INDEX = st.integers(1, 4).map(lambda k: b"%d" % k)
CORNER = st.one_of(
    INDEX,
    *(
        st.tuples(*[INDEX] * form.count(b"%b")).map(lambda parts, form=form: form % parts)
        for form in (b"%b/%b", b"%b/%b/%b", b"%b//%b", b"-%b/%b/-%b", b"%b/%b/", b"%b//")
    ),
)
NAME = st.binary(max_size=6).filter(lambda name: b"\0" not in name)
LINE = st.one_of(
    st.tuples(st.just(b"f"), st.lists(CORNER, min_size=3, max_size=5)),
    st.tuples(st.just(b"v"), st.lists(st.sampled_from([b"1", b"-0.5", b"2e0"]), min_size=3)),
    st.tuples(st.just(b"vn"), st.lists(st.just(b"1"), max_size=3)),
    st.tuples(st.sampled_from([b"g", b"#", b"usemtl", b"s", b"vt", b"l"]), st.lists(NAME)),
)


@st.composite
def texts(draw):
    """Texts of any lines behind four vertices and a face."""
    parts = [b"v 0 0 0\n" * 4, b"f 1/2/3 2//1 3\n"]
    for keyword, words in draw(st.lists(LINE, max_size=8)):
        for word in [keyword, *words]:
            parts += [word, draw(GAP)]
        parts.append(draw(BREAK))
    return b"".join(parts)


@given(texts())
@example(b"v 0 0 0\n" * 4 + b"f 1 2 3\n# \\\nv 1 2 3\\")
def test_any_text_is_the_same_mesh_elsewhere(text):
    try:
        mesh = parse_obj(text)
    except InputError:
        assume(False)
    positions = np.arange(mesh.vertices.size).reshape(-1, 3) / 8 - 1
    after = moved(text, positions)
    again = parse_obj(after)
    np.testing.assert_array_equal(again.vertices, positions)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    np.testing.assert_array_equal(again.corner_counts, mesh.corner_counts)
    assert moved(after, positions) == after
    is_aside = re.compile(rb"#[^\r\n]*|\\(\r\n?|\n|\Z)")
    assert not re.search(rb"(\A|[\r\n])[ \t\v\f]*vn[\s]", is_aside.sub(b" ", after))
