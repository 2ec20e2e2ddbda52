"""Rest cages that a page edits: what it may send, what is said of it, and what is written."""

import json
import os
import shutil
import threading
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.cli.group import spell_option
from cageik_cli.formats.open import load_mesh
from cageik_cli.run.settings import ViewSettings
from cageik_cli.util.errors import BusyError, CageikError, FormatError, InputError, SlowError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view import rest_cage
from cageik_cli.view.rest_cage import (
    describe_finding,
    encode_cage,
    list_polygons,
    open_rest_cage,
    parse_cage,
)
from cageik_cli.view.server import MAX_SUBMITTED_BYTES, JobBoard, Site, serve
from tests.view.client import Client

SECRET = "s" * 32
REST_CAGE = ViewSettings(
    Path("frames/frame_1.obj"), cage=Path("quads.obj"), output=Path("new.obj"), edits_cage=True
)
BROKEN = sorted((Path(__file__).resolve().parents[2] / "data_fixtures/broken").glob("cage_*"))
ODD = "0.1 -0.0 1e-7", "0.30000000000000004 2 2", "1234567.000000123 0.5 0.25"


@pytest.fixture
def quads(extracted, fixtures_folder):
    """A box of quads, with a name and a colour of the file's own."""
    shutil.copy(fixtures_folder / "broken/cage_quads/cage.obj", "quads.obj")


@pytest.fixture
def session(quads):
    opened = open_rest_cage(REST_CAGE, ProgressListener())
    yield opened
    opened.close()


@pytest.fixture
def client(session):
    site = Site(SECRET, b"", JobBoard(), session.parse, session.answers)
    with serve(site, 0) as address:
        yield Client(address)


def encode(mesh, **values):
    return encode_cage(mesh, **values).encode()


def read_quads():
    return load_mesh(Path("quads.obj")).mesh


def write(session, data):
    return session.parse(data, 0)(ProgressListener())


@pytest.mark.parametrize("folder", BROKEN, ids=lambda folder: folder.name)
def test_cages_that_are_not_fit_open_and_are_checked(folder):
    frame = folder / "frames/frame_1.obj"
    opened = open_rest_cage(
        ViewSettings(frame, cage=folder / "cage.obj", edits_cage=True), ProgressListener()
    )
    cage, rest = load_mesh(folder / "cage.obj").mesh, load_mesh(frame).mesh
    page = opened.render_page()
    assert encode(cage, name="cage.obj", most=2500).decode().removesuffix("}") in page
    assert not opened.can_apply
    diagnosis = diagnose(parse_cage(encode(cage)), rest)
    assert [found.kind for found in diagnosis.findings] == [
        found.kind for found in diagnose(cage, rest).findings
    ]
    for found in diagnosis.findings:
        told = describe_finding(found, cage, rest)
        assert f"{told['message']}; " + told["remedy"] == found.sentence
        assert "=" not in told["message"]
        json.dumps(told, allow_nan=False, default=str)


def test_a_finding_names_its_places_by_vertices(session):
    cage = read_quads()
    answer = session.check(encode(cage))
    assert (answer["verdict"], answer["findings"]) == ("fit", [])
    polygons = list_polygons(cage)[1:]
    body = json.dumps({"vertices": cage.vertices.tolist(), "polygons": polygons}).encode()
    (found,) = session.check(body)["findings"]
    assert (found["kind"], found["severity"]) == ("open-edge", "unfit")
    missing = set(list_polygons(cage)[0])
    assert len(found["edges"]) == 4
    assert set(np.ravel(found["edges"])) == missing
    small = {"vertices": (0.2 * cage.vertices).tolist(), "polygons": list_polygons(cage)}
    (found, *_) = session.check(json.dumps(small).encode())["findings"]
    assert found["kind"] == "outside"
    assert len(found["points"]) == 18


def test_weights_are_those_of_a_bind_or_its_sentence(session):
    cage = read_quads()
    assert set(session.solve(encode(cage))) == {"payload"}
    small = {"vertices": (0.2 * cage.vertices).tolist(), "polygons": list_polygons(cage)}
    with pytest.raises(CageikError, match="outside the cage"):
        session.solve(json.dumps(small).encode())


