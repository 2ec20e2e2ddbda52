"""Files that a page reads and writes while it is open: what others do to them is noticed."""

from contextlib import AbstractContextManager
from pathlib import Path

from cageik_cli.util.errors import FileAccessError
from cageik_cli.util.files import Mark, mark_file
from cageik_cli.util.outputs import replace_only


class WatchedInput:
    """An input that has to stay as it was when it was read."""

    def __init__(self, path: Path) -> None:
        self._path, self._mark = path, mark_file(path)

    def check(self) -> None:
        """Refuse the file if it has changed.

        Raises
        ------
        FileAccessError
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

    def guard(self) -> AbstractContextManager[None]:
        """Refuse, while the block runs, to replace what others write to these outputs meanwhile.

        What `may_replace` says is of the moment; an edit takes seconds before it writes.
        """
        return replace_only({} if self._may_replace else self._marks)

    def record(self, path: Path) -> None:
        """Take a file as one that this run has just written."""
        self._marks[path] = mark_file(path)

    def withdraw(self, path: Path) -> None:
        """Remove a file if it is as this run wrote it."""
        mark = self._marks.pop(path, None)
        if mark is not None and mark_file(path) == mark:
            path.unlink()
