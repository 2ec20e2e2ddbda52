"""The server of a page, on this machine only: who may ask, and what is read of a request.

Any page in the browser can send requests to 127.0.0.1, and any program of this machine can
connect. So every request must name this machine as its host (other names may be made to lead here),
come from no other origin, and carry the secret of the address. Bodies are of JSON, of a known and
bounded length, and must arrive within seconds.

    GET  /SECRET/         the page
    GET  /SECRET/status   a JSON object, the fields of `JobStatus`
    POST /SECRET/apply    {"handles": …, "cageEdits": …}, the content of such files or null;
                          `?rigidity=N` for N rounds. 202 with {"job": number}
    POST /SECRET/save     the same with "name", of a new file beside what is viewed, and "rigidity"
    POST /SECRET/before   which frames of what was before; 200 with their bytes, see `before.py`

What a page that edits a rest cage sends is {"vertices": [[x, y, z], …], "polygons": [[…], …]}:

    POST /SECRET/check    200 with the verdict and the findings
    POST /SECRET/weights  200 with the weights, packed
    POST /SECRET/repair   200 with a cage that is repaired
    POST /SECRET/apply    the cage that is written. 202 as above
    POST /SECRET/save     the same with "name"
    POST /SECRET/extract  the cage in which a result is extracted again, with "name". 202 as above
    POST /SECRET/errors   {}. 200 with the errors of the result, before and after

A refusal is a JSON object, {"error": text}: 400 and 422 for what was sent, 403 for who asks, 404,
408 for a body that is too slow, 409 while another edit or check runs or there is nothing to write,
411, 413 and 415 for the length and type of a body, 503 for a check that took too long.
"""

import io
import json
import os
import re
import socket
import socketserver
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from hmac import compare_digest
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from cageik_cli.editing.handles.reader import MAX_HANDLES_BYTES
from cageik_cli.util.errors import (
    BusyError,
    CageikError,
    SettingError,
    SlowError,
    describe_error,
)
from cageik_cli.util.messages import Row, Spelling, say, spell, spell_keyword
from cageik_cli.util.progress import ProgressListener

HOST = "127.0.0.1"

HEAD_SECONDS = 2.0
"""A request whose head has not arrived within this time is given up; browsers of this machine send
it at once, and what is idle must not keep a page out."""

READ_SECONDS = 10.0
"""A body that has not arrived within this time is given up."""

SEND_SECONDS = 30.0
"""A client that does not take a block within this time is given up."""

MAX_CONNECTIONS = 32
"""Connections that are served at once; more are closed."""

MAX_SUBMITTED_BYTES = 2 * MAX_HANDLES_BYTES
"""Largest body that is read: a handles file and a cage edits file."""

MAX_RIGIDITY = 1000
"""Rounds of rigid rotations, at most."""

HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Of every answer: nothing is kept, framed or told to others."""


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
class Stream:
    """An answer of so many bytes, which are made while it is sent."""

    size: int
    parts: Iterator[bytes]


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
        What else may be sent, and the answer to a body and `spelling`, which is sent as JSON.
    spelling : callable
        Writes the settings that texts name, as who reads the page types them.
    streams : dict of str to (int, callable)
        What else: the largest body, and the stream of bytes that answers one.
    jobs : dict of str to callable
        What else may be sent that writes files: makes an edit of a body.
    """

    secret: str
    page: bytes
    board: "JobBoard"
    parse: Callable[[bytes, int], "Edit"] | None
    answers: Mapping[str, Callable[[bytes, Spelling], Any]] = field(default_factory=dict)
    spelling: Spelling = spell_keyword
    streams: Mapping[str, tuple[int, Callable[[bytes], Stream]]] = field(default_factory=dict)
    jobs: Mapping[str, Callable[[bytes], "Edit"]] = field(default_factory=dict)
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


Rows = Sequence[Row]
"""Labels and texts."""

Edit = Callable[[ProgressListener], Rows]
"""Applies what was sent and writes the outputs; returns what came of it."""