@pytest.mark.parametrize("name", ["new.obj", "new.ply"])
def test_numbers_that_were_not_touched_are_kept_to_the_last_bit(quads, name):
    lines = Path("quads.obj").read_text().splitlines()
    text = "\n".join([*(f"v {odd}" for odd in ODD), *lines[3:]])
    Path("quads.obj").write_text(text.replace("\nf ", "\nusemtl wood\nf ", 1) + "\n")
    before = read_quads()
    opened = open_rest_cage(replace(REST_CAGE, output=Path(name)), ProgressListener())
    rows = write(opened, encode(before))
    opened.close()
    after = load_mesh(Path(name)).mesh
    assert after.vertices.tobytes() == before.vertices.tobytes()
    assert list_polygons(after) == list_polygons(before)
    assert opened.written == (Path(name),)
    assert dict(rows)["cage"] == "8 vertices, 6 faces"
    assert (b"usemtl wood" in Path(name).read_bytes()) == name.endswith(".obj")


def test_quads_stay_quads_and_lost_names_are_told(quads):
    Path("quads.obj").write_text(Path("quads.obj").read_text().replace("f ", "usemtl wood\nf ", 1))
    cage = read_quads()
    opened = open_rest_cage(REST_CAGE, ProgressListener())
    first, *others = list_polygons(cage)
    polygons = [[*first[:3]], [first[0], *first[2:]], *others]
    body = json.dumps({"vertices": cage.vertices.tolist(), "polygons": polygons}).encode()
    rows = dict(write(opened, body))
    opened.close()
    assert rows["note"] == "faces were changed, so that 1 material are not written"
    assert rows["verdict"] == "fit"
    assert Path("new.obj").read_text().splitlines()[-7:] == [
        "f " + " ".join(str(k + 1) for k in polygon) for polygon in polygons
    ]


def test_a_cage_that_is_not_fit_is_written_with_its_faults(session):
    cage = read_quads()
    body = {"vertices": cage.vertices.tolist(), "polygons": list_polygons(cage)[1:]}
    rows = write(session, json.dumps(body).encode())
    assert ("verdict", "unfit") in rows
    assert any(label == "unfit" and "is open" in text for label, text in rows)


def test_files_that_changed_or_are_of_others_are_left(session):
    data = encode(read_quads())
    write(session, data)
    write(session, data)
    Path("new.obj").write_text("mine")
    with pytest.raises(InputError, match=r"^new\.obj: exists already"):
        write(session, data)
    assert Path("new.obj").read_text() == "mine"
    Path("new.obj").unlink()
    os.utime("quads.obj", ns=(0, 0))
    with pytest.raises(InputError, match=r"^quads\.obj: has changed since the page was opened"):
        write(session, data)
    assert not Path("new.obj").exists()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (replace(REST_CAGE, output=Path("new.fbx")), "new.fbx: `.fbx` is not a mesh format"),
        (replace(REST_CAGE, output=Path("quads.obj"), overwrite=True), "quads.obj: is read or"),
        (replace(REST_CAGE, cage=Path("none.obj")), "none.obj: "),
        (replace(REST_CAGE, target=Path("none.obj")), "none.obj: "),
    ],
)
def test_what_cannot_be_edited_or_written_is_refused(quads, settings, told):
    with pytest.raises(CageikError) as error:
        open_rest_cage(settings, ProgressListener())
    assert str(error.value).startswith(told)


def test_a_cage_that_is_too_large_is_refused(quads, monkeypatch):
    monkeypatch.setattr(rest_cage, "MAX_EDITED_VERTICES", 7)
    with pytest.raises(FormatError, match=r"^quads\.obj: the cage has 8 vertices, at most 7"):
        open_rest_cage(REST_CAGE, ProgressListener())


def test_a_cage_is_built_if_none_is_given(quads, coarse_grids):
    settings = replace(REST_CAGE, cage=None, build=BuildSettings(20))
    opened = open_rest_cage(settings, ProgressListener())
    assert '"name":"built cage"' in opened.render_page()


CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
FACES = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (b"", "is not JSON"),
        (b"\xff", "UTF-8"),
        (b"[" * 100_000, "levels deep"),
        (b"{}", "expected an object of vertices and polygons"),
        (b"[]", "expected an object"),
        (b'{"vertices": [], "polygons": []}', "vertices: is an empty list"),
        (b'{"vertices": 3, "polygons": []}', "vertices: is 3, expected a list"),
        (b'{"vertices": [1], "polygons": []}', "vertices[0]: is 1, expected a list"),
        (b'{"vertices": [[0, 0]], "polygons": [[0, 0, 0]]}', "vertices[0]: expected three"),
        (b'{"vertices": [[0, 0, NaN]], "polygons": [[0, 0, 0]]}', "is NaN"),
        (b'{"vertices": [[0, 0, 1e999]], "polygons": [[0, 0, 0]]}', "Infinity"),
        (b'{"vertices": [[0, 0, 1e60]], "polygons": [[0, 0, 0]]}', "three numbers up to 1e+50"),
        (b'{"vertices": [[0, 0, true]], "polygons": [[0, 0, 0]]}', "vertices[0]"),
        (b'{"vertices": [[0, 0, "0"]], "polygons": [[0, 0, 0]]}', "vertices[0]"),
        (json.dumps({"vertices": CORNERS, "polygons": []}).encode(), "polygons: is an empty list"),
        (json.dumps({"vertices": CORNERS, "polygons": [[0, 1]]}).encode(), "polygons[0]"),
        (json.dumps({"vertices": CORNERS, "polygons": [[0, 1, 4]]}).encode(), "from 0 to 3"),
        (json.dumps({"vertices": CORNERS, "polygons": [[0, 1, -1]]}).encode(), "polygons[0]"),
        (json.dumps({"vertices": CORNERS, "polygons": [[0, 1, 1.0]]}).encode(), "polygons[0]"),
        (json.dumps({"vertices": CORNERS, "polygons": [[0, 1, True]]}).encode(), "polygons[0]"),
        (
            json.dumps({"vertices": CORNERS, "polygons": FACES, "output": "/etc/passwd"}).encode(),
            "expected an object of vertices and polygons;",
        ),
        (
            json.dumps({"vertices": CORNERS * 700, "polygons": FACES}).encode(),
            "vertices: is a list of 2800, expected a list of 1 to 2500",
        ),
        (
            json.dumps({"vertices": CORNERS, "polygons": FACES * 2000}).encode(),
            "polygons: is a list of 8000",
        ),
        (
            json.dumps({"vertices": CORNERS, "polygons": [[0, 1, 2] * 7000]}).encode(),
            "polygons: have 21000 corners",
        ),
    ],
)
@pytest.mark.parametrize("path", ["check", "weights", "apply"])
def test_what_is_no_cage_is_refused(client, path, body, told):
    answer = client.ask(path, "POST", body)
    assert answer.status == 422
    assert told in answer.value["error"]
    assert not Path("new.obj").exists()


def test_a_sound_cage_is_taken(client):
    assert client.ask("check", "POST", encode(read_quads())).value["verdict"] == "fit"


@pytest.mark.parametrize("path", ["check", "weights", "apply"])
def test_strangers_are_refused(client, path):
    data = encode(read_quads())
    asked = [
        client.ask(f"/{SECRET[1:]}/{path}", "POST", data),
        client.ask(path, "POST", data, Origin="http://evil.example"),
        client.ask(path, "POST", data, Host="evil.example", Origin="http://evil.example"),
        client.ask(path, "POST", data, Sec_Fetch_Site="cross-site"),
    ]
    assert [answer.status for answer in asked] == [403] * 4
    assert client.ask(path, "POST", data, Content_Type="text/plain").status == 415
    assert client.ask(path, "POST", data, Content_Length=None).status == 411
    assert client.ask(f"{path}?x=1", "POST", data).status == 400
    assert client.ask(path).status == 404
    million = str(40 * 10**6)  # bytes of as many vertices
    assert int(million) > MAX_SUBMITTED_BYTES
    assert client.ask(path, "POST", b"", Content_Length=million).status == 413
    assert not Path("new.obj").exists()


