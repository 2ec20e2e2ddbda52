"""OBJ text: every dialect gives one mesh, and every number is `float(text)`, on all paths."""

import codecs
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cageik_cli.formats.obj.frames import ObjFrameParser
from cageik_cli.formats.obj.text import (
    _parse_word_by_word,
    blank_out,
    convert_words,
    parse_obj,
    read_vertex_lines,
    tokenize,
)
from cageik_cli.util import compiled
from cageik_cli.util.errors import FormatError
from tests.formats.obj.by_lines import fans, parse_by_lines

pytestmark = pytest.mark.usefixtures("core")

VERTICES = [[0, 0, 0], [1.5, 0, 0], [0, -2, 0], [0, 0, 0.25]]
FACES = [[0, 2, 1], [0, 1, 3]]
HEAD = b"# a comment\no thing\nv 0 0 0\nv 1.5 0 0\nv 0 -2 0\nv 0 0 0.25\n"
PLAIN = HEAD + b"f 1 3 2\nf 1 2 4\n"

DIALECTS = {
    "plain": PLAIN,
    "CRLF": PLAIN.replace(b"\n", b"\r\n"),
    "byte order mark": b"\xef\xbb\xbf" + PLAIN[PLAIN.index(b"v 0 0 0") :],
    "CR": PLAIN.replace(b"\n", b"\r"),
    "no newline at the end": PLAIN.rstrip(),
    "comments between": PLAIN.replace(b"\nv", b"\n# v 9 9 9\n\nv").replace(b"\nf", b"\n#\nf"),
    "comment behind": PLAIN + b"# done\n",
    "comments behind lines": PLAIN.replace(b"1.5 0 0", b"1.5 0 0 # wide").replace(
        b"f 1 3 2", b"f 1 3 2# 4 5"
    ),
    "comment behind vertices": PLAIN.replace(b"-2 0\n", b"-2 0# v 1\n"),
    "comments with backslashes": PLAIN.replace(b"1.5 0 0", b"1.5 0 0 # C:\\").replace(
        b"f 1 3 2", b"f 1 3 2 # D:\\"
    ),
    "leading blanks": PLAIN.replace(b"\nv", b"\n  v").replace(b"\nf", b"\n\tf"),
    "wide gaps": PLAIN.replace(b" ", b" \t "),
    "trailing blanks": PLAIN.replace(b"\n", b" \n"),
    "colours": PLAIN.replace(b"\nv 0 0 0\n", b"\nv 0 0 0 .1 .2 .3\n"),
    "w": PLAIN.replace(b"\nv 0 0 0\n", b"\nv 0 0 0 1.0\n"),
    "normals": PLAIN.replace(b"\nf", b"\nvn 0 0 1\nvt 0 1\nf", 1),
    "normals between": PLAIN.replace(b"\nv", b"\nvn 0 0 1\nv"),
    "f a/b": HEAD + b"f 1/1 3/2 2/3\nf 1/1 2/2 4/3\n",
    "f a/b/c": HEAD + b"f 1/1/1 3/2/2 2/3/3\nf 1/1/1 2/2/2 4/3/3\n",
    "f a//c": HEAD + b"f 1//1 3//2 2//3\nf 1//1 2//2 4//3\n",
    "several spellings of a corner": HEAD + b"f 1 3//2 2/3\nf 1/1/ 2 4\n",
    "colours and w of all": b"\n".join(
        line + b" 1 0.5 1.0" * line.startswith(b"v ") for line in PLAIN.split(b"\n")
    ),
    "double blanks and a blank behind": PLAIN.replace(b"v ", b"v  ").replace(b"\n", b" \r\n"),
    "scientific notation": PLAIN.replace(b"1.5", b"15E-1").replace(b"0.25", b"+2.5e-01"),
    "normals, groups and materials": HEAD + b"vn 0 0 1\nvt 0 1\ng a\nusemtl b\ns 1\n"
    b"f 1//1 3//1 2//1\n\ng c\n# 1 face\nf 1//1 2//1 4//1\n",
    "several objects": b"o a\nv 0 0 0\nv 1.5 0 0\nv 0 -2 0\nvn 0 0 1\nf 1 3 2\n"
    b"o b\nv 0 0 0.25\nvn 0 0 1\nf 1 2 4\n",
    "negative indices of several objects": b"v 0 0 0\nv 1.5 0 0\nv 0 -2 0\nf -3 -1 -2\n"
    b"v 0 0 0.25\nf -4 -3 -1\n",
    "negative indices": HEAD + b"f -4 -2 -3\nf -4 -3 -1\n",
    "faces first": b"f 1 3 2\nf 1 2 4\n" + HEAD,
    "vertices behind a face": HEAD.replace(b"v 0 0 0.25\n", b"f 1 3 2\nv 0 0 0.25\nf 1 2 4\n"),
    "groups between": HEAD + b"g a\nusemtl b\ns 1\nf 1 3 2\ng c\nf 1 2 4\n",
    "line continuation": PLAIN.replace(b"f 1 3 2", b"f 1 \\\n3 2").replace(b"v 1.5", b"v \\\n1.5"),
}