@dataclass(frozen=True, slots=True)
class JobStatus:
    """What is known of the last edit.

    Attributes
    ----------
    job : int
        Its number, from 1; 0 before the first.
    state : str
        "idle" before the first edit, then "running", "done" or "failed".
    stage : str
        What it does, such as "open", "pose" or "write".
    done, total : int
        Frames of that.
    rows : tuple of (label, text)
        What came of it, as `cageik pose` prints it.
    written : tuple of str
        Files that were written.
    error : str
        Why it failed.
    """

    job: int = 0
    state: str = "idle"
    stage: str = ""
    done: int = 0
    total: int = 0
    rows: tuple[tuple[str, str], ...] = ()
    written: tuple[str, ...] = ()
    error: str = ""


class JobBoard:
    """Holds the edit that is to be done or runs; a second one is refused."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._status = JobStatus()
        self._waiting: Edit | None = None

    @property
    def status(self) -> JobStatus:
        """What is known of the last edit."""
        with self._changed:
            return self._status

    def submit(self, edit: Edit) -> int | None:
        """Take an edit, and return its number; None while another one runs."""
        with self._changed:
            if self._status.state == "running":
                return None
            self._waiting = edit
            self._status = JobStatus(job=self._status.job + 1, state="running")
            self._changed.notify_all()
            return self._status.job

    def wait(self, seconds: float) -> Edit | None:
        """Wait for the next edit; None if there is none for so long."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None, seconds)
            edit, self._waiting = self._waiting, None
            return edit

    def change(self, **values: object) -> None:
        """Change what is known of the edit that runs."""
        with self._changed:
            self._status = replace(self._status, **values)  # type: ignore[arg-type]


