"""Names of files that differ in their numbers alone, and which of these numbers runs.

A name is texts and numbers in turn. Names with equal texts are a series if one number runs: the
only one that differs; the one that goes on in even steps beside others, such as times; a time
stamp; or a decimal fraction. If none does, they are several series, such as takes.
"""

import glob
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from fnmatch import fnmatchcase
from fractions import Fraction
from itertools import chain, pairwise
from math import gcd
from pathlib import Path

from cageik_cli.formats.base.files import file_stem

STAMP_FORMATS = {14: "%Y%m%d%H%M%S", 12: "%y%m%d%H%M%S", 8: "%Y%m%d", 6: "%H%M%S", 4: "%M%S"}
"""Time stamps by the number of their digits, without those of a part of a second. Four digits are
minutes and seconds only where something is between them."""

DAY_DIGITS, DATED_DIGITS = 8, 14
"""Digits of a day, and of a time that has one. A time stamp with a day is one also where frames are
not even."""

DECIMAL_POINTS = (".", ",")

OTHER_WORDS = (
    *("v", "ver", "version", "rev", "lod", "cam", "camera", "take", "shot", "sh", "sc", "scene"),
    *("seq", "part", "mesh", "mat", "id", "copy"),
)
"""What a number is of that is none of frames, by the letters before it."""

MIN_TAKE_FRAMES = 3
"""Frames of a take, as a mean, at least; a number that has fewer is of versions."""

MIN_EVEN_SHARE = 0.5
"""A number beside others runs if so many of its steps, at least, are the usual one."""

MIN_DISTINCT_SHARE = 0.5
"""Numbers beside one that runs differ in more than so many of the names; a take has more frames."""


@dataclass(frozen=True, slots=True, eq=False)
class NumberedFiles:
    """Files whose names have equal texts, in the order of the number that runs.

    Attributes
    ----------
    texts : tuple of str
        Before, between and after the numbers of each name.
    words : tuple of tuple of str
        The numbers of each name, as they are written.
    running : range
        Which of these are the number that runs: one, or several that are a time or a fraction.
    numbers : tuple of int
        The number of each file; none where fractions run. Time stamps count from 1 in the largest
        step that all of them need.
    stamps : (int, int, int), optional
        Of time stamps: their first time, the step, and the digits of parts of a second.
    joined : tuple of NumberedFiles
        Frames with a sign or a fraction that are of the series, too; `paths` has all.
    """

    paths: tuple[Path, ...]
    texts: tuple[str, ...]
    words: tuple[tuple[str, ...], ...]
    running: range
    numbers: tuple[int, ...] = ()
    stamps: tuple[int, int, int] | None = None
    joined: tuple["NumberedFiles", ...] = ()

    @property
    def has_even_fractions(self) -> bool:
        """Whether fractions run in even steps, to the rounding of their last digit."""
        values = _read_fractions(self, self.running)
        return _is_even(values, _find_rounding(self, self.running))

    def name_around(self, mark: str) -> str:
        """Return the stem of the names with a mark in place of each number that differs."""
        is_varying = self._find_varying()
        stem = self.texts[0]
        for k, text in enumerate(self.texts[1:]):
            if k in self.running:
                stem += mark if k == self.running[0] else ""
                stem += text if k == self.running[-1] else ""
            else:
                stem += ("*" if is_varying[k] else self.words[0][k]) + text
        return stem

    def has_name(self, path: Path) -> bool:
        """Return whether the name of a file, of any suffix, is that of a frame."""
        columns = zip(*self.words, strict=True)
        patterns = [each[0] if len(set(each)) == 1 else r"\d+" for each in columns]
        texts = map(re.escape, self.texts)
        name = "".join(text + word for text, word in zip(texts, [*patterns, ""], strict=True))
        return re.fullmatch(name, file_stem(path)) is not None

    def list_globs(self, beside: Sequence[Path]) -> list[str]:
        """Return patterns that match the names of these files, and no others of a folder."""
        names = {path.name for path in self.paths}
        others = {path.name for path in beside} - names
        for digits in (False, True):
            found = sorted(
                {pattern for one in (self, *self.joined) for pattern in one._make_globs(digits)}
            )
            if not any(fnmatchcase(name, pattern) for name in others for pattern in found):
                break
        return found

    def make_path(self, place: int, number: int) -> Path:
        """Return the path of a frame that follows that of the file `place`."""
        path, words = self.paths[place], list(self.words[place])
        widths = [len(words[k]) for k in self.running]
        if self.stamps is None:
            written = f"{number:0{widths[-1]}d}"
        else:
            first, step, digits = self.stamps
            written = _write_stamp(first + (number - 1) * step, sum(widths), digits)
        for k, width in zip(self.running[:-1], widths, strict=False):
            words[k], written = written[:width], written[width:]
        words[self.running[-1]] = written
        stem = "".join(text + word for text, word in zip(self.texts, [*words, ""], strict=True))
        return path.with_name(stem + path.name[len(file_stem(path)) :])

    def _make_globs(self, digits: bool) -> Iterator[str]:
        """Yield a pattern for the name of each file: with stars, or as many digits as it has."""
        texts = [glob.escape(text) for text in self.texts]
        is_varying = self._find_varying()
        for path, words in zip(self.paths, self.words, strict=False):  # then those that are joined
            pattern = texts[0]
            for word, varies, text in zip(words, is_varying, texts[1:], strict=True):
                varying = "[0-9]" * len(word) if digits else "*"
                pattern += (varying if varies else word) + text
            yield pattern + glob.escape(path.name[len(file_stem(path)) :])

    def _find_varying(self) -> list[bool]:
        """Return which numbers differ among the names."""
        return [len(set(column)) > 1 for column in zip(*self.words, strict=True)]


