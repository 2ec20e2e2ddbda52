"""Names of files: their suffix, and the number of a frame in them."""

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.formats.base.file_data import GZIP_SUFFIX
from cageik_cli.util.errors import SettingError


def file_suffix(path: Path) -> str:
    """Return the suffix in lower case, with the one before `.gz`: `.obj`, `.obj.gz`."""
    suffix = path.suffix.lower()
    return Path(path.stem).suffix.lower() + suffix if suffix == GZIP_SUFFIX else suffix


def file_stem(path: Path) -> str:
    """Return the name without its suffix."""
    return path.name[: len(path.name) - len(file_suffix(path))]


_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")


def group_numbered_files(paths: list[Path]) -> dict[str, list[Path]]:
    """Group files of one suffix by the text around the last number in their names."""
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


_FRAME_NUMBER = re.compile(r"(?P<hashes>#+)|%0?(?P<printf>\d?)d|\$F(?P<houdini>\d?)")


@dataclass(frozen=True, slots=True)
class FrameNames:
    """Names of files with a frame number.

    Attributes
    ----------
    digits : int
        At least so many; shorter numbers get leading zeros.
    """

    before: str
    digits: int
    after: str

    @classmethod
    def parse(cls, pattern: str) -> "FrameNames | None":
        """Parse a pattern: `#` per digit, `%04d` as in C, `$F4` as in Houdini; None if it has none.

        Raises
        ------
        InputError
            When it has several numbers.
        """
        found = list(_FRAME_NUMBER.finditer(pattern))
        if len(found) > 1:
            raise SettingError(
                f"{pattern} has {len(found)} places for the frame number, expected one; remove one"
            )
        if not found:
            return None
        number = found[0]
        typed = number["printf"] or number["houdini"] or "1"
        digits = len(number["hashes"]) if number["hashes"] else int(typed)
        return cls(pattern[: number.start()], digits, pattern[number.end() :])

    @property
    def pattern(self) -> str:
        """The pattern of these names, for `parse`."""
        return f"{self.before}{'#' * self.digits}{self.after}"

    def file_name(self, number: int) -> str:
        """Return the name of the file of a frame."""
        return f"{self.before}{number:0{self.digits}d}{self.after}"

    def matches(self, name: str) -> bool:
        """Return whether a file of this name is one of them."""
        around = re.escape(self.before), re.escape(self.after)
        return re.fullmatch(rf"{around[0]}\d{{{self.digits},}}{around[1]}", name) is not None
