"""What was before, as a page asks for it: whose frames they are, and what strangers get."""

import json
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh
from cageik_cli.inputs.input_frames import find_edited
from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.run.settings import ViewSettings
from cageik_cli.store.result import read_animation, read_binding, read_result
from cageik_cli.util.errors import CageikError, FileAccessError, FormatError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view import before
from cageik_cli.view.before import MAX_ASKED_BYTES, MAX_ASKED_FRAMES, BeforeFrames, list_before
from cageik_cli.view.player.clip import require_player_clip
from cageik_cli.view.player.section import render_player_page
from cageik_cli.view.server import JobBoard, Site, Stream, serve
from cageik_cli.view.session import open_session
from tests.view.client import Client
from tests.view.test_session import DATA

SECRET = "s" * 32
COUNT = 5
"""Frames of the clip."""


def open_before(name="cages.h5"):
    shown = read_animation(Path(name))
    return BeforeFrames(shown, require_player_clip(shown, "a page"))


def make_request(kind="input", first=0, count=COUNT):
    return json.dumps({"kind": kind, "first": first, "count": count}).encode()


def read_frames(frames, *words):
    """Return what is answered, (k, m, 3), in the units of the file."""
    stream = frames.answer(make_request(*words))
    data = b"".join(stream.parts)
    assert len(data) == stream.size
    placed = np.frombuffer(data, "<f4").reshape(-1, len(frames._chosen), 3).astype(float)
    return placed * frames._diagonal + frames._origin


def rebuild(name):
    """Return the meshes of a result or an edit, (F, m, 3)."""
    shown = read_animation(Path(name))
    binding = read_binding(shown)
    meshes = Reconstruction(binding, CageFrames.from_result(shown, binding))
    return np.stack([meshes.read_frame(k) for k in range(len(meshes))])


@pytest.fixture
def edited(extracted, run):
    """The result of a clip, an edit of it, and an edit of that."""
    Path("handles.json").write_bytes(DATA)
    assert run("pose", "cages.h5", "handles.json", "-o", "edit.h5", "-q").code == 0
    assert run("pose", "edit.h5", "handles.json", "-o", "twice.h5", "-q").code == 0


def load_input():
    return np.stack([load_mesh(f"frames/frame_{k}.obj").mesh.vertices for k in range(1, COUNT + 1)])


def test_the_input_is_that_of_the_files(extracted):
    frames, files = open_before(), load_input()
    np.testing.assert_allclose(read_frames(frames), files, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read_frames(frames, "input", 2, 2), files[2:4], rtol=0, atol=1e-6)
    assert len(read_frames(frames, "input", COUNT - 1, 30)) == 1


@pytest.mark.parametrize(("name", "source"), [("edit.h5", "cages.h5"), ("twice.h5", "edit.h5")])
def test_what_an_edit_was_made_from_is_its_source(edited, name, source):
    frames = open_before(name)
    found = read_frames(frames, "unedited")
    np.testing.assert_allclose(found, rebuild(source), rtol=0, atol=1e-6)
    assert np.abs(found - rebuild(name)).max() > 0.01
    # The input is that of the result at the beginning.
    np.testing.assert_allclose(read_frames(frames), load_input(), rtol=0, atol=1e-6)


def test_a_page_says_what_it_can_ask_for(edited):
    assert list_before(read_animation(Path("cages.h5"))) == ("input",)
    assert list_before(read_animation(Path("edit.h5"))) == ("unedited", "input")


def test_frames_that_were_skipped_have_none(extracted, run):
    Path("frames/frame_3.obj").unlink()
    words = ("frames", "--cage", "cage.obj", "--allow-gaps", "--overwrite", "-q")
    assert run("extract", *words).code == 0
    found = read_frames(open_before())
    assert np.isnan(found[2]).all()
    assert np.isfinite(found[[0, 1, 3, 4]]).all()


def test_vertices_that_are_missing_are_where_the_cage_puts_them(extracted):
    frames = open_before()
    frames.answer(make_request())
    meshes = frames._opened["input"]
    whole = meshes.read(1)
    meshes._inputs.read_frame = lambda _: np.where(np.arange(len(whole))[:, None] == 4, np.nan, 7.0)
    found = meshes.read(1)
    np.testing.assert_array_equal(found[4], rebuild("cages.h5")[1][4])
    assert (np.delete(found, 4, axis=0) == 7).all()