def group_series(paths: Sequence[Path]) -> list[NumberedFiles]:
    """Return the series of files of any suffixes in a folder, also of one file each.

    Frames with a sign or a fraction (`walk_-1`, `walk_1.5`) are of the series that has neither.
    What is beside frames and has their names and more text, such as copies of some, is no series.
    """
    groups: dict[tuple[object, ...], list[Path]] = {}
    for path in paths:
        stem = file_stem(path)
        texts = tuple(re.split(r"\d+", stem))
        if len(texts) > 1:
            groups.setdefault((texts, path.name[len(stem) :].lower()), []).append(path)
    found = [series for group in groups.values() for series in split_series(group)]
    names = {one.name_around("\0"): k for k, one in enumerate(found) if len(one.running) == 1}
    joined: dict[int, tuple[NumberedFiles, ...]] = {}
    kept = []
    for k, series in enumerate(found):
        wholes = (names[name] for name in _list_whole_names(series.paths[0]) if name in names)
        owner = next((n for n in wholes if n != k and _is_of(series, found[n])), k)
        if owner == k:
            kept.append(k)
        else:
            joined[owner] = (*joined.get(owner, ()), series)
    whole = [_join_series(found[k], joined.get(k, ())) for k in kept]
    frames = {
        file_stem(path): n
        for n, one in enumerate(whole)
        if len(one.paths) > 1
        for path in one.paths
    }
    return [one for n, one in enumerate(whole) if not _is_beside(one, n, frames)]


def _join_series(series: NumberedFiles, others: tuple[NumberedFiles, ...]) -> NumberedFiles:
    paths = chain(series.paths, *(other.paths for other in others))
    return replace(series, paths=tuple(paths), joined=others)


def _list_whole_names(path: Path) -> Iterator[str]:
    """Yield what `name_around` may return for a name without the sign or fraction of a number."""
    stem = file_stem(path)
    for number in re.finditer(r"\d+", stem):
        before, behind = stem[: number.start()], stem[number.end() :]
        befores = [before]
        if re.fullmatch(r"(.*[._ ])?-", before):
            befores.append(before[:-1])
        parted = re.match(r"[.,]\d+", behind)
        afters = [behind, behind[parted.end() :]] if parted else [behind]
        yield from (f"{first}\0{last}" for first in befores for last in afters)


