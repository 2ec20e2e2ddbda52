"""Frame numbers in the names of files, and the gaps between them."""

import re
from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import pairwise
from math import gcd
from pathlib import Path
from typing import NoReturn

from cageik_cli.formats.base.files import file_stem
from cageik_cli.formats.base.numbered_names import NumberedFiles, split_series
from cageik_cli.formats.settings import Gaps, SceneHints
from cageik_cli.util.errors import FileAccessError, SettingError, join_truncated
from cageik_cli.util.messages import Said, say
from cageik_cli.util.text import format_count

MAX_FRAME_NUMBER = 1 << 24
"""Larger numbers are dates or the like; single precision, as of PC2, holds all up to this."""

MAX_MISSING_FRAMES = 10_000
"""Numbers that may be missing in a series whose gaps are kept."""


_SIGNED = r"(?:.*[._ ])?-\d+\D*"
"""A name that ends with a number that has a sign, or a dash that is none."""


class FileSeries:
    """The files of a clip, one per frame, and where they are on the timeline.

    Files that are not numbered in one way, or are in several folders, have no frame numbers.

    Parameters
    ----------
    paths : tuple of Path
        In natural order.
    gaps : {"refuse", "keep", "close"}
        What is done with missing numbers: refused; kept as frames without files; or closed, so
        that files follow one another in the usual step.

    Attributes
    ----------
    paths : tuple of Path
        In order; a missing file has the name that it would have.
    scene : SceneHints
        The number of the first frame and the step, if the files are numbered in one way.
    missing : dict
        By number of the frame, from 0, why it has no file.
    notes : tuple of str or Text
        What differs from the numbers of the files, one sentence each.

    Raises
    ------
    InputError
        When a number is missing and gaps are refused, or two files have the same number; when
        numbers are negative or those of subframes, unless gaps are closed.
    """

    def __init__(self, paths: tuple[Path, ...], gaps: Gaps) -> None:
        self.paths, self.scene = paths, SceneHints()
        self.missing: dict[int, str] = {}
        self.notes: tuple[Said, ...] = ()
        is_separated, series = _has_separating_dash(paths), find_only_series(paths)
        if series is None or series.stamps is None:
            if gaps != "close":
                _check_whole_numbers(paths, is_separated)
            elif not is_separated and (ordered := _order_signed(paths)):
                self.paths = ordered
                return
        if series is None:
            return
        self._series, self._numbers = series, series.numbers
        self.paths = paths = series.paths
        if is_separated:
            self.notes = (f"the dash in {paths[0].name} is read as a separator, not as a sign",)
        if not series.numbers:
            self._take_fractions(gaps)
            return
        steps = [b - a for a, b in pairwise(self._numbers)]
        if gaps != "close" and 0 in steps:
            second = steps.index(0) + 1
            raise FileAccessError(
                f"{paths[second]}: has the frame number of {paths[second - 1].name}, "
                f"{self._numbers[second]}; remove one of them"
            )
        # The most frequent step above zero; of equally frequent ones, the smallest.
        counts = Counter(step for step in steps if step > 0)
        usual = min(counts, key=lambda step: (-counts[step], step), default=1)
        odd = [k for k, step in enumerate(steps) if step != usual]
        if odd and series.stamps is not None and gaps != "close":
            lost = sum(steps) // gcd(*steps) - len(steps)
            if gaps == "refuse" or lost > MAX_MISSING_FRAMES:
                self.notes += (
                    f"the time stamps are not evenly spaced ({format_count(len(odd), 'place')}, "
                    f"the first at {paths[odd[0] + 1].name}): each is used as one frame; "
                    + say("`allow_gaps=True` keeps them in time"),
                )
                return
        if odd and gaps == "refuse":
            self._refuse(odd, steps, usual)
        if odd and gaps == "keep":
            self._keep_gaps(gcd(*steps))
        elif self._numbers[-1] <= MAX_FRAME_NUMBER:
            self.scene = SceneHints(start=float(self._numbers[0]), frame_step=float(usual))
            if odd:
                names = join_truncated(paths[k + 1].name for k in odd)
                self.notes += (
                    f"gaps in frame numbers are closed at {names}; frames are numbered from "
                    f"{self._numbers[0]} in steps of {usual}, other than their files",
                )

    def trim(self, chosen: range) -> range:
        """Return the chosen frames without missing ones at either end."""
        held = [k for k, frame in enumerate(chosen) if frame not in self.missing]
        if not held:
            raise FileAccessError(
                f"{self.paths[chosen[0]]}: {self.missing[chosen[0]]}, as all frames that are "
                "chosen; " + say("choose others with `selection=`")
            )
        return chosen[held[0] : held[-1] + 1]

    def _take_fractions(self, gaps: Gaps) -> None:
        """Refuse fractions in names, which are no numbers of frames, unless gaps are closed.

        If gaps are kept, fractions in even steps are taken, too: they have none.
        """
        first, last = self.paths[0], self.paths[-1]
        if gaps == "refuse" or (gaps == "keep" and not self._series.has_even_fractions):
            raise SettingError(
                f"{first}: the names hold fractions, up to that of {last.name}, and frames have "
                "whole numbers; "
                + say(
                    "number the frames one after another, in the order of the fractions, with "
                    "`close_gaps=True`, or export USD or Alembic, which hold times"
                )
            )
        self.notes = (
            f"the names hold fractions, {first.name} to {last.name}: frames are in their order, "
            "numbered from 1",
        )

    def _refuse(self, odd: list[int], steps: list[int], usual: int) -> NoReturn:
        """Refuse gaps, or numbers between those of the usual step."""
        paths, wide = self.paths, [k for k in odd if steps[k] > usual]
        first = (wide or odd)[0]
        expected = f"where frames are numbered in steps of {usual}"
        if wide:
            lost = self._series.make_path(first, self._numbers[first] + usual)
            fault = f"{lost}: missing between {paths[first].name} and {paths[first + 1].name}, "
            fault += f"{expected} ({format_count(len(wide), 'such gap')}); restore it"
        else:
            fault = f"{paths[first + 1]}: {steps[first]} after {paths[first].name}, {expected}"
            fault += f" ({format_count(len(odd), 'such place')}); remove it"
        raise FileAccessError(
            f"{fault}, "
            + say(
                "keep gaps in time with `allow_gaps=True`, or number the frames one after "
                "another with `close_gaps=True`"
            )
        )

    def _keep_gaps(self, step: int) -> None:
        """Make even steps, in which some frames have no file."""
        paths, first, last = self.paths, self._numbers[0], self._numbers[-1]
        lost = (last - first) // step + 1 - len(paths)
        if lost > MAX_MISSING_FRAMES or last > MAX_FRAME_NUMBER:
            raise FileAccessError(
                f"{paths[0]}: {lost} frames are missing in steps of {step} up to "
                f"{paths[-1].name}, expected at most {MAX_MISSING_FRAMES} and numbers up to "
                f"{MAX_FRAME_NUMBER}; "
                + say("number the frames one after another with `close_gaps=True`")
            )
        series = [paths[0]]
        for k, (a, b) in enumerate(pairwise(self._numbers)):
            why = f"missing between {paths[k].name} and {paths[k + 1].name}"
            for number in range(a + step, b, step):
                self.missing[len(series)] = why
                series.append(self._series.make_path(k, number))
            series.append(paths[k + 1])
        self.paths = tuple(series)
        self.scene = SceneHints(start=float(first), frame_step=float(step))