def test_rounds_of_rotations_are_refused(client):
    answer = client.ask("apply?rigidity=3", "POST", encode(read_quads()))
    assert answer.status == 422
    assert "rigidity" in answer.value["error"]


def test_other_pages_have_no_checks():
    with serve(Site(SECRET, b"", JobBoard(), None), 0) as address:
        assert Client(address).ask("check", "POST", b"{}").status == 404


def test_sentences_are_worded_for_the_reader(session):
    site = Site(
        SECRET, b"", JobBoard(), None, session.answers, lambda text: text.replace("`outside=", "<")
    )
    cage = read_quads()
    small = {"vertices": (0.3 * cage.vertices).tolist(), "polygons": list_polygons(cage)}
    with serve(site, 0) as address:
        for path in ("check", "weights"):
            told = Client(address).ask(path, "POST", json.dumps(small).encode()).body.decode()
            assert "`outside=" not in told


def test_names_of_parts_are_not_taken_for_parameters(quads):
    inside, faces = 0.5 * read_quads().vertices, read_quads().faces + 1
    outside = inside.copy()
    outside[0] *= 2.2
    texts = []
    for k, (name, vertices) in enumerate({"`outside=x`": outside, "b": inside}.items()):
        texts += [f"o {name}", *("v {} {} {}".format(*row) for row in vertices)]
        texts += ["f {} {} {}".format(*row) for row in faces + k * len(inside)]
    Path("parts.obj").write_text("\n".join(texts))
    opened = open_rest_cage(replace(REST_CAGE, target=Path("parts.obj")), ProgressListener())
    site = Site(SECRET, b"", JobBoard(), None, opened.answers, spell_option)
    with closing(opened), serve(site, 0) as address:
        (found,) = Client(address).ask("check", "POST", encode(read_quads())).value["findings"]
    assert found["kind"] == "outside"
    assert "`outside=x`" in found["sentence"]
    assert found["sentence"].endswith("drag it out, or Repair")


class Slow:
    """A process whose work never ends."""

    is_ended = False

    def call(self, work, cage, seconds):
        time.sleep(seconds)
        raise TimeoutError

    def end(self):
        self.is_ended = True


def test_a_check_that_takes_too_long_is_ended(session, client, monkeypatch):
    monkeypatch.setattr(rest_cage, "MAX_CHECK_SECONDS", 0.05)
    process = session.subprocess._process = Slow()
    data = encode(read_quads())
    with pytest.raises(SlowError, match=r"more than 0\.05 seconds and was ended"):
        session.check(data)
    assert process.is_ended
    session.subprocess._process = Slow()
    assert client.ask("check", "POST", data).status == 503
    monkeypatch.setattr(rest_cage, "MAX_CHECK_SECONDS", 20.0)
    assert session.check(data)["verdict"] == "fit"


def test_a_check_that_really_takes_long_is_ended(session, monkeypatch):
    monkeypatch.setattr(rest_cage, "MAX_CHECK_SECONDS", 0.001)
    with pytest.raises(SlowError):
        session.check(encode(read_quads()))
    monkeypatch.setattr(rest_cage, "MAX_CHECK_SECONDS", 20.0)
    assert session.check(encode(read_quads()))["verdict"] == "fit"


def test_of_checks_at_the_same_time_one_is_made(session, client, monkeypatch):
    monkeypatch.setattr(rest_cage, "MAX_CHECK_SECONDS", 1.0)
    session.subprocess._process = Slow()
    data, answers = encode(read_quads()), []

    def ask():
        answers.append(client.ask("check", "POST", data).status)

    threads = [threading.Thread(target=ask) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(answers) == [409] * 5 + [503]


def test_one_cage_waits_for_none(session, monkeypatch):
    session.subprocess._lock.acquire()
    with pytest.raises(BusyError):
        session.check(encode(read_quads()))
    session.subprocess._lock.release()


def test_too_many_weights_for_the_page_are_refused(session, monkeypatch):
    monkeypatch.setattr("cageik_cli.view.player.section.MAX_WEIGHTS", 50)
    with pytest.raises(FormatError, match="too many for the page, at most 5"):
        session.solve(encode(read_quads()))
