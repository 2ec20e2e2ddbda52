"""Files that a long run reads once or writes many times, and whether someone else changed them."""

from pathlib import Path

from cageik_cli.util.errors import FileAccessError

Mark = tuple[int, ...]
"""What changes when a file is written or replaced."""


def mark_file(path: Path) -> Mark | None:
    """Return the mark of a file; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class WatchedInput:
    """An input that has to stay as it was when it was read."""

    def __init__(self, path: Path) -> None:
        self._path, self._mark = path, mark_file(path)

    def check(self) -> None:
        """Refuse the file if it has changed.

        Raises
        ------
        FileAccessError
            Naming the file.
        """
        if mark_file(self._path) != self._mark:
            raise FileAccessError(
                f"{self._path}: has changed since the page was opened; start cageik view again"
            )


class OwnOutputs:
    """Outputs that are written again and again: only what this run wrote is replaced.

    Parameters
    ----------
    may_replace : bool
        Whether other files may be replaced, too.
    """

    def __init__(self, may_replace: bool) -> None:
        self._may_replace = may_replace
        self._marks: dict[Path, Mark | None] = {}

    def may_replace(self, path: Path) -> bool:
        """Whether the file at `path` may be replaced: it is as this run wrote it, or any may."""
        return self._may_replace or (
            path in self._marks and mark_file(path) == self._marks[path] is not None
        )

    def record(self, path: Path) -> None:
        """Take a file as one that this run has just written."""
        self._marks[path] = mark_file(path)