def _is_of(series: NumberedFiles, other: NumberedFiles) -> bool:
    """Return whether names are those of another series, but for signs and fractions."""
    before, _, after = other.name_around("\0").partition("\0")
    sign = "-?" if re.fullmatch(r"(.*[._ ])?", before) else ""
    name = rf"({re.escape(before)}({sign})(\d+))((?:[.,]\d+)?){re.escape(after)}"
    matches = [re.fullmatch(name, file_stem(path)) for path in series.paths]
    found = [match for match in matches if match and (match[2] or match[4])]
    if len(found) < len(matches):
        return False
    # Fractions of one number alone, which is none of the frames, are those of a version, unless
    # they run on to the frames: 0.25, 0.5, 0.75 and 1.
    stems = {file_stem(path) for path in other.paths}
    whole = {match[1] for match in found}
    if all(match[2] for match in found) or len(found) == 1 or len(whole) > 1 or whole <= stems:
        return True
    values = [Fraction(match[3] + match[4].replace(",", ".")) for match in found]
    return _is_even(sorted([*values, *other.numbers]))


def _is_beside(series: NumberedFiles, number: int, frames: Mapping[str, int]) -> bool:
    """Return whether files have the names of some frames of another series, and more text.

    `number` is that of the series, and `frames` have those of all stems.
    """
    found: dict[int, set[str]] = {}
    for k, path in enumerate(series.paths):
        stem = file_stem(path)
        cuts = [at for at in range(1, len(stem)) if not (stem[at - 1] + stem[at]).isdigit()]
        parts = {part for at in cuts for part in (stem[:at], stem[at:]) if part in frames}
        own: dict[int, set[str]] = {}
        for part in parts:
            if frames[part] != number:
                own.setdefault(frames[part], set()).add(part)
        found = {n: found.get(n, set()) | own[n] for n in own if k == 0 or n in found}
        if not found:
            return False
    counts = Counter(frames.values())
    return any(len(stems) < counts[n] for n, stems in found.items())


def split_series(paths: Sequence[Path]) -> list[NumberedFiles]:
    """Split files, whose names have equal texts with numbers, into series by the one that runs."""
    parts = [re.split(r"(\d+)", file_stem(path)) for path in paths]
    words = tuple(tuple(part[1::2]) for part in parts)
    whole = NumberedFiles(tuple(paths), tuple(parts[0][::2]), words, range(0))
    columns = range(len(words[0]))
    varying = [k for k in columns if len({each[k] for each in words}) > 1]
    if len(varying) < 2:
        place = varying[0] if varying else columns[-1]
        number = _order_by_number(whole, range(place, place + 1))
        if not varying or _is_even(number.numbers):
            return [number]
        if place and _is_fraction(whole, range(place - 1, place + 1)):
            return [_order_by_fraction(whole, range(place - 1, place + 1))]
        stamped = _find_stamps(whole, varying)
        return [stamped or number]
    stamped = _find_stamps(whole, varying)
    if stamped is not None:
        return [stamped]
    units, fractions = _find_units(whole, varying)
    if len(units) == 1:
        return [_order_by_fraction(whole, units[0])]
    running = _find_running(whole, units, fractions)
    if running is not None:
        return [running]
    groups = _split_takes(whole, units, varying)
    return [series for group in groups for series in split_series(group)]


def _split_takes(
    whole: NumberedFiles, units: Sequence[range], varying: Sequence[int]
) -> list[list[Path]]:
    """Group files by all numbers but one, which is that of frames: the last as a rule.

    A number behind a word such as `take` or `v` is none of frames if there is another. Neither is
    one that has so few in each group that they are versions, where another has more.
    """
    words = [re.search(r"[A-Za-z]*$", whole.texts[unit[0]]) for unit in units]
    framing = [
        unit
        for unit, word in zip(units, words, strict=True)
        if word is None or word[0].lower() not in OTHER_WORDS
    ]
    tried = list(reversed(framing or units))
    split = [_group_by(whole, [k for k in varying if k not in unit]) for unit in tried]
    long_enough = len(whole.paths) / MIN_TAKE_FRAMES
    return next((groups for groups in split if len(groups) <= long_enough), split[0])


