"""The interface by which a served page tells what happens to it."""

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from cageik_cli.util.progress import ProgressListener

if TYPE_CHECKING:
    from cageik_cli.workflows.view.session import AppliedEdit


class ViewListener:
    """Hears of a page that is served; this one ignores it."""

    def open(self, address: str) -> None:
        """Take the address of the page, which is served from now on."""

    def show_edit(self) -> AbstractContextManager[ProgressListener]:
        """Return a context that is entered while an edit runs, with its progress."""
        return nullcontext(ProgressListener())

    def tell_applied(self, applied: "AppliedEdit") -> None:
        """Take the outcome of an edit."""

    def tell_failed(self, error: str) -> None:
        """Take the error of an edit."""
