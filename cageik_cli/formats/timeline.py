"""Frames by the numbers that a clip gives them, or by their indices from 0.

People name frames by number, and both ends of a range count: `1020-1060`. A slice of Python,
`0:48:2`, goes by index, and its end does not count.
"""

import math
import re
from dataclasses import dataclass
from typing import Any

from cageik_cli.util.errors import SettingError

FRAME_NUMBER_TOL = 1e-6
"""Of the step from frame to frame: a number this near is that of the frame."""

_NUMBER = r"-?\d{1,9}(?:\.\d{1,9})?"


@dataclass(frozen=True, slots=True)
class Timeline:
    """The numbers of the frames of a clip, one at least: `start`, and then in steps of `step`."""

    count: int
    start: float = 1.0
    step: float = 1.0

    @property
    def last(self) -> float:
        """The number of the last frame."""
        return self.start + (self.count - 1) * self.step

    def numbers(self, indices: Any) -> Any:
        """Return the numbers of frames, which are counted from 0: of an array as an array."""
        return self.start + self.step * indices

    def number_frame(self, index: int) -> str:
        """Return the number of a frame as text; `index` counts frames from 0."""
        return format_frame_number(self.numbers(index))

    def find_index(self, number: float) -> int:
        """Return the index of the frame that has a number.

        Raises
        ------
        SettingError
            When there is none.
        """
        place = (number - self.start) / self.step
        index = round(place)
        if abs(place - index) > FRAME_NUMBER_TOL or not 0 <= index < self.count:
            raise SettingError(
                f"there is no frame {format_frame_number(number)}; {self.describe()}"
            )
        return index

    def describe(self) -> str:
        """Say which frames there are, by number and by index."""
        if self.count == 1:
            return f"the clip has 1 frame, {self.number_frame(0)} (0 by index)"
        steps = "" if self.step == 1 else f" in steps of {format_frame_number(self.step)}"
        return (
            f"the clip has {self.count} frames, {self.number_frame(0)} to "
            f"{format_frame_number(self.last)}{steps} (0 to {self.count - 1} by index)"
        )

    def choose(self, wanted: "slice | FrameRange") -> range:
        """Return the indices of frames that are named by index or by number, one at least.

        Raises
        ------
        SettingError
            When there are none; or when a range of numbers goes beyond the clip.
        """
        if isinstance(wanted, FrameRange):
            return wanted.find_indices(self)
        chosen = range(self.count)[wanted]
        if not chosen:
            raise SettingError(
                f"`selection={format_slice(wanted)}` selects no frame, as a slice counts "
                f"from 0; {self.describe()}{self._suggest_numbers(wanted)}"
            )
        return chosen

    def _suggest_numbers(self, wanted: slice) -> str:
        """Ask whether the bounds of a slice are meant as numbers, if there are such frames."""
        low, high = wanted.start, wanted.stop
        if low is None or high is None or not self.start <= low <= min(high, self.last):
            return ""
        step = None if wanted.step in (None, 1) else wanted.step
        meant = FrameRange(low, high if high <= self.last else None, step)
        return f"; did you mean `selection={meant.typed}`?"