def _group_by(whole: NumberedFiles, columns: Sequence[int]) -> list[list[Path]]:
    """Group files by some of their numbers, in order."""
    groups: dict[tuple[str, ...], list[Path]] = {}
    for path, words in zip(whole.paths, whole.words, strict=True):
        groups.setdefault(tuple(words[k] for k in columns), []).append(path)
    return list(groups.values())


def _order(whole: NumberedFiles, values: Sequence[Fraction | int], running: range) -> NumberedFiles:
    """Return files in the order of the values that run."""
    order = sorted(range(len(values)), key=lambda k: values[k])
    paths = tuple(whole.paths[k] for k in order)
    words = tuple(whole.words[k] for k in order)
    return replace(whole, paths=paths, words=words, running=running)


def _order_by_number(whole: NumberedFiles, running: range) -> NumberedFiles:
    numbers = [int(words[running[0]]) for words in whole.words]
    return replace(_order(whole, numbers, running), numbers=tuple(sorted(numbers)))


def _order_by_fraction(whole: NumberedFiles, running: range) -> NumberedFiles:
    return _order(whole, _read_fractions(whole, running), running)


def _read_fractions(whole: NumberedFiles, columns: range) -> list[Fraction]:
    return [Fraction(".".join(words[k] for k in columns)) for words in whole.words]


def _is_even(values: Sequence[Fraction | int], tolerance: Fraction | int = 0) -> bool:
    """Return whether ascending values have steps that differ by a tolerance at most."""
    steps = [b - a for a, b in pairwise(values)]
    return max(steps, default=0) - min(steps, default=0) <= tolerance


def _find_rounding(whole: NumberedFiles, columns: range) -> Fraction:
    """Return by how much steps of fractions differ that are even, but rounded to their digits."""
    digits = max(len(words[columns[-1]]) for words in whole.words)
    return Fraction(1, 10**digits)


def _is_fraction(whole: NumberedFiles, columns: range) -> bool:
    """Return whether two numbers with a point between them are one: `0.05`, and not `v2.0005`."""
    if whole.texts[columns[1]] not in DECIMAL_POINTS:
        return False
    pairs = {(words[columns[0]], words[columns[1]]) for words in whole.words}
    ints, parts = {first for first, _ in pairs}, {last for _, last in pairs}
    values = sorted({Fraction(f"{first}.{last}") for first, last in pairs})
    widths = {len(last) for last in parts}
    is_even = len(values) > 2 and _is_even(values, _find_rounding(whole, columns))
    if len(ints) == 1:
        is_zero, numbers = int(*ints) == 0, sorted(map(int, parts))
        if len(widths) > 1:
            return is_even or (is_zero and any(last[0] == "0" for last in parts))
        # Steps of frames do not differ by rounding, as in 0.033, 0.067, 0.100.
        return is_zero and is_even and not _is_even(numbers) and numbers[1] - numbers[0] > 1
    return is_even or len(ints) > max(Counter(first for first, _ in pairs).values())


def _find_units(whole: NumberedFiles, varying: Sequence[int]) -> tuple[list[range], set[range]]:
    """Return the numbers that differ, with their fractions, and which of them are fractions."""
    units: list[range] = []
    fractions: set[range] = set()
    for k in varying:
        if units and k in units[-1]:
            continue
        after, before = range(k, k + 2), range(k - 1, k + 1)
        unit = range(k, k + 1)
        if k + 1 in varying and _is_fraction(whole, after):
            unit = after
        elif k and k - 1 not in varying and _is_fraction(whole, before):
            unit = before
        if len(unit) > 1:
            fractions.add(unit)
        units.append(unit)
    return units, fractions


