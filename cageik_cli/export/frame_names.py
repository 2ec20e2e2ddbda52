"""Names of numbered files: `cage_####.obj`, `cage_%04d.obj`, `cage_$F4.obj`."""

import re
from dataclasses import dataclass

from cageik_cli.util.errors import InputError

_NUMBER = re.compile(r"(?P<hashes>#+)|%0?(?P<printf>\d?)d|\$F(?P<houdini>\d?)")


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
    def of(cls, pattern: str) -> "FrameNames | None":
        """What a pattern means: `#` a digit, `%04d` as in C, `$F4` as in Houdini; None if plain.

        Raises
        ------
        InputError
            When the number stands in it twice.
        """
        found = list(_NUMBER.finditer(pattern))
        if len(found) > 1:
            raise InputError(
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

    def name(self, number: int) -> str:
        """The file of the frame of that number."""
        return f"{self.before}{number:0{self.digits}d}{self.after}"

    def has(self, name: str) -> bool:
        """Whether a file of this name is one of them."""
        around = re.escape(self.before), re.escape(self.after)
        return re.fullmatch(rf"{around[0]}\d{{{self.digits},}}{around[1]}", name) is not None
