"""Requests of strangers to the server of a page: what is refused, and what is read of it."""

import socket
import threading
import time
from dataclasses import replace

import pytest

from cageik_cli.util.errors import HandlesError, SettingError
from cageik_cli.view import server
from cageik_cli.view.server import MAX_SUBMITTED_BYTES, JobBoard, Site, serve
from tests.view.client import Client, read_answer

SECRET = "s" * 32


@pytest.fixture
def parsed():
    """What reached the parser."""
    return []


@pytest.fixture
def site(parsed):
    def parse(data, rigidity):
        parsed.append((data, rigidity))
        if data == b"bad":
            raise HandlesError("handle 'hand': is bad")
        if data == b"bug":
            raise ZeroDivisionError("an internal fault")
        return data

    return Site(SECRET, b"<p>page</p>", JobBoard(), parse)


@pytest.fixture
def client(site):
    with serve(site, 0) as address:
        assert address.startswith("http://127.0.0.1:")
        yield Client(address)


def test_the_page_is_served(client):
    answer = client.ask()
    assert (answer.status, answer.body) == (200, b"<p>page</p>")
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert answer.headers["content-security-policy"] == "frame-ancestors 'none'"
    assert "access-control-allow-origin" not in answer.headers
    assert "server" not in answer.headers


def test_the_status_is_served(client):
    status = client.status()
    assert (status["job"], status["state"]) == (0, "idle")


def test_an_edit_is_taken(client, site, parsed):
    answer = client.ask("apply?rigidity=12", "POST", b"{}")
    assert (answer.status, answer.value) == (202, {"job": 1})
    assert parsed == [(b"{}", 12)]
    assert site.board.wait(0) == b"{}"
    assert client.status()["state"] == "running"


def test_the_name_localhost_is_this_machine_too(client):
    host = f"localhost:{client.port}"
    assert client.ask(Host=host).status == 200
    assert client.ask("apply", "POST", b"{}", Host=host, Origin=f"http://{host}").status == 202


@pytest.mark.parametrize(
    "path", ["/", "/status", f"/{SECRET[1:]}/", f"/{SECRET}s/", "//", f"/x/{SECRET}/"]
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_without_the_secret_nothing_is_answered(client, parsed, path, method):
    answer = client.ask(path, method, b"{}")
    assert answer.status == 403
    assert b"page" not in answer.body.replace(b"cageik", b"")
    assert parsed == []


def test_the_secret_may_be_any_bytes_in_a_request(client):
    for path in ("/\x80\xff/", "/" + "s" * 60_000 + "/", "/%73/", "/", "/?", "/?/" + SECRET):
        assert client.ask(path).status == 403
    for path in (b"http://[/", b"*", b"x", b"http://127.0.0.1/%s/" % SECRET.encode()):
        request = client.make_request().replace(b"/" + SECRET.encode() + b"/", path, 1)
        assert client.send(request).status == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1", ""]
)
@pytest.mark.parametrize(("path", "method"), [("", "GET"), ("status", "GET"), ("apply", "POST")])
def test_another_origin_is_refused(client, parsed, origin, path, method):
    assert client.ask(path, method, b"{}", Origin=origin).status == 403
    assert parsed == []


def test_another_page_is_refused_even_without_an_origin(client):
    assert client.ask(Sec_Fetch_Site="cross-site").status == 403
    assert client.ask(Sec_Fetch_Site="same-site").status == 403
    assert client.ask(Sec_Fetch_Site="same-origin").status == 200


@pytest.mark.parametrize(
    "host",
    [
        *("evil.example", "evil.example:80", "127.0.0.1.evil.example", None, ""),
        *("127.0.0.1", "localhost", "127.0.0.1:80", "127.0.0.1:", "127.0.0.1:x"),
    ],
)
def test_another_host_is_refused(client, parsed, host):
    """A name that its owner leads to this machine would make its pages of the same origin."""
    origin = f"http://{host}"
    assert client.ask(Host=host).status == 403
    assert client.ask("apply", "POST", b"{}", Host=host, Origin=origin).status == 403
    assert parsed == []


def test_two_hosts_are_refused(client):
    request = client.make_request().replace(b"\r\n\r\n", b"\r\nHost: 127.0.0.1\r\n\r\n")
    assert client.send(request).status == 403


@pytest.mark.parametrize(
    "path",
    [
        "../../etc/passwd",
        "%2e%2e/%2e%2e/etc/passwd",
        "etc/passwd",
        "status/",
        "status/../handles",
        "apply",
        "//evil.example/",
    ],
)
def test_there_is_nothing_at_other_paths(client, path):
    assert client.ask(path).status in (403, 404)


