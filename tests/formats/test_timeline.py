"""Frames by number and by index, and what is said where there are none."""

import re
from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cageik_cli.formats.settings import ClipSettings
from cageik_cli.formats.timeline import FrameRange, Timeline, check_any_frame, parse_frames
from cageik_cli.util.errors import SettingError, WrongUsageError

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
        (Timeline(48, start=0), "60:70", "48 frames, 0 to 47; .*, as in `selection=0-9`"),
        (PLAIN, "1001-1050", "1 to 48 (0 to 47 by index); .*, as in `selection=1-10`"),
        (LATE, "1001-1050", "goes beyond the clip; .* give `selection=1001-` to take"),
        (LATE, "990-1010x2", "give `selection=1001-1010x2` to take those"),
        (LATE, "0-2000", "give `selection=1001-` to take"),
        (LATE, "50", "1001 to 1048 (0 to 47 by index); .*, as in `selection=1001-1010`"),
        (LATE, "1060-", "choose some of them"),
        (LATE, "-1000", "choose some of them"),
        (LATE, "1020:1040", "counts from 0 .* give `selection=1020-1040` for numbers"),
        (LATE, "1020:1060:2", "give `selection=1020-x2` for numbers"),
        (ODD, "1003:1009:2", "give `selection=1003-1009x4` for numbers"),
        (PLAIN, "60:70", "counts from 0 .*, as in `selection=1-10`"),
        (PLAIN, "60:", ", as in `selection=1-10`"),
        (PLAIN, ":0", "give `selection=0:1` for indices"),
        (PLAIN, "0:0", "give `selection=0:1` for indices"),
        (
            PLAIN,
            "50:20",
            "give `selection=20:50` for indices, or `selection=20-` for numbers",
        ),
        (LATE, "50:20", "give `selection=20:50` for indices"),
        (PLAIN, "5:5", "give `selection=5:6` for indices, or `selection=5` for the frame of that"),
        (LATE, "5:5", "give `selection=5:6` for indices"),
        (PLAIN, "-5:-9", "give `selection=-9:-5` for indices"),
        (PLAIN, "47:-5", "give `selection=-5:47` for indices"),
        (Timeline(12), "50:20", ", as in `selection=1-10`"),
        (PLAIN, "30-20x3", "ends before it begins; .* give `selection=20-30x3`"),
        (PLAIN, "50-20", "ends before it begins; .* give `selection=20-`"),
        (Timeline(12), "50-20", ", as in `selection=1-10`"),
        (ODD, "1002", "is no frame; the clip has 6 frames, 1001 to 1011 in steps of 2"),
        (ODD, "1001-1007x3", "give a multiple of their step"),
        (ODD, "1001-1007x1", "give a multiple of their step"),
        (BELOW, "-5", "may be frame -5, or all up to 5; give `selection=-5--5` for the one, or"),
        (BELOW, "-50-5", "give `selection=-10-5` to take"),
        (Timeline(1), "2", "the clip has 1 frame, 1 (0 by index); .*, as in `selection=1`"),
    ],
)
def test_frames_that_a_clip_does_not_have_are_refused(timeline, text, says):
    head = f"`selection={text}`"
    with pytest.raises(SettingError) as caught:
        timeline.choose(parse_frames(text))
    assert str(caught.value).startswith(head)
    for part in says.split(".*"):
        assert part.strip() in str(caught.value)


@given(
    ends=st.tuples(*[st.none() | st.integers(-4, 4)] * 2),
    step=st.none() | st.integers(1, 3),
    by_number=st.booleans(),
)
def test_a_choice_that_is_empty_in_every_clip_is_wrong_usage(ends, step, by_number):
    """Of slices by trying all clips of up to 20 frames, which are enough for these bounds."""
    wanted = FrameRange(*ends, step) if by_number else slice(*ends, step)
    if by_number:
        is_empty = None not in ends and ends[0] > ends[1]
    else:
        is_empty = not any(range(count)[wanted] for count in range(1, 21))
    try:
        PLAIN.choose(wanted)
        is_wrong = False
    except SettingError as error:
        is_wrong = isinstance(error, WrongUsageError)
    with pytest.raises(WrongUsageError) if is_empty else nullcontext():
        check_any_frame(wanted)
    assert is_wrong == is_empty


@pytest.mark.parametrize(
    "timeline", [PLAIN, LATE, ODD, HALVES, BELOW, Timeline(1), Timeline(3, -2)]
)
@given(
    ends=st.tuples(*[st.integers(-60, 60) | st.integers(990, 1060)] * 2), mark=st.sampled_from(":-")
)
def test_each_choice_that_is_advised_has_frames(timeline, ends, mark):
    for text in list_advised(timeline, f"{ends[0]}{mark}{ends[1]}"):
        assert timeline.choose(parse_frames(text))


def list_advised(timeline, text):
    """Return what the error on frames says to choose; nothing where they are a choice."""
    try:
        timeline.choose(parse_frames(text))
    except SettingError as error:
        _, *advised = re.findall("`selection=([^`]*)`", str(error))
        return advised if advised or "multiple of their step" in str(error) else ["nothing"]
    return []


@pytest.mark.parametrize(
    "text",
    ["-", "", "1020..1060", "1,2", "::0", "::-1", "1-9x0", "1-9x-2", "auto", "9" * 40],
)
def test_what_names_no_frames_is_refused(text):
    with pytest.raises(SettingError, match=r"is not a choice of frames; .* 1020-1060"):
        parse_frames(text)


@pytest.mark.parametrize(
    "wanted", [5, (1, 2), "1-5", None, slice(0, 9, 0), slice(9, 0, -1), slice(1.5, 3), slice("a")]
)
def test_settings_take_ranges_and_slices_forwards_only(wanted):
    with pytest.raises(SettingError, match="is not a choice of frames"):
        ClipSettings(wanted)


def test_settings_take_slices_of_numpy_numbers():
    assert PLAIN.choose(ClipSettings(slice(np.int64(3), None, np.int64(40))).selection) == range(
        3, 48, 40
    )


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 1e300, 48.5, 0.5])
def test_no_frame_has_a_number_beside_those_of_the_clip(number):
    with pytest.raises(SettingError, match="there is no frame"):
        PLAIN.find_index(number)


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
    assert parse_frames(chosen.option_text) == chosen
    assert timeline.find_index(numbers[last]) == last
    assert float(timeline.number_frame(first)) == numbers[first]
    with pytest.raises(SettingError, match="there is no frame"):
        timeline.find_index(start + count * step)
    with pytest.raises(SettingError, match="there is no frame"):
        timeline.find_index(start + step / 3)
