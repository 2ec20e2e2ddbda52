"""Files of a page: the handles that it begins with, and those that it reads or writes itself."""

from pathlib import Path

from cageik_cli.posing.handles.model import Handle, Handles, PosedSurface
from cageik_cli.posing.handles.placement import place_handles
from cageik_cli.posing.handles.reader import read_handles
from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.util.errors import FileAccessError, HandlesError, error_context

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
        """Refuse the file if it has changed."""
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


def read_first_handles(path: Path) -> Handles:
    """Read handles that a page can show, if they fit its model."""
    handles = read_handles(path)
    with error_context(path):
        for handle_set in handles.sets:
            for handle in handle_set.handles:
                _check_shown(handle)
    return handles


def check_places(handles: Handles, clip: PlayerClip) -> None:
    """Refuse handles that are at no vertex or face of a model, or at no frame of its clip."""
    rest = clip.binding.rest
    surface = PosedSurface(rest, lambda _: rest.vertices, len(clip.frames) or None)
    for handle_set in handles.sets:
        with error_context(handles.path):
            place_handles(handle_set, surface, allow_conflicts=True)


def _check_shown(handle: Handle) -> None:
    """Refuse what the page has no means to show."""
    is_on_screen = handle.motion.camera is not None
    if is_on_screen or handle.place.kind in ("position", "screen.source"):
        raise HandlesError(
            f"handle {handle.name!r}: has a position or a screen, which the page does not show; "
            "pose it with cageik pose, or give a vertex or a face, and an offset or a target"
        )
    if handle.radius is not None:
        raise HandlesError(
            f"handle {handle.name!r}: has a radius, which the page does not show; pose it with "
            "cageik pose, or remove the radius"
        )