def hide_input():
    Path("deep").mkdir()
    shutil.move("frames", "deep/frames")


def change_input():
    path = Path("frames/frame_2.obj")
    path.write_text(path.read_text().replace("v ", "v  ", 1))


@pytest.mark.parametrize("spoil", [hide_input, change_input])
def test_an_input_that_is_not_there_or_another_is_not_shown(extracted, spoil):
    spoil()
    with pytest.raises(FileAccessError, match=r"frame_1.*is not beside cages\.h5.*put it there"):
        open_before().answer(make_request())


def test_an_input_that_changes_later_is_not_shown(extracted):
    frames = open_before()
    assert len(read_frames(frames)) == COUNT
    change_input()
    assert len(read_frames(frames, "input", 2, 3)) == 3
    with pytest.raises(FileAccessError, match="has changed since the page was opened"):
        frames.answer(make_request("input", 1, 1))


def test_a_result_that_changes_later_is_not_read(edited):
    frames = open_before("edit.h5")
    read_frames(frames, "unedited")
    Path("cages.h5").write_bytes(Path("cages.h5").read_bytes() + b"more")
    with pytest.raises(FileAccessError, match=r"cages\.h5: has changed"):
        frames.answer(make_request("unedited"))


@pytest.mark.parametrize("kind", ["unedited", "input"])
def test_a_source_of_an_edit_that_is_gone_is_said(edited, kind):
    Path("cages.h5").unlink()
    with pytest.raises(FileAccessError, match=r"cages\.h5, which edit\.h5 was made from, is not"):
        open_before("edit.h5").answer(make_request(kind))


def test_a_source_of_another_content_is_not_taken(edited):
    assert find_edited(read_animation(Path("edit.h5"))).path.name == "cages.h5"
    shutil.copy("twice.h5", "cages.h5")
    assert find_edited(read_animation(Path("edit.h5"))) is None


@pytest.mark.parametrize("name", ["../secret.h5", "sub/cages.h5", "/etc/passwd", ".", ""])
def test_a_name_that_leads_elsewhere_is_left_alone(edited, name):
    """As an edit from a stranger may have it, with the right digest."""
    Path("sub").mkdir()
    for place in ("../secret.h5", "sub/cages.h5"):
        shutil.copy("cages.h5", place)
    with h5py.File("edit.h5", "r+") as file:
        sources = json.loads(file.attrs["sources"])
        sources["result"]["name"] = name
        file.attrs["sources"] = json.dumps(sources)
    assert find_edited(read_animation(Path("edit.h5"))) is None


@pytest.mark.parametrize(
    "body",
    [
        *(b"", b"{", b"[]", b"null", b"\xff", b"[" * 1000),
        *(b'{"kind": "input", "first": 0}', b'{"kind": "input", "first": 0, "count": 1, "a": 1}'),
        *(make_request(kind) for kind in ("unedited", "live", "../frames", "", None, 1, [], {})),
        *(make_request("input", first) for first in (-1, COUNT, 1e9, 0.0, True, "0", None)),
        *(make_request("input", 0, count) for count in (0, -1, MAX_ASKED_FRAMES + 1, 2.0, None)),
    ],
)
def test_what_is_no_request_is_refused(extracted, body):
    with pytest.raises(FormatError):
        open_before().answer(body)


def test_an_answer_is_bounded(extracted, monkeypatch):
    frames = open_before()
    size = len(read_frames(frames, "input", 0, 1)[0]) * 12
    monkeypatch.setattr(before, "MAX_STREAM_BYTES", 2 * size + 1)
    assert len(read_frames(frames)) == 2
    monkeypatch.setattr(before, "MAX_STREAM_BYTES", 1)
    assert len(read_frames(frames)) == 1


def test_one_frame_is_read_at_a_time(extracted):
    """Frames are read while they are sent, and none that was not asked for."""
    frames, read = open_before(), []
    frames.answer(make_request())
    meshes = frames._opened["input"]
    inner = meshes.read
    meshes_read = lambda frame: read.append(frame) or inner(frame)  # noqa: E731
    frames._opened["input"] = type("Meshes", (), {"read": staticmethod(meshes_read)})()
    stream = frames.answer(make_request("input", 1, 3))
    assert read == [1]
    next(stream.parts), next(stream.parts)
    assert read == [1, 2]


