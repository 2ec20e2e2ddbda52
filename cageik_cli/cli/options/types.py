"""Types of values: sizes, ranges of frames, percentages, limits, and words beside numbers."""

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import click

from cageik_cli.cli.group import spell_error
from cageik_cli.formats.settings import AUTO, JOINT_MOTIONS, RestFrame, SceneHints
from cageik_cli.formats.timeline import FrameRange, parse_frame_number, parse_frames
from cageik_cli.method.pose.settings import DEFAULT_SNAP
from cageik_cli.util.errors import SettingError


class OrWord(click.ParamType):  # type: ignore[type-arg]  # not subscriptable before click 8.4
    """What another type knows, such as a number or a path; or one word, which is left as it is.

    Parameters
    ----------
    expected : str, optional
        What the message on other text expects; else the message is that of the other type.
    """

    def __init__(self, kind: click.ParamType, word: str, expected: str = "") -> None:  # type: ignore[type-arg]
        self.kind, self.word, self.expected = kind, word, expected
        self.name = kind.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Parse the text."""
        if value == self.word:
            return value
        try:
            return self.kind.convert(str(value), param, ctx)
        except click.BadParameter:
            if not self.expected:
                raise
        return self.fail(f"{value!r} is not {self.expected}, or {self.word}", param, ctx)


JOINTS_TYPE = OrWord(
    OrWord(click.IntRange(min=1), JOINT_MOTIONS[0]),
    JOINT_MOTIONS[1],
    f"a number of joints above 0, {JOINT_MOTIONS[0]}",
)
"""How joints move, or how many that turn there are."""


class SuffixedPath(click.Path):
    """A file whose name ends in one of some suffixes; or, if that is allowed, `-` for stdout."""

    def __init__(self, *suffixes: str, allow_dash: bool = False) -> None:
        super().__init__(path_type=Path, allow_dash=allow_dash)
        self._suffixes = suffixes

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Check the suffix."""
        path = Path(value)
        is_stdout = self.allow_dash and str(value) == "-"
        if not is_stdout and path.suffix.lower() not in self._suffixes:
            expected = " or ".join(self._suffixes)
            self.fail(f"{value}: expected a name that ends in {expected}", param, ctx)
        return super().convert(value, param, ctx)


class SceneType(click.ParamType):  # type: ignore[type-arg]  # as above
    """A unit of length, and perhaps an up axis: cm, or m,z."""

    name = "unit[,axis]"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> SceneHints:
        """Parse the text."""
        if isinstance(value, SceneHints):
            return value
        try:
            return SceneHints.parse(str(value)) if value else SceneHints()
        except SettingError as error:
            return self.fail(spell_error(error, ctx), param, ctx)


class SizeType(click.ParamType):  # type: ignore[type-arg]  # as above
    """A number of bytes with its unit, such as 512MiB or 2GiB."""

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Parse the text."""
        match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(i?B)?", str(value), re.IGNORECASE)
        if not match or float(match[1]) == 0:
            self.fail(f"{value!r} is not a size such as 512MiB or 1GiB", param, ctx)
        number, prefix, byte = match.groups()
        if not prefix and not byte:
            self.fail(f"{value!r} has no unit; give {number}GiB or {number}MiB", param, ctx)
        return int(float(number) * 1024 ** " KMGT".index(prefix.upper() or " "))


class PictureSize(click.ParamType):  # type: ignore[type-arg]  # as above
    """Width and height in pixels, such as 640x480."""

    name = "wxh"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Parse the text."""
        match = re.fullmatch(r"(\d{1,6})[xX×](\d{1,6})", str(value), re.ASCII)
        if not match:
            self.fail(f"{value!r} is not a width and a height such as 640x480", param, ctx)
        return int(match[1]), int(match[2])


class FrameRangeType(click.ParamType):  # type: ignore[type-arg]  # as above
    """Frames by number, such as 1020-1060 or 1020-1060x2; or by index, as a slice A:B:STEP."""

    name = "a-b"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> slice | FrameRange:
        """Parse the text."""
        if isinstance(value, slice | FrameRange):
            return value
        try:
            return parse_frames(str(value))
        except SettingError as error:
            return self.fail(spell_error(error, ctx), param, ctx)


