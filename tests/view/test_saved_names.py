"""Names of new files that a page sends: nothing but a new file beside what is viewed is written."""

import json
import os
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.run.settings import ViewSettings
from cageik_cli.util.errors import CageikError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view.rest_cage import encode_cage, open_rest_cage
from cageik_cli.view.run import ViewListener, run_view
from cageik_cli.view.saved_names import MAX_NAME_BYTES, NewFiles
from cageik_cli.view.server import MAX_SUBMITTED_BYTES, JobBoard, Site, serve
from cageik_cli.view.session import open_session
from tests.view.client import Client

SECRET = "s" * 32
HANDLES = {"handles": [{"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]}]}
RESULT = ViewSettings(Path("cages.h5"))
CAGE = ViewSettings(Path("cages.h5"), edits_cage=True)

NO_NAMES = [
    "../new.h5", "..", ".", "", "/tmp/new.h5", "a/new.h5", "a\\new.h5", "C:new.h5", "new\0.h5",
    "new.h5\0.obj", ".new.h5", "-o.h5", "~new.h5", " new.h5", "new.h5 ", "new\n.h5", "new\x1b.h5",
    "new", "new.txt", "new.h5.", "new.h5/", "nul.h5", "COM1.h5", "new*.h5", "\ud800.h5",
    "n" * (MAX_NAME_BYTES - 2) + ".h5", "ä" * (MAX_NAME_BYTES // 2) + ".h5", "n" * 100_000 + ".h5",
    None, 3, True, [], ["new.h5"], {"name": "new.h5"}, 1e300,
]  # fmt: skip


def files():
    """All names here, and what is in files."""
    found = {}
    for folder in (Path(), Path("..")):
        for path in folder.iterdir():
            found[path] = path.read_bytes() if path.is_file() else os.path.lexists(path)
    return found


def open_(settings):
    opener = open_rest_cage if settings.edits_cage else open_session
    return opener(settings, ProgressListener())


def make_body(name, **changes):
    edit = {"handles": HANDLES, "cageEdits": None, "rigidity": 0, "name": name}
    return json.dumps(edit | changes).encode()


def make_cage_body(session, name):
    return encode_cage(session._cage, name=name).encode()


@pytest.fixture(params=["save", "save a cage", "extract"])
def asked(request, extracted):
    """A client, the address that takes a name there, and what makes a body of a name."""
    session = open_(RESULT if request.param == "save" else CAGE)
    site = Site(SECRET, b"", JobBoard(), None, session.answers, jobs=session.jobs)
    path = request.param.split()[0]

    def make(name):
        return (
            make_body(name)
            if path == "save" and session.settings == RESULT
            else (make_cage_body(session, name))
        )

    with closing(session), serve(site, 0) as address:
        suffix = ".obj" if request.param == "save a cage" else ".h5"
        yield Client(address), path, make, suffix


@pytest.mark.parametrize("name", NO_NAMES, ids=lambda name: repr(name)[:20])
def test_what_is_no_plain_name_is_refused(asked, name):
    client, path, make, _ = asked
    before = files()
    answer = client.ask(path, "POST", make(name))
    assert answer.status == 422
    assert "name: is" in answer.value["error"] or "surrogate" in answer.value["error"]
    assert files() == before
    assert client.status()["state"] == "idle"


@pytest.mark.parametrize("kind", ["file", "folder", "link", "link to nothing"])
def test_what_exists_is_refused_be_it_a_link_to_nothing(asked, kind):
    client, path, make, suffix = asked
    taken = Path(f"taken{suffix}")
    {
        "file": lambda: taken.write_bytes(b"mine"),
        "folder": taken.mkdir,
        "link": lambda: taken.symlink_to("cages.h5"),
        "link to nothing": lambda: taken.symlink_to("elsewhere"),
    }[kind]()
    before = files()
    answer = client.ask(path, "POST", make(taken.name))
    assert answer.status == 422
    assert f"exists already; choose another name, such as taken-2{suffix}" in answer.value["error"]
    assert files() == before


def test_strangers_are_refused(asked):
    client, path, make, suffix = asked
    data, before = make(f"new{suffix}"), files()
    answers = [
        client.ask(f"/{SECRET[1:]}/{path}", "POST", data),
        client.ask(path, "POST", data, Origin="http://evil.example"),
        client.ask(path, "POST", data, Host="evil.example", Origin="http://evil.example"),
        client.ask(path, "POST", data, Sec_Fetch_Site="cross-site"),
    ]
    assert [answer.status for answer in answers] == [403] * 4
    assert client.ask(path, "POST", data, Content_Type="text/plain").status == 415
    assert client.ask(path, "POST", data, Content_Length=None).status == 411
    assert client.ask(path, "POST", b"", Content_Length=str(MAX_SUBMITTED_BYTES + 1)).status == 413
    assert client.ask(f"{path}?rigidity=1", "POST", data).status == 400
    assert client.ask(f"{path}?name=new{suffix}", "POST", data).status == 400
    assert client.ask(path).status == 404
    assert client.ask(path, "PUT", data).status == 501
    for body in (b"", b"{}", b"[]", b"null", b"\xff", b"[" * 100_000, data + b"x", data[:-1]):
        assert client.ask(path, "POST", body).status == 422
    for field in ('"output": "x"', '"name": "twice.h5"', '"overwrite": true'):
        assert client.ask(path, "POST", data[:-1] + f", {field}}}".encode()).status == 422
    assert files() == before
    assert client.status()["state"] == "idle"


def test_of_two_at_once_one_is_taken(asked):
    client, path, make, suffix = asked
    answers = []
    threads = [
        threading.Thread(
            target=lambda k=k: answers.append(client.ask(path, "POST", make(f"{k}{suffix}")).status)
        )
        for k in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [202] + 5 * [409]


@pytest.mark.parametrize("rigidity", [-1, 1001, 1.5, True, "1", None])
def test_other_rounds_are_refused(extracted, rigidity):
    session = open_(RESULT)
    with pytest.raises(CageikError, match=r"^rigidity: is .*, expected a whole number up to 1000"):
        session.jobs["save"](make_body("new.h5", rigidity=rigidity))


def test_an_edit_is_saved_as_a_new_file_and_nothing_else(extracted, run):
    Path("handles.json").write_text(json.dumps(HANDLES))
    words = ("pose", "cages.h5", "handles.json", "--rigidity", 2, "-o", "reference.h5", "-q")
    assert run(*words).code == 0
    before, session = files(), open_(RESULT)
    session.jobs["save"](make_body("new.h5", rigidity=2))(ProgressListener())
    after = files()
    assert after.keys() - before.keys() == {Path("new.h5")}
    assert {path: after[path] for path in before} == before
    assert session.written == (Path("new.h5"),)
    with h5py.File("new.h5") as saved, h5py.File("reference.h5") as reference:
        np.testing.assert_array_equal(saved["verts"][:], reference["verts"][:])


def test_a_file_that_comes_to_be_meanwhile_is_left(extracted):
    session = open_(RESULT)
    edit = session.jobs["save"](make_body("new.h5"))
    Path("new.h5").write_bytes(b"mine")
    with pytest.raises(CageikError, match=r"^new\.h5: exists already"):
        edit(ProgressListener())
    assert Path("new.h5").read_bytes() == b"mine"


def test_new_files_are_beside_what_is_viewed_wherever_that_is(extracted):
    Path("other").mkdir()
    Path("cages.h5").rename("other/cages.h5")
    session = open_(ViewSettings(Path("other/cages.h5")))
    assert session.describe()["save"] == "cages-2.h5"
    session.jobs["save"](make_body("new.h5"))(ProgressListener())
    assert Path("other/new.h5").exists()
    assert not Path("new.h5").exists()


def test_with_an_output_nothing_else_is_saved(extracted):
    session = open_(replace(RESULT, output=Path("edited.h5")))
    assert "save" not in session.jobs
    assert session.describe()["save"] is None


def test_names_that_are_proposed_are_free(folder):
    new_files = NewFiles(Path("walker.h5"), [".h5"], lambda path: [path.with_suffix(".obj")])
    assert new_files.propose() == "walker-2.h5"
    Path("walker-2.h5").touch()
    Path("walker-3.obj").symlink_to("nowhere")
    assert new_files.propose() == "walker-4.h5"
    assert new_files.check("walker-4.h5") == Path("walker-4.h5")
    odd = NewFiles(Path("../x/\udcff a\u202e<b>.h5"), [".obj", ".ply"])
    name = odd.propose()
    assert odd.check(name) == Path("../x") / name


class Listener(ViewListener):
    """Saves once, and stops."""

    def open(self, address):
        self.client = Client(address)
        assert self.client.ask("save", "POST", make_body("new.h5")).status == 202

    def show_applied(self, rows, written):
        self.written, self.status = written, self.client.status()
        raise KeyboardInterrupt

    def show_failed(self, error):
        self.written = error
        raise KeyboardInterrupt


def test_a_page_without_an_output_saves(extracted):
    listener = Listener()
    with pytest.raises(KeyboardInterrupt):
        run_view(open_(RESULT), 0, listener)
    assert listener.written == (Path("new.h5"),)
    assert listener.status["written"] == ["new.h5"]


def test_the_same_file_has_the_same_port_and_another_if_that_is_taken(extracted):
    ports = []

    class Opener(ViewListener):
        def open(self, address):
            ports.append(Client(address).port)
            if len(ports) == 2:
                with pytest.raises(KeyboardInterrupt):
                    run_view(open_(RESULT), 0, self)
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            run_view(open_(RESULT), 0, Opener())
    assert ports[0] == ports[1] >= 49152
    assert ports[2] != ports[0]
