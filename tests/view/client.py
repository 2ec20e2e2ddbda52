"""A client that sends anything: requests as bytes, over a plain socket."""

import json
import socket
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit


@dataclass(frozen=True)
class Answer:
    """Status, headers in lower case, and body of an answer; status 0 if there was none."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def value(self) -> Any:
        """The JSON of the body."""
        return json.loads(self.body)


def make_body(handles: object = None, cage_edits: object = None) -> bytes:
    """Return what a page sends of an edit."""
    return json.dumps({"handles": handles, "cageEdits": cage_edits}).encode()


class Client:
    """Sends requests to an address that a page is served at."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.host, self.port = parts.hostname, parts.port
        self.secret = parts.path.strip("/")

    def connect(self) -> socket.socket:
        return socket.create_connection((self.host, self.port), timeout=20)

    def send(self, data: bytes) -> Answer:
        """Send bytes as they are, and read until the server closes."""
        with self.connect() as connection:
            connection.sendall(data)
            return read_answer(connection)

    def ask(
        self, path: str = "", method: str = "GET", body: bytes = b"", **headers: str | None
    ) -> Answer:
        """Send a request as the page does; headers are added, replaced, or left out for None."""
        return self.send(self.make_request(path, method, body, **headers))

    def make_request(
        self, path: str = "", method: str = "GET", body: bytes = b"", **headers: str | None
    ) -> bytes:
        own = f"{self.host}:{self.port}"
        known: dict[str, str | None] = {"Host": own}
        if method == "POST":
            known |= {
                "Origin": f"http://{own}",
                "Content-Type": "application/json",
                "Content-Length": str(len(body)),
            }
        known |= {name.replace("_", "-"): value for name, value in headers.items()}
        lines = [f"{name}: {value}\r\n" for name, value in known.items() if value is not None]
        path = path if path.startswith("/") else f"/{self.secret}/{path}"
        return f"{method} {path} HTTP/1.1\r\n{''.join(lines)}\r\n".encode() + body

    def apply(self, document: object, query: str = "") -> Answer:
        """Apply a handles file."""
        return self.ask(f"apply{query}", "POST", make_body(document))

    def status(self) -> dict[str, Any]:
        return self.ask("status").value


def read_answer(connection: socket.socket) -> Answer:
    received = b""
    try:
        while part := connection.recv(1 << 16):
            received += part
    except ConnectionError:
        pass
    head, _, body = received.partition(b"\r\n\r\n")
    first, *lines = head.decode().split("\r\n")
    headers = dict(line.lower().split(": ", 1) for line in lines if ": " in line)
    return Answer(int(first.split()[1]) if first.startswith("HTTP/") else 0, headers, body)