@dataclass(frozen=True, slots=True)
class FrameRange:
    """Frames by number, from the first to the last, which counts, too.

    Attributes
    ----------
    first, last : float, optional
        None for the first and the last frame of the clip.
    step : float, optional
        From number to number; all frames between if absent.
    """

    first: float | None
    last: float | None
    step: float | None = None

    @property
    def typed(self) -> str:
        """The range as `parse_frames` reads it."""
        first, last, step = map(_format_bound, (self.first, self.last, self.step))
        if self.first is not None and 0 <= self.first == self.last:
            return first
        return f"{first}-{last}{f'x{step}' if step else ''}"

    def find_indices(self, timeline: Timeline) -> range:
        """Return the indices of the frames of a clip; see `Timeline.choose`."""
        self._check_bounds(timeline)
        first = timeline.start if self.first is None else self.first
        last = timeline.last if self.last is None else self.last
        start = math.ceil((first - timeline.start) / timeline.step - FRAME_NUMBER_TOL)
        stop = math.floor((last - timeline.start) / timeline.step + FRAME_NUMBER_TOL) + 1
        if start >= stop:
            raise SettingError(f"`selection={self.typed}`: is no frame; {timeline.describe()}")
        return range(start, stop, self._count_steps(timeline))

    def _check_bounds(self, timeline: Timeline) -> None:
        """Refuse bounds that are beyond the clip, and those that may be read in two ways."""
        low, high, tolerance = timeline.start, timeline.last, FRAME_NUMBER_TOL * timeline.step
        is_below = self.first is not None and self.first < low - tolerance
        is_above = self.last is not None and self.last > high + tolerance
        is_apart = self.first is not None and self.first > high + tolerance
        is_apart = is_apart or (self.last is not None and self.last < low - tolerance)
        if is_apart:
            raise SettingError(
                f"`selection={self.typed}`: {timeline.describe()}; choose some of them"
            )
        if is_below or is_above:
            ends = None if is_below else self.first, None if is_above else self.last
            inside = FrameRange(*ends, self.step).typed
            advice = f"give `selection={inside}`" if inside != "-" else "leave out `selection=`"
            raise SettingError(
                f"`selection={self.typed}`: goes beyond the clip; {timeline.describe()}; "
                f"{advice} to take those that there are"
            )
        if self.first is None and self.last is not None and low <= -self.last < 0:
            typed = format_frame_number(self.last)
            raise SettingError(
                f"`selection={self.typed}`: may be frame -{typed}, or all up to {typed}; give "
                f"`selection=-{typed}--{typed}`, or `selection={timeline.number_frame(0)}-{typed}`"
            )

    def _count_steps(self, timeline: Timeline) -> int:
        """Return how many frames of the clip a step is."""
        steps = 1.0 if self.step is None else self.step / timeline.step
        if round(steps) < 1 or abs(steps - round(steps)) > FRAME_NUMBER_TOL:
            raise SettingError(
                f"`selection={self.typed}`: {timeline.describe()}; give a multiple of their step"
            )
        return round(steps)


def format_frame_number(number: float) -> str:
    """Return the number of a frame as text, whole where it is."""
    return f"{number + 0.0:.10g}"  # no minus before zero


def _format_bound(number: float | None) -> str:
    return "" if number is None else format_frame_number(number)


def format_slice(wanted: slice) -> str:
    """Return a slice as `parse_frames` reads it."""
    bounds = (wanted.start, wanted.stop, *([wanted.step] if wanted.step else []))
    return ":".join("" if bound is None else str(bound) for bound in bounds)


def parse_frame_number(text: str) -> float:
    """Return the number of a frame that a text states."""
    if not re.fullmatch(_NUMBER, text.strip()):
        raise SettingError(f"{text!r} is not the number of a frame, such as 1020, or auto")
    return float(text)


def parse_frames(text: str) -> slice | FrameRange:
    """Return the frames that a text names: by number (`1020-1060x2`), or by index (`0:48:2`).

    Raises
    ------
    SettingError
        When it names none, or no clip can have such frames.
    """
    words = text.strip()
    by_index = re.fullmatch(r"(-?\d{1,9})?:(-?\d{1,9})?(?::(\d{1,9})?)?", words)
    if by_index and int(by_index[3] or 1):
        return _check_slice(
            slice(*(None if part is None else int(part) for part in by_index.groups()))
        )
    if re.fullmatch(r"\d{1,9}(?:\.\d{1,9})?", words):
        return FrameRange(float(words), float(words))
    by_number = re.fullmatch(rf"({_NUMBER})?-({_NUMBER})?(?:x(\d{{1,9}}(?:\.\d{{1,9}})?))?", words)
    if not by_number or words == "-" or (by_number[3] and float(by_number[3]) == 0):
        raise SettingError(
            f"{text!r} is not a choice of frames; expected their numbers, such as 1020-1060, "
            "1020-1060x2, 1020 or 1020-, or a slice 0:48:2, which counts from 0"
        )
    first, last, step = (None if part is None else float(part) for part in by_number.groups())
    chosen = FrameRange(first, last, step)
    if first is not None and last is not None and last < first:
        raise SettingError(
            f"{text!r} ends before it begins; did you mean {FrameRange(last, first, step).typed}?"
        )
    return chosen


def _check_slice(wanted: slice) -> slice:
    """Refuse a slice that is empty in every clip."""
    low, high = wanted.start or 0, wanted.stop
    if high is not None and (low >= 0) == (high >= 0) and low >= high:
        swapped = format_slice(slice(high, low, wanted.step))
        meant = f"{swapped}, or {high}-{low} for numbers of frames" if low > high else f"{low}"
        raise SettingError(
            f"'{format_slice(wanted)}' selects no frame, as a slice ends before its second number; "
            f"did you mean {meant}?"
        )
    return wanted