SLOW = {"faces first", "byte order mark"}
"""Not read by the fast path for frames."""


def frame_of(data: bytes, first: bytes = PLAIN) -> np.ndarray | None:
    return ObjFrameParser(first, parse_obj(first).vertices).parse_positions(data)


@pytest.mark.parametrize("data", DIALECTS.values(), ids=DIALECTS)
def test_every_dialect_gives_the_same_mesh(data):
    mesh = parse_obj(data)
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.fans, FACES)
    assert mesh.polygon_count == 0


@pytest.mark.parametrize("dialect", DIALECTS)
def test_the_fast_path_takes_what_exporters_write(dialect):
    """The frame moves, and what is not compared changes with it."""
    first = DIALECTS[dialect]
    data = (
        first.replace(b"1.5", b"1.25")
        .replace(b"15E", b"12.5E")
        .replace(b"vn 0 0 1", b"vn 1 0 0")
        .replace(b"thing", b"b")
    )
    fast = frame_of(data, first)
    if dialect in SLOW:
        assert fast is None
    else:
        moved = np.array(VERTICES)
        moved[1, 0] = 1.25
        np.testing.assert_array_equal(fast, moved)


def test_a_line_may_continue_in_a_file_of_crlf_lines():
    data = DIALECTS["line continuation"].replace(b"\n", b"\r\n")
    np.testing.assert_array_equal(parse_obj(data).vertices, VERTICES)


def test_a_comment_that_ends_in_a_backslash_swallows_no_line():
    data = PLAIN.replace(b"o thing", b"# C:\\models\\")
    np.testing.assert_array_equal(parse_obj(data).vertices, VERTICES)


def test_lines_that_end_in_bare_returns_are_read_in_linear_time():
    """Each of many comments was searched for the end of the text: minutes, or hours."""
    data = PLAIN.replace(b"\r\n", b"\n").replace(b"\n", b"\r") + b"# x\r" * 300_000
    np.testing.assert_array_equal(parse_obj(data).vertices, VERTICES)


def test_polygons_become_fans_at_their_first_corner():
    pentagon = b"".join(b"v %d %d 0\n" % xy for xy in ((0, 0), (2, 0), (3, 1), (2, 2), (0, 2)))
    mesh = parse_obj(pentagon + b"f 1 2 3\nf 1 3 4 5\nf 1 2 3 4 5\n")
    expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 2], [0, 2, 3], [0, 3, 4]]
    np.testing.assert_array_equal(mesh.fans, expected)
    assert mesh.polygon_count == 2


def test_vertices_of_one_place_stay_apart():
    mesh = parse_obj(b"v 1 1 1\nv 1 1 1\nv 1 1 1\nv 7 7 7\nf 1 2 3\n")
    assert len(mesh.vertices) == 4


FORMATS = ["{!r}", "{:.9g}", "{:.17g}", "{:e}", "{:.17E}", "{:.6f}"]


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=3, max_size=12),
    st.sampled_from(FORMATS),
)
def test_numbers_are_those_of_float_to_the_bit(values, form):
    words = [form.format(value) for value in values]
    words += ["0"] * (-len(words) % 3)
    rows = [words[k : k + 3] for k in range(0, len(words), 3)]
    data = "".join(f"v {' '.join(row)}\n" for row in rows).encode() + b"f 1 1 1\n"
    expected = np.array([[float(word) for word in row] for row in rows])
    assert parse_obj(data).vertices.tobytes() == expected.tobytes()
    fast = frame_of(data, first=data)
    assert fast is not None
    assert fast.tobytes() == expected.tobytes()


