"""Names of files: their suffix, and the number of a frame in them."""

import re
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from cageik_cli.formats.base.file_data import GZIP_SUFFIX
from cageik_cli.util.errors import FileAccessError, SettingError


def file_suffix(path: Path) -> str:
    """The suffix in lower case, of packed files with the one before it: `.obj`, `.obj.gz`."""
    suffix = path.suffix.lower()
    return Path(path.stem).suffix.lower() + suffix if suffix == GZIP_SUFFIX else suffix


def file_stem(path: Path) -> str:
    """The name without its kind."""
    return path.name[: len(path.name) - len(file_suffix(path))]


_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")


def group_numbered_files(paths: list[Path]) -> dict[str, list[Path]]:
    """Numbered files of one kind, by what is around the last number in their names; in order."""
    found: dict[tuple[str, str], list[Path]] = {}
    for path in paths:
        match = _NUMBERED.fullmatch(file_stem(path))
        if match:
            kind = path.name[len(file_stem(path)) :].lower()
            found.setdefault((f"{match[1]}#{match[3]}", kind), []).append(path)
    stems = Counter(stem for stem, _ in found)
    return {
        stem + (kind if stems[stem] > 1 else ""): files for (stem, kind), files in found.items()
    }


def check_no_gaps(paths: list[Path]) -> None:
    """Refuse files, in order, among whose numbers one is missing.

    Files that are not numbered alike, or lie in several folders, are taken as they are.

    Raises
    ------
    InputError
        Naming the first file that is missing.
    """
    found = [_NUMBERED.fullmatch(file_stem(path)) for path in paths]
    matches = [match for match in found if match]
    around = {(path.parent, m[1], m[3]) for path, m in zip(paths, matches, strict=False)}
    if len(matches) < len(paths) or len(around) != 1:
        return
    numbers = [int(match[2]) for match in matches]
    steps = Counter(b - a for a, b in pairwise(numbers))
    usual = min(steps, key=lambda step: (-steps[step], step), default=0)
    gaps = [k for k, (a, b) in enumerate(pairwise(numbers)) if b - a > usual > 0]
    if gaps:
        first = matches[gaps[0]]
        number = str(int(first[2]) + usual).zfill(len(first[2]))
        lost = f"{first[1]}{number}{first[3]}{paths[0].name[len(file_stem(paths[0])) :]}"
        raise FileAccessError(
            f"{paths[gaps[0]].parent / lost}: missing between {paths[gaps[0]].name} and "
            f"{paths[gaps[0] + 1].name}, where frames are numbered in steps of {usual} "
            f"({len(gaps)} such gaps); restore it, or take the clip as it is with --allow-gaps"
        )


_FRAME_NUMBER = re.compile(r"(?P<hashes>#+)|%0?(?P<printf>\d?)d|\$F(?P<houdini>\d?)")


@dataclass(frozen=True, slots=True)
class FrameNames:
    """What stands around a frame's number in the name of its file.

    Attributes
    ----------
    before, after : str
    digits : int
        The fewest; zeros are put in front of smaller numbers.
    """

    before: str
    digits: int
    after: str

    @classmethod
    def parse(cls, pattern: str) -> "FrameNames | None":
        """What a pattern means: `#` a digit, `%04d` as in C, `$F4` as in Houdini; None if plain.

        Raises
        ------
        InputError
            When the number stands in it twice.
        """
        found = list(_FRAME_NUMBER.finditer(pattern))
        if len(found) > 1:
            raise SettingError(
                f"the frame's number stands in {pattern} {len(found)} times, expected once"
            )
        if not found:
            return None
        number = found[0]
        typed = number["printf"] or number["houdini"] or "1"
        digits = len(number["hashes"]) if number["hashes"] else int(typed)
        return cls(pattern[: number.start()], digits, pattern[number.end() :])

    @property
    def pattern(self) -> str:
        """These names as `of` reads them."""
        return f"{self.before}{'#' * self.digits}{self.after}"

    def file_name(self, number: int) -> str:
        """The file of the frame of that number."""
        return f"{self.before}{number:0{self.digits}d}{self.after}"

    def matches(self, name: str) -> bool:
        """Whether a file of this name is one of them."""
        around = re.escape(self.before), re.escape(self.after)
        return re.fullmatch(rf"{around[0]}\d{{{self.digits},}}{around[1]}", name) is not None
