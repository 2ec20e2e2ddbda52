"""Words become the numbers that Python's `float` and `int` make of them, to the bit."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cageik_cli.formats.obj.text import convert_words, read_vertex_lines
from cageik_cli.util import compiled

pytestmark = pytest.mark.usefixtures("core")

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