@pytest.mark.parametrize("word", ["+1", ".5", "1.", "-0", "1e400", "1e-400", "inf", "-Infinity"])
def test_unusual_numbers_are_those_of_float(word):
    data = PLAIN.replace(b"1.5", word.encode())
    expected = np.array(VERTICES, float)
    expected[1, 0] = float(word)
    assert parse_obj(data).vertices.tobytes() == expected.tobytes()
    fast = frame_of(data)
    assert fast is None or fast.tobytes() == expected.tobytes()


SNIPPETS = [b"\n", b"\r", b" ", b"\t", b"v", b"f", b"#", b"-", b".", b"e", b"_", b"nan", b"vn",
            b"\nv 1 2 3", b"\nvn 1 2 3", b"\nf 1 2 3", b"\nl 1 2", b"\"", b",", b"\\", b"\\\n",
            b"\0", b"/1"]  # fmt: skip


def edited(edits, data):
    for place, removed, inserted in edits:
        data = data[:place] + inserted + data[place + removed :]
    return data


EDITS = st.lists(
    st.tuples(
        st.integers(0, len(PLAIN)),
        st.integers(0, 8),
        st.one_of(st.sampled_from(SNIPPETS), st.binary(max_size=3)),
    ),
    max_size=3,
)


@given(EDITS, st.sampled_from(sorted(DIALECTS)))
@example([(2, 0, b"\0")], "plain")
@example([(len(b"# a comment\no thing"), 0, b"\\")], "plain")
@example([(len(HEAD) + 3, 0, b"\r v 1 2 3")], "normals")
@example([(len(HEAD), 0, b"v#\n")], "normals")
def test_the_fast_path_declines_or_agrees_with_the_parser(edits, dialect):
    """A frame as the first is, but for the edits; the oracle goes by lines."""
    first = DIALECTS[dialect]
    data = edited(edits, first)
    fast = frame_of(data, first)
    if fast is None:
        return
    vertices, polygons = parse_by_lines(data.removeprefix(codecs.BOM_UTF8))
    assert fast.tobytes() == vertices.tobytes()
    assert fans(polygons) == FACES


@given(EDITS, st.sampled_from(sorted(DIALECTS)))
@example([(PLAIN.index(b"f 1 3") + 2, 1, b"0x1")], "plain")
@example([(PLAIN.index(b"f 1 3") + 3, 0, b" /2")], "plain")
@example([(len(HEAD) + len(b"f 1/1/1 3/2/2 2/3"), 0, b"#")], "f a/b/c")
@example([(len(HEAD) + len(b"f 1/1/1 3/"), 0, b"#")], "f a/b/c")
@example([(len(HEAD), 0, b"\\\n# f 9\n")], "plain")
@example([(len(HEAD) + len(b"f 1 3 2"), 0, b" \\\n# 4")], "plain")
def test_a_file_is_the_mesh_that_its_lines_are(edits, dialect):
    """Whether its numbers are converted all at once or word by word."""
    data = edited(edits, DIALECTS[dialect]).removeprefix(codecs.BOM_UTF8)
    if b"\0" in data or not data.strip():
        return
    expected = parse_by_lines(data)
    for parse in (parse_obj, lambda data: _parse_word_by_word(tokenize(blank_out(data)), data)):
        try:
            mesh = parse(data)
        except FormatError:
            assert expected is None
            continue
        if not len(mesh.corner_counts):  # points, which are refused as a mesh, but not as a frame
            assert expected is None
        else:
            assert mesh.vertices.tobytes() == expected[0].tobytes()
            assert mesh.fans.tolist() == fans(expected[1])
            assert mesh.corner_counts.tolist() == [len(polygon) for polygon in expected[1]]