class RequestHandler(BaseHTTPRequestHandler):
    """Answers one request of a connection, which is then closed."""

    server_version, sys_version = "cageik", ""
    site: Site

    def setup(self) -> None:
        """Read the head of the request before a deadline."""
        super().setup()
        self.rfile.close()
        self._reader = _DeadlineReader(self.connection, time.monotonic() + HEAD_SECONDS)
        self.rfile = io.BufferedReader(self._reader)

    def do_GET(self) -> None:
        """Answer with the page or the status."""
        site = self.site
        self._answer(
            {
                "": lambda _: self._send(HTTPStatus.OK, "text/html; charset=utf-8", site.page),
                "status": lambda _: self._send_json(HTTPStatus.OK, asdict(site.board.status)),
            }
        )

    def do_POST(self) -> None:
        """Take an edit, or what else the page sends."""
        others = {name: partial(self._send_answer, name) for name in self.site.answers}
        jobs = {name: partial(self._start_job, name) for name in self.site.jobs}
        streams = {name: partial(self._send_stream, name) for name in self.site.streams}
        self._answer({"apply": self._apply, **jobs, **others, **streams})

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Send a refusal as JSON."""
        self._send_json(code, {"error": message or HTTPStatus(code).phrase})

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Keep quiet: the terminal shows edits, not requests."""

    def _answer(self, actions: dict[str, Callable[[str], None]]) -> None:
        """Do what the path names, if the client may ask for it."""
        try:
            self._check_client()
            path, query = self._split_path()
            if path not in actions:
                raise RefusedRequestError(HTTPStatus.NOT_FOUND, "there is nothing at this address")
            actions[path](query)
        except RefusedRequestError as error:
            self.send_error(error.status, str(error))
        except (ConnectionError, TimeoutError):
            raise
        except Exception as error:
            self.send_error(
                HTTPStatus.INTERNAL_SERVER_ERROR, spell(describe_error(error), self.site.spelling)
            )

    def _check_client(self) -> None:
        """Refuse requests that another host name or another page leads here."""
        hosts, origins = self.headers.get_all("Host", []), self.headers.get_all("Origin", [])
        host = hosts[0].lower() if len(hosts) == 1 else ""
        name, _, port = host.partition(":")
        if name not in (HOST, "localhost") or (port or "80") != str(
            self.connection.getsockname()[1]
        ):
            raise RefusedRequestError(HTTPStatus.FORBIDDEN, "the host is not this machine")
        if origins and origins != [f"http://{host}"]:
            raise RefusedRequestError(HTTPStatus.FORBIDDEN, "the request is from another page")
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            raise RefusedRequestError(HTTPStatus.FORBIDDEN, "the request is from another page")

    def _split_path(self) -> tuple[str, str]:
        """Return what is behind the secret, and the query."""
        path, _, query = self.path.partition("?")
        _, secret, *rest = [*path.split("/", 2), "", ""]
        if not compare_digest(secret.encode(errors="replace"), self.site.secret.encode()):
            raise RefusedRequestError(
                HTTPStatus.FORBIDDEN, "the address is not the one that cageik view printed"
            )
        return rest[0], query

    def _apply(self, query: str) -> None:
        if self.site.parse is None:
            raise RefusedRequestError(
                HTTPStatus.CONFLICT,
                "there is no file to write; start cageik view again with an output",
            )
        parse, rigidity = self.site.parse, _parse_rigidity(query)
        self._submit(lambda data: parse(data, rigidity))

    def _start_job(self, name: str, query: str) -> None:
        """Take what writes files."""
        _refuse_query(query)
        self._submit(self.site.jobs[name])

    def _submit(self, parse: Callable[[bytes], "Edit"]) -> None:
        """Put what a body asks for on the board."""
        data = self._read_body()
        with self.site.take_turn("job"):
            if self.site.board.status.state == "running":
                raise make_busy_error()
            try:
                edit = parse(data)
            except CageikError as error:
                text = spell(error.text, self.site.spelling)
                raise RefusedRequestError(HTTPStatus.UNPROCESSABLE_ENTITY, text) from error
            job = self.site.board.submit(edit)
        if job is None:
            raise make_busy_error()
        self._send_json(HTTPStatus.ACCEPTED, {"job": job})

    def _send_answer(self, name: str, query: str) -> None:
        """Send the answer to a body."""
        _refuse_query(query)
        data = self._read_body()
        try:
            with self.site.take_turn(name):
                answer = self.site.answers[name](data, self.site.spelling)
        except BusyError as error:
            raise RefusedRequestError(HTTPStatus.CONFLICT, str(error)) from error
        except SlowError as error:
            raise RefusedRequestError(HTTPStatus.SERVICE_UNAVAILABLE, str(error)) from error
        except CageikError as error:
            text = spell(error.text, self.site.spelling)
            raise RefusedRequestError(HTTPStatus.UNPROCESSABLE_ENTITY, text) from error
        self._send_json(HTTPStatus.OK, answer)

    def _send_stream(self, name: str, query: str) -> None:
        """Send the stream that answers a body; a second one is refused meanwhile."""
        _refuse_query(query)
        most, make = self.site.streams[name]
        data = self._read_body(most)
        with self.site.take_turn(name):
            try:
                stream = make(data)
            except CageikError as error:
                text = spell(error.text, self.site.spelling)
                raise RefusedRequestError(HTTPStatus.UNPROCESSABLE_ENTITY, text) from error
            self._send_head(HTTPStatus.OK, "application/octet-stream", stream.size)
            try:
                for part in stream.parts:
                    self._send_blocks(part)
            except Exception as error:
                # The head is sent: that the answer is too short says that it failed.
                raise ConnectionAbortedError from error

    def _read_body(self, most: int = MAX_SUBMITTED_BYTES) -> bytes:
        """Read a body of JSON; nothing is read of one that is too long."""
        if self.headers.get_content_type() != "application/json":
            raise RefusedRequestError(
                HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "expected a body of application/json"
            )
        lengths = self.headers.get_all("Content-Length", [])
        if "Transfer-Encoding" in self.headers or not lengths:
            raise RefusedRequestError(HTTPStatus.LENGTH_REQUIRED, "expected a Content-Length")
        if len(lengths) > 1 or not (lengths[0].isascii() and lengths[0].isdigit()):
            raise RefusedRequestError(HTTPStatus.BAD_REQUEST, "Content-Length is not a number")
        if len(lengths[0]) > len(str(most)) or int(lengths[0]) > most:
            raise RefusedRequestError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"what is sent has at most {most} bytes"
            )
        self._reader.deadline = time.monotonic() + READ_SECONDS
        try:
            data = self.rfile.read(int(lengths[0]))
        except TimeoutError as error:
            raise RefusedRequestError(
                HTTPStatus.REQUEST_TIMEOUT, f"the body took more than {READ_SECONDS:g} seconds"
            ) from error
        if len(data) < int(lengths[0]):
            raise RefusedRequestError(HTTPStatus.BAD_REQUEST, "the body is shorter than it says")
        return data

    def _send_json(self, status: int, value: Any) -> None:
        self._send(status, "application/json", json.dumps(value).encode())

    def _send(self, status: int, kind: str, data: bytes) -> None:
        self._send_head(status, kind, len(data))
        self._send_blocks(data)

    def _send_head(self, status: int, kind: str, size: int) -> None:
        self.connection.settimeout(SEND_SECONDS)
        self.send_response_only(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _send_blocks(self, data: bytes) -> None:
        # The timeout of a socket is for all that is written at once, not for each piece of it.
        block = 1 << 16  # what a line of 20 kbit/s takes in that time
        for start in range(0, len(data), block):
            self.wfile.write(data[start : start + block])


class _DeadlineReader(io.RawIOBase):
    """Reads from a socket until a point in time, however slowly bytes come."""

    def __init__(self, connection: socket.socket, deadline: float) -> None:
        self._connection, self.deadline = connection, deadline

    def readable(self) -> bool:
        """Whether it can be read: always."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read some bytes."""
        left = self.deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError("the request took too long")
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)


