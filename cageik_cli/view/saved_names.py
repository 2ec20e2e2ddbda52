"""Names of new files that a page sends: in one folder, of one format, and nothing that exists."""

import os
import re
from collections.abc import Callable, Collection
from itertools import count
from pathlib import Path
from typing import Any

from cageik_cli.util.errors import FormatError, OutputError
from cageik_cli.util.json_files import format_value
from cageik_cli.util.text import to_unicode

MAX_NAME_BYTES = 120
"""Of a name: with what is added to unfinished files it stays below the 255 of all file systems."""

_DEVICE = re.compile(r"(?:con|prn|aux|nul|com\d|lpt\d)(?:\..*)?", re.IGNORECASE)
"""Names that are no files on Windows."""


class NewFiles:
    """The new files that a page may name.

    Parameters
    ----------
    viewed : Path
        What is viewed: new files are beside it.
    suffixes : collection of str
        In one of which a name ends, in lower case; the first is proposed.
    list_others : callable
        What else is written for a file; it must not exist either.
    """

    def __init__(
        self,
        viewed: Path,
        suffixes: Collection[str],
        list_others: Callable[[Path], Collection[Path]] = lambda _: (),
    ) -> None:
        self._folder, self._stem = viewed.parent, to_unicode(viewed.stem)
        self._suffixes, self._list_others = tuple(suffixes), list_others

    def propose(self, stem: str = "") -> str:
        """Return a name that is free, such as `walker-2.h5`."""
        stem = re.sub(r"[^\w.-]+", "-", re.sub(r"-\d+$", "", stem or self._stem)).strip(".-")
        stem = (stem or "new")[: MAX_NAME_BYTES // 8]  # a letter has up to four bytes
        names = (f"{stem}-{number}{self._suffixes[0]}" for number in count(2))
        return next(name for name in names if not self._is_taken(self._folder / name))

    def check(self, name: Any) -> Path:
        """Return the file of a name that was sent.

        Raises
        ------
        FormatError
            When it is no plain name of a file of this format.
        OutputError
            When there is such a file already.
        """
        if not isinstance(name, str) or not name:
            raise FormatError(f"name: is {format_value(name)}, expected the name of a new file")
        shown = f"name: is {format_value(name)}"
        is_plain = (
            name == name.strip()
            and name.isprintable()
            and not name.startswith((".", "-", "~"))
            and not re.search(r'[/\\:*?"<>|]', name)
            and not _DEVICE.fullmatch(name)
            and Path(name).name == name
        )
        if not is_plain:
            raise FormatError(
                f"{shown}, expected a plain name, without a folder; the file is written beside "
                "what is viewed"
            )
        if len(name.encode()) > MAX_NAME_BYTES:
            raise FormatError(f"{shown}, expected at most {MAX_NAME_BYTES} bytes; shorten it")
        suffix = Path(name).suffix.lower()
        if suffix not in self._suffixes:
            raise FormatError(f"{shown}, expected one that ends in {' or '.join(self._suffixes)}")
        path = self._folder / name
        if self._is_taken(path):
            raise OutputError(
                f"{path}: exists already; choose another name, such as {self.propose(path.stem)}"
            )
        return path

    def _is_taken(self, path: Path) -> bool:
        """Whether there is anything of this name, be it a link to nothing."""
        return any(map(os.path.lexists, (path, *self._list_others(path))))