@pytest.mark.parametrize("dialect", DIALECTS)
def test_texts_of_more_than_32_bits_are_read_alike(monkeypatch, dialect):
    monkeypatch.setattr("cageik_cli.formats.obj.text.MAX_SHORT_TEXT", 10)
    mesh = parse_obj(DIALECTS[dialect])
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.fans, FACES)


@pytest.mark.parametrize(
    "data",
    [
        PLAIN.replace(b"f 1 2 4", b"f 1 4 2"),
        PLAIN + b"f 1 2 3\n",
        HEAD,
        b"",
        DIALECTS["CRLF"],
        DIALECTS["vertices behind a face"],
    ],
)
def test_the_fast_path_declines_another_face_block(data):
    assert frame_of(data) is None


def test_faces_between_vertices_are_compared_too():
    first = DIALECTS["vertices behind a face"]
    assert frame_of(first, first) is not None
    assert frame_of(first.replace(b"f 1 3 2", b"f 1 2 3"), first) is None
    moved = first.replace(b"f 1 3 2\nv 0 0 0.25\n", b"v 0 0 0.25\nf 1 3 2\n")
    assert frame_of(moved, first) is None


FAULTS = {
    "empty": (b"", "empty"),
    "blank": (b" \n\n", "empty"),
    "binary": (b"v 0 0 0\n\0\1", "binary"),
    "other text": (b"solid thing\nendsolid\n", "0 vertices and 0 faces"),
    "no vertices": (b"f 1 2 3\n", "0 vertices and 1 faces"),
    "two coordinates": (PLAIN.replace(b"0 -2 0", b"0 -2"), "line 5: `v 0 -2` has 2 coordinates"),
    "a word": (PLAIN.replace(b"-2", b"two"), "line 5: `v 0 two 0`"),
    "digit separator": (PLAIN.replace(b"-2", b"1_0"), "line 5: `v 0 1_0 0`"),
    "commented out": (PLAIN.replace(b"0 -2 0", b"0 -2 # 0"), "line 5: `v 0 -2 # 0` has 2"),
    "two corners": (
        HEAD + b"f 1 2\nf 1 2 3\n",
        "`f 1 2` has 2 corners, expected 3 or more; export",
    ),
    "cut off": (
        PLAIN + b"f 3",
        "`f 3` has 1 corner, expected 3 or more; the file is cut off there",
    ),
    "a corner that is a word": (HEAD + b"f 1 2 x/1\n", "line 7: `f 1 2 x/1`"),
    "vertex 0": (HEAD + b"f 0 1 2\n", "line 7: `f 0 1 2` names vertex 0"),
    "back too far": (HEAD + b"f 1 2 -5\n", "line 7: `f 1 2 -5` names vertex -5"),
    "beyond the last": (HEAD + b"f 1 2 5\n", "names vertex 5, the file has 4"),
    "a long line": (HEAD + b"f " + b"1/2/x " * 40 + b"x\n", "line 7: `f 1/2/x"),
    "CRLF": (HEAD.replace(b"\n", b"\r\n") + b"f 1 2\r\n", "line 7: `f 1 2` has 2"),
    "CR": (HEAD.replace(b"\n", b"\r") + b"f 1 2\r", "line 7: `f 1 2` has 2"),
    "behind a line that goes on": (
        HEAD + b"f 1 \\\n 2 3\ng a\\\r\nb\n\nf 1 2",
        "line 12: `f 1 2` has 2",
    ),
    "in a line that goes on": (HEAD + b"\\\n\\\nf 1\\\n 2\n", "line 7: `"),
    "the last of many": (PLAIN * 3 + b"f 1 x 2", "line 25: `f 1 x 2`"),
}


@pytest.mark.parametrize(("data", "says"), FAULTS.values(), ids=FAULTS)
def test_faults_name_the_line_and_what_it_says(data, says):
    with pytest.raises(FormatError) as caught:
        parse_obj(data)
    assert says in str(caught.value)
    assert len(str(caught.value)) < 200
    assert frame_of(data) is None


def test_words_of_a_line_are_found_without_looking_at_all_lines(monkeypatch):
    """A quadratic time would take minutes for a few megabytes."""
    words = tokenize(blank_out(b"v 0 0 0\n\n" * 1000 + b"f 1 2 3 4\n"))
    monkeypatch.setattr(np, "diff", None)
    assert words.split_line(999) == [b"v", b"0", b"0", b"0"]
    assert words.split_line(1000) == [b"f", b"1", b"2", b"3", b"4"]


