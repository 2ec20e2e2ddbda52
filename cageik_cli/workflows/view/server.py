"""The server of a page, on this machine only."""

import os
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import ThreadingHTTPServer
from typing import Any

from cageik_cli.util.errors import SettingError
from cageik_cli.workflows.view.requests import HOST, RequestHandler, Site

MAX_CONNECTIONS = 32
"""Connections that are served at once; more are closed."""

POLL_SECONDS = 0.05
"""How often the server looks whether it should end."""


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


@contextmanager
def serve(site: Site, port: int) -> Iterator[str]:
    """Serve a site in threads while the block runs, and yield its address.

    Parameters
    ----------
    port : int
        0 for any that is free.

    Raises
    ------
    SettingError
        When the port cannot be used.
    """
    handler = type("SiteHandler", (RequestHandler,), {"site": site})
    try:
        server = _Server((HOST, port), handler)
    except OSError as error:
        raise SettingError(
            f"port {port}: cannot be used ({error.strerror or error}); choose another with --port, "
            "or leave it out"
        ) from error
    thread = threading.Thread(target=server.serve_forever, args=[POLL_SECONDS], daemon=True)
    thread.start()
    try:
        yield f"http://{HOST}:{server.server_address[1]}/{site.secret}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
