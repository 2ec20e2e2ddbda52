"""Plots do not depend on the user's settings; names are cut and letters replaced."""

import matplotlib as mpl
import pytest

from cageik_cli.report.plots.style import (
    DEFAULT_MAX_LENGTH,
    make_drawable,
    measure_text_width,
    use_fixed_style,
)


def test_matplotlib_settings_of_the_user_are_ignored_and_restored():
    with mpl.rc_context({"font.size": 31.0, "axes.facecolor": "red"}):
        with use_fixed_style():
            assert mpl.rcParams["font.size"] == 9.0
            assert mpl.rcParams["axes.facecolor"] == "white"
        assert mpl.rcParams["font.size"] == 31.0


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("walk_01.obj", "walk_01.obj"),
        ("a\nb\ud800", "a\ufffdb\ufffd"),
        ("x" * DEFAULT_MAX_LENGTH, "x" * DEFAULT_MAX_LENGTH),
        ("", ""),
    ],
)
def test_letters_that_the_font_lacks_are_replaced(name, expected):
    assert make_drawable(name) == expected


@pytest.mark.parametrize("longest", [20, DEFAULT_MAX_LENGTH])
def test_long_names_keep_their_ends(longest):
    text = make_drawable("first" + "x" * 100 + "last", longest)
    assert len(text) <= longest
    assert text.startswith("first")
    assert text.endswith("last")


def test_widths_grow_with_letters_and_their_size():
    assert measure_text_width("", 10) == 0
    assert 4 * measure_text_width("m", 10) == pytest.approx(measure_text_width("mmmm", 10), rel=0.1)
    assert 2 * measure_text_width("mile", 10) == pytest.approx(
        measure_text_width("mile", 20), rel=0.1
    )
    assert measure_text_width("iiii", 10) < measure_text_width("mmmm", 10)