DIGITS = st.text("0123456789", max_size=24)
NUMBERS = st.builds(
    lambda sign, whole, point, part, power: sign + whole + (point and point + part) + power,
    st.sampled_from(["", "-", "+"]),
    DIGITS,
    st.sampled_from(["", "."]),
    DIGITS,
    st.one_of(st.just(""), st.builds("e{}".format, st.integers(-345, 320))),
)


def cut_exactly(text):
    """A text in memory that ends with it, unlike that of bytes, for the sanitizer."""
    return text if compiled.kernel is None else np.frombuffer(text, np.uint8).copy()


def convert(words, dtype=np.float64, kind=np.int32):
    text = cut_exactly(" ".join(words).encode())
    ends = np.cumsum([len(word.encode()) + 1 for word in words]) - 1
    begins = np.concatenate([[0], ends[:-1] + 1])
    return convert_words(text, np.stack([begins, ends], axis=1).astype(kind), dtype)


def assert_read_as_float(word):
    try:
        expected = float(word)
    except ValueError:
        expected = np.inf
    found = convert([word])
    if np.isinf(expected):
        assert found is None
    else:
        assert found is not None, word
        assert found.tobytes() == np.float64(expected).tobytes(), word


@given(NUMBERS)
@example("")
@example(".")
@example("1.")
@example(".5")
@example("-.e1")
@example("1e")
@example("1e+")
@example("9007199254740993")
@example("9007199254740992.5")
@example("0." + "0" * 30 + "1")
@example("1" * 400)
@example("0." + "3" * 1500)
@example("1" + "0" * 1500 + "e-1500")
@example("2.2250738585072011e-308")
@example("4.9e-324")
@example("2.4703282292062327e-324")
@example("1.7976931348623159e308")
@example("1e99999999999999999999")
@example("1e-99999999999999999999")
def test_every_decimal_is_rounded_as_by_float(word):
    if len(word) > 1024 and compiled.kernel is not None:
        assert convert([word]) is None  # left to the other parser
    else:
        assert_read_as_float(word)


@given(st.floats(1e-6, 1e15), st.integers(0, 19), st.integers(-2, 2))
def test_numbers_around_the_middle_of_two_doubles_are_rounded_to_the_nearest(value, places, step):
    """Digits that are cut where long division must decide."""
    middle = (Fraction(value) + Fraction(float(np.nextafter(value, np.inf)))) / 2
    digits = str(int(middle * 10**places) + step).rjust(places + 1, "0")
    word = f"{digits[: len(digits) - places]}.{digits[len(digits) - places :]}"
    assert_read_as_float(word)
    assert_read_as_float("-" + word)


@pytest.mark.parametrize("size", [15, 16, 17, 18, 19, 20, 25])
def test_numbers_of_every_length_are_rounded_to_the_nearest(size):
    generator = np.random.default_rng(size)
    for _ in range(100):
        digits = "".join(map(str, generator.integers(0, 10, size)))
        place = int(generator.integers(0, size))
        assert_read_as_float(f"{digits[:place]}.{digits[place:]}")


@pytest.mark.parametrize("word", ["nan", "NaN", "-nan", "+NAN"])
def test_missing_coordinates_are_numbers(word):
    assert np.isnan(convert([word])[0])


@pytest.mark.parametrize(
    "word",
    ["inf", "-Infinity", "1e400", "x", "1x", "1_0", "0x10", "1,5", "--1", "+-1", "nanx", "é",
     "1.5.2", "e5", "\x001", "1d5"],
)  # fmt: skip
def test_other_words_are_no_numbers(word):
    assert convert(["1", word, "2"]) is None


@pytest.mark.parametrize("word", ["0", "7", "-3", "+12", "0012", str(10**18 - 1), "-" + "9" * 18])
def test_integers_are_those_of_int(word):
    assert convert([word], np.int64).tolist() == [int(word)]


