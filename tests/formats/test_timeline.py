"""Frames by number and by index, and what is said where there are none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.timeline import FrameRange, Timeline, parse_frames
from cageik_cli.util.errors import SettingError

PLAIN, LATE, ODD = Timeline(48), Timeline(48, 1001), Timeline(6, 1001, 2)
HALVES, BELOW = Timeline(5, 0.5, 0.5), Timeline(21, -10)


@pytest.mark.parametrize(
    ("timeline", "text", "indices"),
    [
        (PLAIN, "1-48", range(48)),
        (LATE, "1020-1040", range(19, 40)),
        (LATE, "1020-1040x2", range(19, 40, 2)),
        (LATE, "1020", range(19, 20)),
        (LATE, "1020-", range(19, 48)),
        (LATE, "-1020", range(20)),
        (LATE, " 1020-1020 ", range(19, 20)),
        (LATE, "1020-x9", range(19, 48, 9)),
        (ODD, "1002-1007", range(1, 4)),
        (ODD, "1003-1011x4", range(1, 6, 2)),
        (HALVES, "1.5-2.5", range(2, 5)),
        (HALVES, "1", range(1, 2)),
        (HALVES, "1-2x0.5", range(1, 4)),
        (BELOW, "-5-5", range(5, 16)),
        (BELOW, "-5--3", range(5, 8)),
        (BELOW, "--3", range(8)),
        (BELOW, "-3-", range(7, 21)),
        (LATE, "0:48:2", range(0, 48, 2)),
        (LATE, "-3:", range(45, 48)),
        (LATE, "40:99", range(40, 48)),
        (LATE, ":", range(48)),
    ],
)
def test_frames_are_named_by_number_or_index(timeline, text, indices):
    assert timeline.choose(parse_frames(text)) == indices


@pytest.mark.parametrize(
    ("timeline", "text", "says"),
    [
        (PLAIN, "1001-1050", "the clip has 48 frames, 1 to 48 (0 to 47 by index); choose some"),
        (LATE, "1001-1050", "goes beyond the clip; .* give `selection=1001-` to take"),
        (LATE, "990-1010x2", "give `selection=-1010x2` to take those"),
        (LATE, "0-2000", "leave out `selection=` to take"),
        (LATE, "50", "1001 to 1048 (0 to 47 by index)"),
        (LATE, "1060-", "choose some of them"),
        (LATE, "-1000", "choose some of them"),
        (LATE, "1020:1040", "counts from 0; .* did you mean `selection=1020-1040`?"),
        (LATE, "1020:1060:2", "did you mean `selection=1020-x2`?"),
        (PLAIN, "60:70", r"as a slice counts from 0; the clip has 48 frames, 1 to 48"),
        (ODD, "1002", "is no frame; the clip has 6 frames, 1001 to 1011 in steps of 2"),
        (ODD, "1001-1007x3", "give a multiple of their step"),
        (ODD, "1001-1007x1", "give a multiple of their step"),
        (BELOW, "-5", "may be frame -5, or all up to 5; give `selection=-5--5`, or"),
        (Timeline(1), "2", "the clip has 1 frame, 1 (0 by index)"),
    ],
)
def test_frames_that_a_clip_does_not_have_are_refused(timeline, text, says):
    head = f"`selection={text}`"
    with pytest.raises(SettingError) as caught:
        timeline.choose(parse_frames(text))
    assert str(caught.value).startswith(head)
    for part in says.split(".*"):
        assert part.strip() in str(caught.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("50:20", "did you mean 20:50, or 20-50 for numbers of frames?"),
        ("3:3", "did you mean 3?"),
        ("50-20", "did you mean 20-50?"),
        ("50-20x3", "did you mean 20-50x3?"),
        ("-", "is not a choice of frames"),
        ("", "is not a choice of frames"),
        ("1020..1060", "1020-1060"),
        ("1,2", "is not a choice of frames"),
        ("::0", "is not a choice of frames"),
        ("::-1", "is not a choice of frames"),
        ("1-9x0", "is not a choice of frames"),
        ("1-9x-2", "is not a choice of frames"),
        ("auto", "is not a choice of frames"),
        ("9" * 40, "is not a choice of frames"),
    ],
)
def test_what_names_no_frames_is_refused(text, says):
    with pytest.raises(SettingError) as caught:
        parse_frames(text)
    assert says in str(caught.value)


def test_a_slice_as_long_as_from_its_end_is_left_to_the_clip():
    assert LATE.choose(parse_frames("40:-2")) == range(40, 46)
    with pytest.raises(SettingError, match="selects no frame"):
        PLAIN.choose(parse_frames("47:-5"))


@given(
    start=st.integers(-2000, 2000).map(lambda k: k / 4),
    step=st.integers(1, 40).map(lambda k: k / 4),
    count=st.integers(1, 300),
    ends=st.tuples(st.integers(0, 299), st.integers(0, 299)),
)
def test_a_range_of_numbers_is_that_of_their_indices(start, step, count, ends):
    timeline = Timeline(count, start, step)
    first, last = sorted(min(end, count - 1) for end in ends)
    numbers = start + step * np.arange(count)
    chosen = FrameRange(numbers[first], numbers[last])
    assert timeline.choose(chosen) == range(first, last + 1)
    assert parse_frames(chosen.typed) == chosen
    assert timeline.find_index(numbers[last]) == last
    assert float(timeline.number_frame(first)) == numbers[first]
    with pytest.raises(SettingError, match="there is no frame"):
        timeline.find_index(start + count * step)
    with pytest.raises(SettingError, match="there is no frame"):
        timeline.find_index(start + step / 3)
