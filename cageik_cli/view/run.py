"""A page is served until someone stops it; edits run one at a time, in the main thread."""

import secrets
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path
from typing import Protocol

from cageik_cli.util.errors import format_error
from cageik_cli.util.messages import Hint, Row, Said, spell, spell_keyword
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view.server import Edit, JobBoard, Rows, Site, serve
from cageik_cli.view.session import PageSession


class BoardProgress(ProgressListener):
    """Puts the progress of an edit on the board, and passes it on."""

    def __init__(self, board: JobBoard, inner: ProgressListener) -> None:
        self._board, self._inner = board, inner
        self.notes: list[Row] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Put the stage on the board."""
        self._board.change(stage=name)
        with self._inner.stage(name):
            yield

    def update(self, done: int, total: int) -> None:
        """Put the frames on the board."""
        self._board.change(done=done, total=total)
        self._inner.update(done, total)

    def note(self, topic: str, text: Said) -> None:
        """Keep a note, and pass it on."""
        self.notes.append((topic, text))
        self._inner.note(topic, text)


class ViewListener(Protocol):
    """Hears of a page that is served; this one ignores it."""

    def spell_hint(self, hint: Hint) -> str:
        """Write a hint as who reads the page types it."""
        return spell_keyword(hint)

    def open(self, address: str) -> None:
        """Take the address of the page, which is served from now on."""

    def show_edit(self) -> AbstractContextManager[ProgressListener]:
        """Return a context that is entered while an edit runs, with its progress."""
        return nullcontext(ProgressListener())

    def show_applied(self, rows: Rows, written: Sequence[Path]) -> None:
        """Take what came of an edit, and the files that it wrote."""

    def show_failed(self, error: str) -> None:
        """Take the error of an edit."""


def run_view(
    session: PageSession, port: int, listener: ViewListener, wait_seconds: float = 0.5
) -> None:
    """Serve the page of a session, and apply the edits that it sends, until interrupted.

    Edits run in this thread, so that an interrupt unwinds them: an edit leaves complete outputs or
    those before it.

    Parameters
    ----------
    wait_seconds : float
        How often it is looked for an interrupt, where waiting would hide that.

    Raises
    ------
    SettingError
        When the port cannot be used.
    KeyboardInterrupt
        When it is interrupted.
    """
    board = JobBoard()
    site = Site(
        secret=secrets.token_urlsafe(24),
        page=session.render_page(listener.spell_hint).encode(),
        board=board,
        parse=session.parse if session.can_apply else None,
        answers=session.answers,
        streams=session.streams,
        jobs=session.jobs,
        spelling=listener.spell_hint,
    )
    with closing(session), serve(site, port, _prefer_port(session.key)) as address:
        listener.open(address)
        while True:
            edit = board.wait(wait_seconds)
            if edit is not None:
                _run_edit(session, edit, board, listener)


def _prefer_port(key: str) -> int:
    """Return the port of a page: of the same files the same, as browsers keep what is not saved by
    it.
    """
    first, count = 49152, 16384  # those that are nobody's (IANA)
    return first + int(key[:8], 16) % count


def _run_edit(session: PageSession, edit: Edit, board: JobBoard, listener: ViewListener) -> None:
    """Apply one edit, and tell the page and the listener how it went."""
    try:
        with listener.show_edit() as progress:
            progress_on_board = BoardProgress(board, progress)
            found = edit(progress_on_board)
    except Exception as error:  # the page keeps its handles, whatever happens
        message = spell(format_error(error), listener.spell_hint)
        board.change(state="failed", error=message)
        listener.show_failed(message)
        return
    noted = (*found, *progress_on_board.notes)
    rows = tuple((label, spell(text, listener.spell_hint)) for label, text in noted)
    written = tuple(str(path) for path in session.written)
    board.change(state="done", rows=rows, written=written)
    listener.show_applied(found, session.written)