@pytest.fixture
def client(extracted):
    session = open_session(ViewSettings(Path("cages.h5")), ProgressListener())
    site = Site(SECRET, b"", JobBoard(), None, streams=session.streams)
    with serve(site, 0) as address:
        yield Client(address)


def test_the_page_gets_frames(client):
    answer = client.ask("before", "POST", make_request())
    assert answer.status == 200
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["cache-control"] == "no-store"
    assert answer.headers["cross-origin-resource-policy"] == "same-origin"
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert "access-control-allow-origin" not in answer.headers
    assert len(answer.body) == int(answer.headers["content-length"]) == COUNT * 18 * 12
    # More than fits at once is no more work: the next is answered as well.
    assert client.ask("before", "POST", make_request("input", 2, 1)).status == 200


def test_strangers_get_no_frames(client):
    body = make_request()
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"},
                    {"Sec-Fetch-Site": "cross-site"}):  # fmt: skip
        assert client.ask("before", "POST", body, **headers).status == 403
    for path in ("/before", f"/{SECRET[1:]}/before", f"/{SECRET}x/before"):
        assert client.ask(path, "POST", body).status == 403
    assert client.ask("before").status == 404
    assert client.ask("before/input", "POST", body).status in (403, 404)


def test_bodies_of_requests_are_small(client):
    assert client.ask("before?first=1", "POST", make_request()).status == 400
    assert client.ask("before", "POST", make_request(), Content_Type="text/plain").status == 415
    padded = make_request().ljust(MAX_ASKED_BYTES)
    assert client.ask("before", "POST", padded).status == 200
    answer = client.ask("before", "POST", padded + b" ")
    assert (answer.status, answer.value) == (413, {"error": "what is sent has at most 1024 bytes"})
    huge = client.make_request("before", "POST", Content_Length="9" * 30)
    assert client.send(huge).status == 413


def test_refusals_say_why(client):
    answer = client.ask("before", "POST", make_request("unedited"))
    assert (answer.status, answer.value) == (422, {"error": 'kind: is "unedited", expected input'})
    hide_input()
    answer = client.ask("before", "POST", make_request())
    assert answer.status == 422
    assert "put it there, or run cageik view in its folder" in answer.value["error"]


def serve_stream(make):
    return serve(Site(SECRET, b"", JobBoard(), None, streams={"before": (99, make)}), 0)


def test_a_second_answer_is_refused_meanwhile():
    started, go = threading.Event(), threading.Event()

    def yield_parts():
        yield b"first"
        started.set()
        assert go.wait(20)
        yield b"last"

    with serve_stream(lambda _: Stream(9, yield_parts())) as address:
        client, answers = Client(address), []
        ask = lambda: answers.append(client.ask("before", "POST", b"{}"))  # noqa: E731
        thread = threading.Thread(target=ask)
        thread.start()
        assert started.wait(20)
        assert client.ask("before", "POST", b"{}").status == 409
        go.set()
        thread.join()
        assert answers[0].body == b"firstlast"


@pytest.mark.parametrize("error", [CageikError("gone"), ZeroDivisionError("a fault")])
def test_an_answer_that_fails_on_its_way_ends_there(error):
    """It is shorter than its head says, so that no browser takes it for the whole."""

    def yield_parts():
        yield b"first"
        raise error

    with serve_stream(lambda _: Stream(9, yield_parts())) as address:
        client = Client(address)
        answer = client.ask("before", "POST", b"{}")
        assert (answer.status, answer.headers["content-length"]) == (200, "9")
        assert answer.body == b"first"
        assert client.ask("before", "POST", b"{}").status == 200  # the turn is free again


def test_only_a_page_of_a_result_asks(extracted):
    settings = ViewSettings(Path("cages.h5"))
    with_result = open_session(settings, ProgressListener())
    assert "connect-src 'self'" in with_result.render_page()
    model = replace(settings, target=Path("frames/frame_1.obj"), cage=Path("cage.obj"))
    of_model = open_session(model, ProgressListener())
    assert of_model.streams == {}
    assert "connect-src" not in render_player_page(read_result(Path("cages.h5")))