def test_other_methods_are_refused(client):
    for method in ("PUT", "DELETE", "OPTIONS", "HEAD", "TRACE", "CONNECT", "X" * 1000):
        answer = client.ask("apply", method)
        assert answer.status == 501
        assert "access-control-allow-origin" not in answer.headers
    assert client.ask("status", "POST", b"{}").status == 404


@pytest.mark.parametrize("length", [MAX_SUBMITTED_BYTES + 1, 10**9, 10**30, "9" * 5000])
def test_a_body_that_is_too_long_is_not_read(client, parsed, length):
    start = time.monotonic()
    answer = client.ask("apply", "POST", b"", Content_Length=str(length))
    assert answer.status == 413
    assert time.monotonic() - start < server.READ_SECONDS / 2
    assert parsed == []


def test_a_body_of_the_largest_size_is_read(client, parsed):
    body = b" " * MAX_SUBMITTED_BYTES
    assert client.ask("apply", "POST", body).status == 202
    assert parsed == [(body, 0)]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Content_Length": None}, 411),
        ({"Content_Length": None, "Transfer_Encoding": "chunked"}, 411),
        ({"Transfer_Encoding": "chunked"}, 411),
        ({"Content_Length": "-1"}, 400),
        ({"Content_Length": "2; 3"}, 400),
        ({"Content_Length": "+2"}, 400),
        ({"Content_Length": "²"}, 400),
        ({"Content_Type": None}, 415),
        ({"Content_Type": "text/plain"}, 415),
        ({"Content_Type": "application/x-www-form-urlencoded"}, 415),
        ({"Content_Type": "multipart/form-data; boundary=x"}, 415),
    ],
)
def test_bodies_of_other_kinds_are_refused(client, parsed, headers, status):
    assert client.ask("apply", "POST", b"{}", **headers).status == status
    assert parsed == []


def test_two_lengths_are_refused(client, parsed):
    request = client.make_request("apply", "POST", b"{}")
    twice = request.replace(b"Content-Length: 2", b"Content-Length: 2\r\nContent-Length: 1")
    assert client.send(twice).status == 400
    assert parsed == []


def test_a_body_that_is_cut_off_is_refused(client, parsed):
    with client.connect() as connection:
        connection.sendall(client.make_request("apply", "POST", b"{}", Content_Length="100"))
        connection.shutdown(1)
        assert read_answer(connection).status == 400
    assert parsed == []


def test_a_slow_body_is_given_up(client, parsed, monkeypatch):
    """Also if a byte comes now and then."""
    monkeypatch.setattr(server, "READ_SECONDS", 0.5)
    request = client.make_request("apply", "POST", b"", Content_Length="1000")
    start = time.monotonic()
    with client.connect() as connection:
        connection.sendall(request)
        dripping = threading.Thread(target=drip, args=[connection])
        dripping.start()
        answer = read_answer(connection)
    dripping.join()
    assert answer.status in (0, 408)  # 0: the answer was lost as bytes were still coming
    assert 0.4 < time.monotonic() - start < 5
    assert parsed == []
    assert client.ask().status == 200


def drip(connection):
    try:
        for _ in range(30):
            connection.sendall(b" ")
            time.sleep(0.1)
    except OSError:
        pass


def test_slow_headers_are_given_up(client, monkeypatch):
    monkeypatch.setattr(server, "HEAD_SECONDS", 0.3)
    start = time.monotonic()
    with client.connect() as connection:
        connection.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert connection.recv(100) == b""
    assert time.monotonic() - start < 5


def test_a_slow_line_gets_the_whole_page(site, monkeypatch):
    """However long it takes, as long as something arrives."""
    monkeypatch.setattr(server, "SEND_SECONDS", 0.4)
    page = bytes(24 << 20)
    with serve(replace(site, page=page), 0) as address:
        client = Client(address)
        start = time.monotonic()
        with client.connect() as connection:
            connection.sendall(client.make_request())
            received = 0
            while part := connection.recv(1 << 20, socket.MSG_WAITALL):
                received += len(part)
                time.sleep(0.05)
    assert received > len(page)
    assert time.monotonic() - start > 2 * server.SEND_SECONDS


def test_a_client_that_takes_nothing_is_given_up(site, monkeypatch):
    monkeypatch.setattr(server, "SEND_SECONDS", 0.2)
    monkeypatch.setattr(server, "MAX_CONNECTIONS", 1)
    with serve(replace(site, page=bytes(24 << 20)), 0) as address:
        client = Client(address)
        with client.connect() as connection:
            connection.sendall(client.make_request())
            time.sleep(0.1)
            assert client.ask("status").status == 0
            deadline = time.monotonic() + 10
            while client.ask("status").status != 200:
                assert time.monotonic() < deadline


def test_connections_beyond_the_limit_are_closed(client, monkeypatch):
    connections = [client.connect() for _ in range(server.MAX_CONNECTIONS)]
    try:
        for connection in connections:
            connection.sendall(b"GET ")
        time.sleep(0.3)
        assert client.ask().status == 0
    finally:
        for connection in connections:
            connection.close()
    deadline = time.monotonic() + 10
    while client.ask().status != 200:
        assert time.monotonic() < deadline, "connections that ended are still counted"