@pytest.mark.parametrize("word", ["", "-", "1.0", "1e3", "x", "1_0", "0x1", "1/2", "9" * 30])
def test_other_words_are_no_integers(word):
    assert convert(["1", word], np.int64) is None


@pytest.mark.parametrize("kind", [np.int32, np.int64])
def test_places_are_counted_by_32_or_64_bits(kind):
    assert convert(["1.5", "-2", "3e2"], kind=kind).tolist() == [1.5, -2, 300]


def vertices(text, count):
    found = read_vertex_lines(cut_exactly(text), len(text), count)
    if compiled.kernel is None:
        assert found is None
        pytest.skip("without a compiled body all is left to the words")
    return None if found is None else found.tolist()


@pytest.mark.parametrize(
    "text",
    [
        b"v 1 2 3\nv 4 5 6\n",
        b"v 1 2 3\r\n  v\t4 5\v6",
        b"# v 9 9 9\no a\nv 1 2 3 0.5 x y\nvn 0 0 1\nvt 1 1\n\n \nv 4 5 6#7\n#",
        b"v 1 2 3\nfo 1 2\nvv 1\nv 4 5 6 # \xff\n",
    ],
)
def test_vertices_are_read_line_by_line(text):
    assert vertices(text, 2) == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"v 1 2 3\n",
        b"v 1 2 3\nv 4 5 6\nv 7 8 9\n",
        b"v 1 2 3\nv 4 5\n",
        b"v 1 2 3\nv 4 5 6x\n",
        b"v 1 2 3\nv 4 5\n6\n",
        b"v 1 2 3\nv\n",
        b"v 1 2 3\nv 4 5 6\nv",
        b"v 1 2 3\nv 4 5 6\nf 1 2 3\n",
        b"v 1 2 3\nv 4 5 6\nf",
        b"v 1 2 3\rv 4 5 6\n",
        b"v 1 2 3\nv 4 5 6\n# a\rv 7 8 9\n",
        b"v 1 2 3\nv 4 5 \\\n6\n",
        b"v 1 2 3\nv 4 5 6\n\0",
        b"v 1 2 3\nv 4 5 inf\n",
        b"v 1 2 3\nv 4 5 1e999\n",
        b"v 1 2 3\nv 4 5# 6\n",
    ],
)
def test_other_texts_are_left_to_the_other_parser(text):
    assert vertices(text, 2) is None


def test_only_the_given_length_of_a_text_is_read():
    text = b"v 1 2 3\nv 4 5 6\nv 7 8 9\n"
    for length in range(len(text)):
        found = read_vertex_lines(text, length, 2)
        if compiled.kernel is not None and length in (15, 16):
            assert found.tolist() == [[1, 2, 3], [4, 5, 6]]
        else:
            assert found is None


def test_the_compiled_body_refuses_places_outside_the_text_and_other_arrays():
    kernel = compiled.kernel
    if kernel is None:
        pytest.skip("the core is off")
    numbers = np.empty(1)
    for pair in ([-1, 1], [0, 9], [2, 1], [1 << 40, 1 << 41]):
        assert not kernel.parse_words(b"1 2", np.array([pair]), True, False, numbers)
    pairs = np.array([[0, 1]], np.int32)
    assert kernel.parse_words(b"1 2", pairs, False, False, numbers)
    for arguments in (
        (b"1 2", pairs, True, False, numbers),
        (b"1 2", pairs, False, True, numbers),
        (b"1 2", pairs, False, False, np.empty(2)),
        (b"1 2", pairs, False, False, np.empty((1, 1))),
        (b"1 2", pairs[:, :1].copy(), False, False, numbers),
        ("1 2", pairs, False, False, numbers),
        (b"1 2", pairs, False, False, b"12345678"),
    ):
        with pytest.raises((TypeError, ValueError)):
            kernel.parse_words(*arguments)
    for length in (-1, 4, 1 << 60):
        assert not kernel.parse_positions(b"   ", length, np.empty((0, 3)))
    for wrong in (np.empty((1, 2)), np.empty(3), np.empty((1, 3), np.float32), np.empty((3, 2)).T):
        with pytest.raises((TypeError, ValueError)):
            kernel.parse_positions(b"v 1 2 3\n", 8, wrong)