def _find_running(
    whole: NumberedFiles, units: Sequence[range], fractions: set[range]
) -> NumberedFiles | None:
    """Return files in the order of a whole number that runs beside numbers that depend on it."""
    found: list[tuple[float, int, NumberedFiles]] = []
    for unit in units:
        series = _order_by_number(whole, unit) if unit not in fractions else whole
        steps = Counter(b - a for a, b in pairwise(series.numbers))
        if not steps or 0 in steps:
            continue
        others = [each for each in units if each is not unit]
        beside = [tuple(words[k] for each in others for k in each) for words in series.words]
        ascends = all(a <= b for each in others for a, b in pairwise(_read_fractions(series, each)))
        usual = min(steps, key=lambda step: (-steps[step], step))
        share = steps[usual] / steps.total()
        is_dependent = fractions.issuperset(others) or (
            len(set(beside)) > MIN_DISTINCT_SHARE * len(beside)
        )
        if is_dependent and (
            (share == 1 and steps.total() > 1) or (share >= MIN_EVEN_SHARE and ascends)
        ):
            found.append((share, -usual, series))
    # The first of those that run as evenly, and in as small steps: times are behind numbers.
    return max(found, key=lambda item: item[:2])[2] if found else None


def _find_stamps(whole: NumberedFiles, varying: Sequence[int]) -> NumberedFiles | None:
    """Return files in the order of their time stamps, if the numbers that differ are of such."""
    last = varying[-1]
    for first in range(varying[0] + 1):
        running = range(first, last + 1)
        widths = {tuple(len(words[k]) for k in running) for words in whole.words}
        if len(widths) > 1:
            continue
        (own,) = widths
        written = ["".join(words[k] for k in running) for words in whole.words]
        for parts in _list_stamp_parts(own, whole.texts[last]):
            times = [time for each in written if (time := _read_stamp(each, parts)) is not None]
            ordered = sorted(times)
            digits = sum(own) - parts
            is_dated = len(varying) > 1 and (digits == DATED_DIGITS or own == (4, 2, 2))
            is_even = len(times) > 2 and _is_even(ordered)
            if len(times) < len(written) or not (is_dated or is_even):
                continue
            step = gcd(*(b - a for a, b in pairwise(ordered))) or 1
            numbers = tuple(1 + (time - ordered[0]) // step for time in ordered)
            series = _order(whole, times, running)
            return replace(series, numbers=numbers, stamps=(ordered[0], step, parts))
    return None


def _list_stamp_parts(own: tuple[int, ...], point: str) -> list[int]:
    """List how many of the last digits may be a part of a second, of a stamp in numbers `own`.

    They are a number of their own, of three or six digits or behind a point; but `0001.25` is a
    frame. A day has none, and is no other digits than a year, a month and a day.
    """
    digits, before = sum(own), sum(own[:-1])
    found = []
    if digits in STAMP_FORMATS and own != (min(STAMP_FORMATS),):
        found += [0] if digits != DAY_DIGITS or own[0] >= 4 else []
    if before in STAMP_FORMATS and before != DAY_DIGITS:
        is_clock = len(own) > 2 or before > DAY_DIGITS
        is_behind_point = point in DECIMAL_POINTS and is_clock
        found += [own[-1]] if own[-1] in (3, 6) or is_behind_point else []
    return found


_FIRST_TIME = datetime(1900, 1, 1)


def _read_stamp(digits: str, parts: int) -> int | None:
    """Return a time since 1900, in units of the last of `parts` digits of a second; else None."""
    whole = digits[: len(digits) - parts]
    try:
        time = datetime.strptime(whole, STAMP_FORMATS[len(whole)])
    except ValueError:
        return None
    seconds = (time - _FIRST_TIME) // timedelta(seconds=1)
    if seconds < 0:
        return None
    return int(f"{seconds}{digits[len(whole) :]}")


def _write_stamp(time: int, width: int, parts: int) -> str:
    """Return the digits of a time stamp; the inverse of `_read_stamp`."""
    seconds, rest = divmod(time, 10**parts)
    written = (_FIRST_TIME + timedelta(seconds=seconds)).strftime(STAMP_FORMATS[width - parts])
    return written + (f"{rest:0{parts}d}" if parts else "")