def test_idle_connections_keep_the_page_out_for_a_short_time(client, monkeypatch):
    monkeypatch.setattr(server, "HEAD_SECONDS", 0.4)
    connections = [client.connect() for _ in range(server.MAX_CONNECTIONS)]
    start = time.monotonic()
    try:
        while client.ask().status != 200:
            time.sleep(0.05)
        assert time.monotonic() - start < 5
    finally:
        for connection in connections:
            connection.close()


def test_one_body_is_parsed_at_a_time(site):
    """Another is refused, and not parsed, while the first is, or while its edit runs."""
    started, may_end, parsed = threading.Event(), threading.Event(), []

    def parse(data, rigidity):
        parsed.append(data)
        started.set()
        assert may_end.wait(10)
        return data

    with serve(
        Site(SECRET, b"", site.board, parse, {"check": lambda data, word: {}}), 0
    ) as address:
        client = Client(address)
        first = threading.Thread(target=client.ask, args=["apply", "POST", b"first"])
        first.start()
        assert started.wait(10)
        answers = [client.ask("apply", "POST", b"%d" % k).status for k in range(3)]
        assert client.ask("check", "POST", b"").status == 200
        may_end.set()
        first.join()
        answers.append(client.ask("apply", "POST", b"another").status)
    assert answers == [409] * 4
    assert parsed == [b"first"]


@pytest.mark.parametrize(
    "query",
    ["?rigidity=-1", "?rigidity=1001", "?rigidity=1e3", "?rigidity=", "?rigidity=²", "?output=x",
     "?rigidity=1&rigidity=2", "?rigidity=1&output=x", "?" + "a" * 200, "?&&&", "?rigidity"],
)  # fmt: skip
def test_other_queries_are_refused(client, parsed, query):
    assert client.ask(f"apply{query}", "POST", b"{}").status == 400
    assert parsed == []


def test_what_is_wrong_with_handles_is_told(client, site):
    answer = client.ask("apply", "POST", b"bad")
    assert (answer.status, answer.value) == (422, {"error": "handle 'hand': is bad"})
    assert client.status()["state"] == "idle"


def test_a_fault_of_our_own_is_told_without_a_traceback(client, capfd):
    answer = client.ask("apply", "POST", b"bug")
    assert answer.status == 500
    assert answer.value["error"].startswith("internal error (ZeroDivisionError")
    assert capfd.readouterr() == ("", "")


def test_a_second_edit_is_refused_while_one_runs(client, site):
    assert client.ask("apply", "POST", b"1").status == 202
    answer = client.ask("apply", "POST", b"2")
    assert answer.status == 409
    assert answer.value["error"].startswith("another edit is running")
    assert site.board.wait(0) == b"1"
    assert client.ask("apply", "POST", b"3").status == 409
    site.board.change(state="done")
    assert client.ask("apply", "POST", b"4").value == {"job": 2}


def test_of_edits_at_the_same_time_one_is_taken(client, site):
    answers = []
    threads = [
        threading.Thread(
            target=lambda: answers.append(client.ask("apply", "POST", b"{}").status), daemon=True
        )
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [202] + 7 * [409]


def test_without_an_output_nothing_is_taken(site):
    with serve(Site(SECRET, b"", JobBoard(), None), 0) as address:
        answer = Client(address).ask("apply", "POST", b"{}")
    assert answer.status == 409
    assert "with an output" in answer.value["error"]


def test_rubbish_is_refused_quietly(client, capfd):
    for data in (
        b"",
        b"\r\n",
        b"\0" * 1000,
        b"GET\r\n\r\n",
        b"\x16\x03\x01",
        b"GET / HTTP/9\r\n\r\n",
    ):
        with client.connect() as connection:
            connection.sendall(data)
            connection.shutdown(1)
            assert read_answer(connection).status in (0, 400, 403, 505)
    assert client.ask().status == 200
    assert capfd.readouterr() == ("", "")


def test_too_many_headers_are_refused(client):
    many = {f"X{k}": "1" for k in range(200)}
    assert client.ask(**many).status == 431
    assert client.ask(X="1" * 100_000).status == 431


def test_a_port_that_is_taken_is_named(client):
    with (
        pytest.raises(SettingError, match=f"^port {client.port}: cannot be used .*`port=`"),
        serve(Site(SECRET, b"", JobBoard(), None), client.port),
    ):
        pass


def test_the_port_is_free_again_after_the_page(site):
    with serve(site, 0) as address:
        port = Client(address).port
        assert Client(address).ask().status == 200
    with serve(site, port) as address:
        assert Client(address).port == port