def find_only_series(paths: tuple[Path, ...]) -> NumberedFiles | None:
    """Return files as a series, if they are in one folder and one number runs in their names."""
    texts = {_list_texts(path) for path in paths}
    if len(texts) > 1 or len(*texts) < 2 or len({path.parent for path in paths}) > 1:
        return None
    found = split_series(paths)
    return found[0] if len(found) == 1 else None


def _list_texts(path: Path) -> tuple[str, ...]:
    return tuple(re.split(r"\d+", file_stem(path)))


def _has_separating_dash(paths: tuple[Path, ...]) -> bool:
    """Return whether a dash that looks like a sign is none, as all names have it behind a word.

    After a point it is a sign, for there the number of the frame begins.
    """
    matches = [re.fullmatch(r".*[^\W\d_][\d_ ]*-\d+\D*", file_stem(path)) for path in paths]
    signs = [re.fullmatch(_SIGNED, file_stem(path)) for path in paths]
    return len(paths) > 1 and all(matches) and all(signs)


def _order_signed(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return paths in the order of the numbers that end their names, if some are signed.

    So if some have a fraction and others none. Nothing if the text before differs, or the folder.
    """
    if len({_list_texts(path) for path in paths}) == 1 and not any(
        re.fullmatch(_SIGNED, file_stem(path)) for path in paths
    ):
        return ()
    values: dict[Path, Fraction] = {}
    places = set()
    for path in paths:
        match = re.fullmatch(r"(.*?[._ ]|\D*?)(-?\d+(?:[.,]\d+)?)", file_stem(path))
        if match is None:
            return ()
        values[path] = Fraction(match[2].replace(",", "."))
        places.add((path.parent, match[1]))
    is_whole = all(value.denominator == 1 and value >= 0 for value in values.values())
    return () if is_whole or len(places) > 1 else tuple(sorted(paths, key=values.__getitem__))


def _check_whole_numbers(paths: tuple[Path, ...], is_separated: bool) -> None:
    """Refuse negative numbers and subframes, whose order in time is not that of their names."""
    stems = [file_stem(path) for path in paths]
    for path, stem in zip(paths, stems, strict=True):
        if re.fullmatch(_SIGNED, stem) and not is_separated:
            raise SettingError(
                f"{path}: has a negative frame number, expected 0 or more; "
                + say(
                    "number the files from 0 on, or take them in the order of their numbers "
                    "with `close_gaps=True`"
                )
            )
    number_and_part = r"((?:.*?[._ -])?)(\d+)(?:[.,](\d+))?"
    matches = {stem: match for stem in stems if (match := re.fullmatch(number_and_part, stem))}
    whole = {(match[1], int(match[2])) for match in matches.values() if match[3] is None}
    parted = {stem: match for stem, match in matches.items() if match[3] is not None}
    frames = Counter((match[1], int(match[2])) for match in parted.values())
    is_shuffled = _order_signed(paths) not in ((), paths)
    for path, stem in zip(paths, stems, strict=True):
        match = parted.get(stem)
        frame = (match[1], int(match[2])) if match else ("", -1)
        if match and (frame in whole or 1 < frames[frame] < len(parted) or is_shuffled):
            raise SettingError(
                f"{path}: is a subframe of {match[1]}{match[2]}, or of another series, as its "
                "name holds a fraction; "
                + say(
                    "frames have whole numbers, so leave out such files, export USD or "
                    "Alembic, or take them in the order of their numbers with "
                    "`close_gaps=True`"
                )
            )


@dataclass(frozen=True, slots=True)
class FrameNames:
    """Names of files with a frame number.

    Attributes
    ----------
    digits : int
        At least so many; shorter numbers get leading zeros.
    typed : str
        The place as it was typed.
    """

    before: str
    digits: int
    after: str
    typed: str = field(default="", compare=False)

    @classmethod
    def parse(cls, pattern: str) -> "FrameNames | None":
        """Parse a pattern: `#` per digit, `%04d` as in C, `$F4` as in Houdini; None without one.

        A lone `#` is the place of a digit in front of the suffix; elsewhere it is a character.
        """
        places = r"(?P<hashes>##+|(?<!#)#(?=\.[^.#]+$))|%0?(?P<printf>\d?)d|\$F(?P<houdini>\d?)"
        found = list(re.finditer(places, pattern))
        if len(found) > 1:
            raise SettingError(
                f"{pattern} has {len(found)} places for the frame number, expected one; remove one"
            )
        if not found:
            return None
        number = found[0]
        typed = number["printf"] or number["houdini"] or "1"
        digits = len(number["hashes"]) if number["hashes"] else int(typed)
        return cls(pattern[: number.start()], digits, pattern[number.end() :], number[0])

    @property
    def pattern(self) -> str:
        """The pattern of these names, for `parse`."""
        place = "#" * self.digits if self.digits > 1 else "%d"
        return f"{self.before}{place}{self.after}"

    @property
    def is_of_lone_hash(self) -> bool:
        """Whether the place may be a lone `#`, which names of files without numbers have, too."""
        return self.digits == 1 and self.typed == "#"

    def file_name(self, number: int) -> str:
        """Return the name of the file of a frame."""
        return f"{self.before}{number:0{self.digits}d}{self.after}"

    def matches(self, name: str) -> bool:
        """Return whether a file of this name is one of them."""
        around = re.escape(self.before), re.escape(self.after)
        return re.fullmatch(rf"{around[0]}\d{{{self.digits},}}{around[1]}", name) is not None
