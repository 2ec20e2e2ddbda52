"""Frames by the numbers that a clip gives them, or by their indices from 0.

People name frames by number, and both ends of a range count: `1020-1060`. A slice of Python,
`0:48:2`, goes by index, and its end does not count.
"""

import math
import re
from dataclasses import dataclass
from numbers import Integral
from typing import Any, NoReturn

from cageik_cli.util.errors import SettingError, WrongUsageError
from cageik_cli.util.messages import Hint, Said, Text, join_texts, say
from cageik_cli.util.settings import show_value

FRAME_NUMBER_TOL = 1e-6
"""Of the step from frame to frame: a number this near is that of the frame."""

MAX_TIMELINE_NUMBER = 10**9
"""Numbers of frames are below it, as what people type has nine digits before its point."""

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
        is_inside = -0.5 < place < self.count - 0.5  # which nothing is that is not finite
        if not is_inside or abs(place - round(place)) > FRAME_NUMBER_TOL:
            raise SettingError(
                f"there is no frame {format_frame_number(number)}; {self.describe()}"
            )
        return round(place)

    def describe(self) -> str:
        """Say which frames there are, by number, and by index where that differs."""
        if self.count == 1:
            by_index = " (0 by index)" * (self.start != 0)
            return f"the clip has 1 frame, {self.number_frame(0)}{by_index}"
        steps = "" if self.step == 1 else f" in steps of {format_frame_number(self.step)}"
        differs = (self.start, self.step) != (0, 1)
        by_index = f" (0 to {self.count - 1} by index)" * differs
        return (
            f"the clip has {self.count} frames, {self.number_frame(0)} to "
            f"{format_frame_number(self.last)}{steps}{by_index}"
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
            error = WrongUsageError if _is_empty(wanted) else SettingError
            advice = self._advise(wanted)
            raise error(_describe_empty(wanted) + f"; {self.describe()}; " + advice)
        return chosen

    def _advise(self, wanted: slice) -> Text:
        """Say which choices may be meant by a slice without frames: those that have some here."""
        bounds = [bound for bound in (wanted.start, wanted.stop) if bound is not None]
        low, high, step = min(bounds), max(bounds), wanted.step or 1
        meant = slice(low, max(high, low + 1), wanted.step)
        advice = []
        if range(self.count)[meant]:
            advice.append(Hint("selection", format_slice(meant)) + " for indices")
        numbered = FrameRange(low, high, None if step == 1 else step * self.step).limit_to(self)
        if len(bounds) == 2 and numbered.list_indices(self):
            what = "the frame of that number" if low == high else "numbers"
            advice.append(Hint("selection", numbered.option_text) + f" for {what}")
        return "give " + join_texts(", or ", advice) if advice else self.suggest_others()

    def suggest_others(self) -> Text:
        """Advise to choose frames that the clip has: the first ten, for an example."""
        few = FrameRange(self.start, self.numbers(min(self.count, 10) - 1))
        return "choose some of them, as in " + Hint("selection", few.option_text)


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
    def option_text(self) -> str:
        """The range as `parse_frames` reads it."""
        first, last, step = (
            "" if number is None else format_frame_number(number)
            for number in (self.first, self.last, self.step)
        )
        if self.first is not None and 0 <= self.first == self.last:
            return first
        return f"{first}-{last}{f'x{step}' if step else ''}"

    def find_indices(self, timeline: Timeline) -> range:
        """Return the indices of the frames of a clip; see `Timeline.choose`."""
        if _is_empty(self):
            turned = FrameRange(self.last, self.first, self.step).limit_to(timeline)
            is_known = bool(turned.list_indices(timeline))
            advice = (
                "give " + Hint("selection", turned.option_text)
                if is_known
                else timeline.suggest_others()
            )
            raise WrongUsageError(_describe_empty(self) + f"; {timeline.describe()}; " + advice)
        inside = self.limit_to(timeline)
        if inside != self:
            advice = (
                "give " + Hint("selection", inside.option_text) + " to take those that there are"
            )
            if not inside.list_indices(timeline):
                advice = timeline.suggest_others()
            self._refuse("goes beyond the clip", timeline, advice)
        if self.first is None and self.last is not None and timeline.start <= -self.last < 0:
            typed = format_frame_number(self.last)
            raise SettingError(
                Hint("selection", self.option_text)
                + f": may be frame -{typed}, or all up to {typed}; give "
                + Hint("selection", f"-{typed}--{typed}")
                + " for the one, or "
                + Hint("selection", f"{timeline.number_frame(0)}-{typed}")
                + " for the other"
            )
        found = self.list_indices(timeline)
        if not found:
            self._refuse("is no frame", timeline, timeline.suggest_others())
        return found

    def list_indices(self, timeline: Timeline) -> range:
        """Return the indices of the frames of a clip that are in the range, perhaps none."""
        inside = self.limit_to(timeline)
        first = timeline.start if inside.first is None else inside.first
        last = timeline.last if inside.last is None else inside.last
        start = math.ceil((first - timeline.start) / timeline.step - FRAME_NUMBER_TOL)
        stop = math.floor((last - timeline.start) / timeline.step + FRAME_NUMBER_TOL) + 1
        steps = 1.0 if self.step is None else self.step / timeline.step
        if round(steps) < 1 or abs(steps - round(steps)) > FRAME_NUMBER_TOL:
            raise SettingError(
                Hint("selection", self.option_text)
                + f": {timeline.describe()}; give a multiple of their step"
            )
        return range(start, min(stop, timeline.count), round(steps))

    def limit_to(self, timeline: Timeline) -> "FrameRange":
        """Return the part of the range that is in a clip."""
        tolerance = FRAME_NUMBER_TOL * timeline.step
        is_below = self.first is not None and self.first < timeline.start - tolerance
        is_above = self.last is not None and self.last > timeline.last + tolerance
        return FrameRange(
            timeline.start if is_below else self.first, None if is_above else self.last, self.step
        )

    def _refuse(self, why: str, timeline: Timeline, advice: Said) -> NoReturn:
        raise SettingError(
            Hint("selection", self.option_text) + f": {why}; {timeline.describe()}; " + advice
        )


def format_frame_number(number: float) -> str:
    """Return the number of a frame as text, whole where it is."""
    return f"{number + 0.0:.10g}"  # no minus before zero


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
        return slice(*(None if part is None else int(part) for part in by_index.groups()))
    if re.fullmatch(r"\d{1,9}(?:\.\d{1,9})?", words):
        return FrameRange(float(words), float(words))
    by_number = re.fullmatch(rf"({_NUMBER})?-({_NUMBER})?(?:x(\d{{1,9}}(?:\.\d{{1,9}})?))?", words)
    if not by_number or words == "-" or (by_number[3] and float(by_number[3]) == 0):
        raise _make_error(text)
    return FrameRange(*(None if part is None else float(part) for part in by_number.groups()))


def check_frames(wanted: object) -> None:
    """Refuse what is neither a range of numbers, nor a slice of whole numbers that goes forwards.

    Raises
    ------
    SettingError
        Naming what was given.
    """
    if isinstance(wanted, slice):
        parts = (wanted.start, wanted.stop, wanted.step)
        is_whole = all(part is None or isinstance(part, Integral) for part in parts)
        if is_whole and (wanted.step is None or wanted.step > 0):
            return
    elif isinstance(wanted, FrameRange):
        return
    raise _make_error(wanted)


def check_any_frame(wanted: slice | FrameRange) -> None:
    """Refuse a choice that is empty in every clip; `Timeline.choose` does so, too, and advises.

    Raises
    ------
    WrongUsageError
        Naming the choice.
    """
    if _is_empty(wanted):
        raise WrongUsageError(
            _describe_empty(wanted)
            + "; "
            + say("give frames that go forwards, as in `selection=1020-1060`")
        )


def _describe_empty(wanted: slice | FrameRange) -> Text:
    """Say why a choice has no frame."""
    if isinstance(wanted, FrameRange):
        return Hint("selection", wanted.option_text) + ": ends before it begins"
    return (
        Hint("selection", format_slice(wanted))
        + " selects no frame, as a slice counts from 0 and ends before its second number"
    )


def _is_empty(wanted: slice | FrameRange) -> bool:
    """Return whether a choice has no frame in any clip; indices below 0 count from the end."""
    if isinstance(wanted, FrameRange):
        return wanted.first is not None and wanted.last is not None and wanted.first > wanted.last
    start, stop = wanted.start or 0, wanted.stop
    return stop is not None and (stop == 0 or (start >= stop and (start < 0) == (stop < 0)))


def _make_error(wanted: object) -> SettingError:
    return SettingError(
        f"{show_value(wanted)} is not a choice of frames; expected their numbers, such as "
        "1020-1060, 1020-1060x2, 1020 or 1020-, or a slice 0:48:2, which counts from 0"
    )
