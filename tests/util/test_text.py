"""Names and sizes as text."""

from pathlib import Path

import pytest

from cageik_cli.util.text import (
    format_bytes,
    format_count,
    format_decimals,
    format_row,
    group_digits,
    make_printable,
    number_names,
    single_line,
    to_unicode,
)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("é_1.obj", "é_1.obj"),
        ("\U0001f40e.obj", "\U0001f40e.obj"),
        ("p\udcff_1.obj", "p\ufffd_1.obj"),
        ("\ud800", "\ufffd"),
        (Path("a") / "\udcfe", str(Path("a") / "\ufffd")),
    ],
)
def test_names_become_text_that_can_be_written(name, expected):
    assert to_unicode(name) == expected
    expected.encode()


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1000, "1 kB"),
        (1234, "1.23 kB"),
        (999_499, "999 kB"),
        (999_500, "1 MB"),
        (42_100_000, "42.1 MB"),
        (3 * 10**9, "3 GB"),
        (5 * 10**15, "5e+03 TB"),
    ],
)
def test_bytes(count, text):
    assert format_bytes(count) == text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("walk_01 ü.obj", "walk_01 ü.obj"),
        ("a\nb\tc\u00a0d\u2028e", "a b c d e"),
        ("a\x00\x1b[31m\x7f", "a\ufffd\ufffd[31m\ufffd"),
        ("\u202e\ufeff\uffff\ud800", "\ufffd" * 4),
    ],
)
def test_what_has_no_glyph_is_replaced(text, expected):
    assert single_line(text) == expected


@pytest.mark.parametrize(
    "mark", ["\x1b", "\x07", "\x9b", "\x7f", "\u202e", "\u2066", "\u200f", "\ud800"]
)
def test_what_controls_a_terminal_is_replaced(mark):
    assert make_printable(f"a{mark}b\n\tc") == "a\ufffdb\n\tc"
    assert single_line(f"a{mark}b\nc") == "a\ufffdb c"
    assert format_row(("label", f"a\n{mark}")) == "  label          a \ufffd"


@pytest.mark.parametrize("text", ["", "walk_é.obj", "馬 \U0001f40e", "a\u00a0b", "a\nb\r\tc"])
def test_what_is_printed_is_kept(text):
    assert make_printable(text) == text


@pytest.mark.parametrize(
    ("count", "noun", "text"),
    [
        (1, "vertex", "1 vertex"),
        (2, "vertex", "2 vertices"),
        (0, "face pair", "0 face pairs"),
        (34159, "vertex", "34 159 vertices"),
        (3, "pair of a rest and a cage face", "3 pairs of a rest and a cage face"),
    ],
)
def test_things_are_counted(count, noun, text):
    assert format_count(count, noun) == text


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0, "0"),
        (999, "999"),
        (1208, "1 208"),
        (1234567, "1 234 567"),
        (-15013, "-15 013"),
        ("15013.25", "15 013.25"),
        ("-1234.5678", "-1 234.5678"),
        ("1.23457e+06", "1.23457e+06"),
        ("0.00012345", "0.00012345"),
        ("nan", "nan"),
    ],
)
def test_digits_before_the_point_are_in_groups(number, text):
    assert group_digits(number) == text
    assert group_digits(number, "\u00a0") == text.replace(" ", "\u00a0")


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (0.0, 4, "0.0000"),
        (0.0003, 4, "0.0003"),
        (0.00031, 4, "0.0003"),
        (0.00006, 4, "0.0001"),
        (0.00004, 4, "4e-05"),
        (-0.0000312, 4, "-3.1e-05"),
        (1.9e-15, 4, "1.9e-15"),
        (0.004, 2, "0.004"),
        (0.06, 1, "0.1"),
        (0.04, 1, "0.04"),
        (0.4, 0, "0.4"),
        (70.4, 0, "70"),
    ],
)
def test_only_zero_is_written_as_zero(value, decimals, text):
    assert format_decimals(value, decimals) == text


@pytest.mark.parametrize(
    ("names", "taken", "unique"),
    [
        (["a", "b"], [], ["a", "b"]),
        (["a", "a", "a"], [], ["a", "a_2", "a_3"]),
        (["a_2", "a", "a"], [], ["a_2", "a", "a_3"]),
        (["a_b_2", "a_b", "a_b"], [], ["a_b_2", "a_b", "a_b_3"]),
        (["a", "a_2"], ["a", "a_2"], ["a_3", "a_2_2"]),
    ],
)
def test_names_are_told_apart_by_numbers(names, taken, unique):
    assert number_names(names, taken) == unique


def test_as_many_names_alike_as_a_file_may_hold_are_told_apart_soon():
    assert len(set(number_names(["a"] * 100_000))) == 100_000
