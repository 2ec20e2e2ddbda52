"""What the server of a page serves, and how it refuses."""

import threading
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cageik_cli.workflows.view.run import Edit, JobBoard


class RefusedRequestError(Exception):
    """A request that is not answered: status and text."""

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


def make_busy_error() -> RefusedRequestError:
    """Return the refusal of a second edit."""
    text = "another edit is running; try again when it is done"
    return RefusedRequestError(HTTPStatus.CONFLICT, text)


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """What is served.

    Attributes
    ----------
    secret : str
        The first part of every path.
    page : bytes
        HTML.
    parse : callable, optional
        Makes an edit of a body and a rigidity; None if handles cannot be applied.
    answers : dict of str to callable
        What else may be sent, and the answer to a body, which is sent as JSON.
    word : callable
        Returns a text in the words of who reads the page.
    """

    secret: str
    page: bytes
    board: "JobBoard"
    parse: Callable[[bytes, int], "Edit"] | None
    answers: Mapping[str, Callable[[bytes], Any]] = field(default_factory=dict)
    word: Callable[[str], str] = str
    _turns: dict[str, threading.Lock] = field(
        default_factory=lambda: defaultdict(threading.Lock), init=False
    )

    @contextmanager
    def take_turn(self, name: str) -> Iterator[None]:
        """Refuse a second body at one address at a time: parsed, each takes a hundred megabytes."""
        turn = self._turns[name]
        if not turn.acquire(blocking=False):
            raise make_busy_error()
        try:
            yield
        finally:
            turn.release()
