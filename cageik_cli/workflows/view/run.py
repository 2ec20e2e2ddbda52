"""A page is served until someone stops it; edits run one at a time, in the main thread."""

import secrets

from cageik_cli.report.html.player_page import render_view_page
from cageik_cli.report.views.pose_text import format_pose_rows
from cageik_cli.util.errors import describe_error
from cageik_cli.workflows.view.jobs import BoardProgress, JobBoard
from cageik_cli.workflows.view.listener import ViewListener
from cageik_cli.workflows.view.requests import Site
from cageik_cli.workflows.view.server import serve
from cageik_cli.workflows.view.session import Edit, ViewSession

WAIT_SECONDS = 0.5
"""How often the main thread looks whether it is interrupted, where waiting would hide that."""

SECRET_BYTES = 24


def run_view(session: ViewSession, port: int, listener: ViewListener) -> None:
    """Serve the page of a session, and apply the handles that it sends, until interrupted.

    Edits run in this thread, so that an interrupt unwinds them: an edit leaves complete outputs or
    those before it.

    Raises
    ------
    SettingError
        When the port cannot be used.
    KeyboardInterrupt
        When it is interrupted.
    """
    board = JobBoard()
    apply_url = "apply" if session.can_apply else ""
    page = render_view_page(session.clip, apply_url, session.first_handles, session.edited_from)
    site = Site(
        secret=secrets.token_urlsafe(SECRET_BYTES),
        page=page.encode(),
        board=board,
        parse=session.parse if session.can_apply else None,
    )
    with serve(site, port) as address:
        listener.open(address)
        while True:
            edit = board.wait(WAIT_SECONDS)
            if edit is not None:
                _run_edit(session, edit, board, listener)


def _run_edit(session: ViewSession, edit: Edit, board: JobBoard, listener: ViewListener) -> None:
    """Apply one edit, and tell the page and the listener how it went."""
    try:
        with listener.show_edit() as progress:
            progress_on_board = BoardProgress(board, progress)
            applied = session.apply(edit, progress_on_board)
    except Exception as error:  # the page keeps its handles, whatever happens
        board.change(state="failed", error=describe_error(error))
        listener.tell_failed(describe_error(error))
        return
    rows = (*format_pose_rows(applied.result.summary), *progress_on_board.notes)
    written = tuple(str(path) for path in applied.written)
    board.change(state="done", rows=rows, written=written)
    listener.tell_applied(applied)