def _refuse_query(query: str) -> None:
    if query:
        raise RefusedRequestError(HTTPStatus.BAD_REQUEST, "expected no query")


def _parse_rigidity(query: str) -> int:
    """Return the rounds that a query names; 0 if it names none."""
    if not query:
        return 0
    named = re.fullmatch(r"rigidity=(\d{1,4})", query, re.ASCII)
    if named is None or int(named[1]) > MAX_RIGIDITY:
        raise RefusedRequestError(
            HTTPStatus.BAD_REQUEST, f"expected rigidity, a whole number up to {MAX_RIGIDITY}"
        )
    return int(named[1])


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    request_queue_size = MAX_CONNECTIONS
    # On Windows this would let another program take the port over.
    allow_reuse_address = os.name != "nt"

    def __init__(self, *arguments: Any) -> None:
        self._free = threading.BoundedSemaphore(MAX_CONNECTIONS)
        super().__init__(*arguments)

    def server_bind(self) -> None:
        """Bind without asking for the name of this machine, which can take seconds."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own, unless there are too many."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: the client is gone or too slow."""


def _bind(handler: type[RequestHandler], port: int, preferred: int) -> _Server:
    if preferred and not port:
        with suppress(OSError):
            return _Server((HOST, preferred), handler)
    return _Server((HOST, port), handler)


@contextmanager
def serve(site: Site, port: int, preferred: int = 0) -> Iterator[str]:
    """Serve a site in threads while the block runs, and yield its address.

    Parameters
    ----------
    port : int
        0 for any that is free.
    preferred : int
        Which of these if it is free; 0 for any.
    """
    handler = type("SiteHandler", (RequestHandler,), {"site": site})
    try:
        server = _bind(handler, port, preferred)
    except OSError as error:
        raise SettingError(
            f"port {port}: cannot be used ({error.strerror or error}); "
            + say("choose another with `port=`, or leave it out")
        ) from error
    # It looks every 0.05 seconds whether it should end.
    thread = threading.Thread(target=server.serve_forever, args=[0.05], daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_address[1]}/{site.secret}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