class FrameNumberType(click.ParamType):  # type: ignore[type-arg]  # as above
    """The number of a frame, which stays text, as an index would be a number; 0 for no text."""

    name = "number"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> RestFrame:
        """Check the text."""
        if value in ("", AUTO):
            return value or 0
        try:
            parse_frame_number(str(value))
        except SettingError as error:
            self.fail(spell_error(error, ctx), param, ctx)
        return str(value)


class FrameFormatType(click.ParamType):  # type: ignore[type-arg]  # as above
    """A format of folders of frames: the formats are looked up when one is given."""

    name = "format"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check the name."""
        from cageik_cli.formats.write import frame_formats

        known = frame_formats()
        if value not in known:
            self.fail(f"{value!r} is not one of {', '.join(map(repr, known))}.", param, ctx)
        return str(value)


@dataclass(frozen=True, slots=True)
class LimitValue:
    """A limit of a figure, in percent or in file units."""

    value: Decimal
    is_percent: bool


class LimitType(click.ParamType):  # type: ignore[type-arg]  # as above
    """A limit, zero or above: a length in percent of the diagonal or file units, or percents.

    Parameters
    ----------
    is_length : bool
        Whether one of the units has to be typed; else the number is in percent, with or without
        the sign.
    """

    def __init__(self, is_length: bool) -> None:
        self.name = "length" if is_length else "number[%]"
        self._is_length = is_length
        self._expected = "0.4% or, in file units, 0.01units" if is_length else "2%"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> LimitValue:
        """Parse the text."""
        if isinstance(value, LimitValue):
            return value
        number, unit = _split_number(value)
        if not number or (unit == "units" and not self._is_length):
            self.fail(
                f"{value!r} is not a limit; expected a finite number, zero or above, such as "
                f"{self._expected}",
                param,
                ctx,
            )
        if not unit and self._is_length:
            self.fail(
                f"{value!r} has no unit; give {number}% (of the diagonal) or {number}units (of "
                "the file)",
                param,
                ctx,
            )
        return LimitValue(Decimal(number), unit != "units")


class PercentType(click.ParamType):  # type: ignore[type-arg]  # as above
    """A number of percent, zero or above, with or without the sign.

    Parameters
    ----------
    noun, example : str
        What the message on other text expects.
    unit : float
        What the value is divided by: 100 for shares of the whole.
    """

    name = "percent"

    def __init__(self, noun: str, example: str, unit: float = 1) -> None:
        self._noun, self._example, self._unit = noun, example, unit

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Parse the text."""
        number, unit = _split_number(value)
        if not number or unit == "units":
            self.fail(
                f"{value!r} is not {self._noun}; expected a finite number, zero or above, such "
                f"as {self._example}",
                param,
                ctx,
            )
        return float(number) / self._unit


KINDS: dict[str, Any] = {
    "snap": PercentType(
        "a percentage", f"10%; without a number, put --snap last or write --snap={DEFAULT_SNAP}"
    ),
    "tolerance": PercentType("a tolerance", "0.01%, of the diagonal"),
    "frames": FrameRangeType(),
    "frame number": FrameNumberType(),
    "frame format": FrameFormatType(),
    "joints": JOINTS_TYPE,
    "length limit": LimitType(is_length=True),
    "limit": LimitType(is_length=False),
    "unit and axis": SceneType(),
    "size": SizeType(),
    "picture size": PictureSize(),
}
"""The types of values that are not typed as their type says, by the kind of the setting."""


def _split_number(value: Any) -> tuple[str, str]:
    """Return a finite number, zero or above, and the sign of its unit; both empty for other text.

    The unit is "%", "units" or, if there is none, empty.
    """
    number = r"\+?((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d{1,3})?)"
    match = re.fullmatch(rf"{number}\s*(%|units|)", str(value).strip().lower(), re.ASCII)
    if not match or not math.isfinite(float(match[1])):
        return "", ""
    return match[1], match[2]
