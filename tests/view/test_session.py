"""The edits of a page: what they write, and that nothing else is written or lost."""

import json
import os
import shutil
import threading
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.open import load_mesh
from cageik_cli.inputs.settings import WeightSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.run.settings import ViewSettings
from cageik_cli.util import outputs
from cageik_cli.util.errors import CageikError, InputError, format_error
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view.player.section import render_view_page
from cageik_cli.view.run import ViewListener, run_view
from cageik_cli.view.server import MAX_SUBMITTED_BYTES, JobBoard
from cageik_cli.view.session import open_session, split_submitted
from tests.view.client import Client, make_body

LIFT = {"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]}
PINS = [{"name": f"pin {k}", "vertex": k, "pin": True} for k in (3, 7, 11, 15)]
DOCUMENT = {"handles": [LIFT, *PINS]}
EDITS = {"edits": [{"name": "tip", "moves": [{"vertex": 0, "offset": [0.1, 0.2, -0.3]}]}]}
DATA = json.dumps(DOCUMENT).encode()
CLIP = ViewSettings(Path("cages.h5"), output=Path("edited.h5"), handles_output=Path("h.json"))
MODEL = ViewSettings(
    Path("frames/frame_1.obj"),
    cage=Path("cage.obj"),
    output=Path("posed.obj"),
    cage_output=Path("posed_cage.obj"),
    handles_output=Path("h.json"),
)


@pytest.fixture
def clip(extracted):
    Path("handles.json").write_bytes(DATA)


def apply(session, handles=DOCUMENT, rigidity=0, cage_edits=None):
    return session.parse(make_body(handles, cage_edits), rigidity)(ProgressListener())


def open_(settings):
    return open_session(settings, ProgressListener())


def files():
    """All files here and what they hold."""
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}


def cages(name):
    with h5py.File(name) as file:
        return file["verts"][:]


def test_what_is_kept_of_poses_is_not_that_of_cages(clip):
    """A browser offers the work on a page by its key."""
    pose = ViewSettings(MODEL.target, cage=MODEL.cage)
    with closing(open_(pose)) as posed, closing(open_(replace(pose, edits_cage=True))) as edited:
        assert posed.key != edited.key
        with closing(open_(pose)) as again:
            assert posed.key == again.key


@pytest.mark.parametrize("rigidity", [0, 5])
def test_an_edit_of_a_result_is_that_of_the_command(clip, run, rigidity):
    words = ("--rigidity", rigidity, "-o", "reference.h5", "-q")
    assert run("pose", "cages.h5", "handles.json", *words).code == 0
    before = files()
    apply(open_(CLIP), rigidity=rigidity)
    assert files().keys() - before.keys() == {Path("edited.h5"), Path("h.json")}
    assert files().items() >= before.items()
    np.testing.assert_array_equal(cages("edited.h5"), cages("reference.h5"))
    assert json.loads(Path("h.json").read_bytes()) == DOCUMENT
    assert "edited by h.json: " in run("info", "edited.h5").out + run("report", "edited.h5").out


def test_a_pose_of_a_model_is_that_of_the_command(clip, run):
    words = ("--cage", "cage.obj", "-o", "reference.obj", "--cage-out", "reference_cage.obj", "-q")
    assert run("pose", "frames/frame_1.obj", "handles.json", *words).code == 0
    apply(open_(MODEL))
    assert Path("posed.obj").read_bytes() == Path("reference.obj").read_bytes()
    assert Path("posed_cage.obj").read_bytes() == Path("reference_cage.obj").read_bytes()
    assert json.loads(Path("h.json").read_bytes()) == DOCUMENT


def test_bindings_give_the_same_pose(clip, run):
    """Of a binding file alone, or with its model, which keeps the text of its file."""
    apply(open_(MODEL))
    bind = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj", "-o", "b.h5")
    assert run(*bind).code == 0
    of_both = replace(MODEL, cage=None, binding=Path("b.h5"), output=Path("1.obj"))
    alone = ViewSettings(Path("b.h5"), output=Path("2.obj"))
    apply(open_(replace(of_both, cage_output=None, handles_output=None)))
    apply(open_(alone))
    expected = load_mesh(Path("posed.obj")).mesh.vertices
    for name in ("1.obj", "2.obj"):
        np.testing.assert_allclose(load_mesh(Path(name)).mesh.vertices, expected, atol=1e-9)


def test_a_binding_of_another_model_is_refused(clip, run):
    bind = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_2.obj", "-o", "b.h5")
    assert run(*bind, "--outside", "project").code == 0
    with pytest.raises(InputError, match=r"^b\.h5: is the binding of another rest pose"):
        open_(replace(MODEL, cage=None, binding=Path("b.h5")))


@pytest.mark.parametrize(
    ("changes", "title", "command"),
    [
        ({}, "frame_1.obj", "frame_1.obj --cage cage.obj"),
        ({"target": Path("my \udcff.obj")}, "my \ufffd.obj", "'my \ufffd.obj' --cage cage.obj"),
        (
            {"weights": WeightSettings(BindSettings("mean-value", "fine"))},
            "frame_1.obj",
            "frame_1.obj --cage cage.obj --coordinates mean-value --accuracy fine",
        ),
        ({"cage": None, "binding": Path("b.h5")}, "b.h5", "b.h5"),
        (
            {"cage": None, "build": BuildSettings(20)},
            "frame_1.obj",
            "frame_1.obj --cage CAGE.obj",
        ),
    ],
)
def test_the_page_names_the_words_of_the_command(clip, run, coarse_grids, changes, title, command):
    shutil.copy("frames/frame_1.obj", "my \udcff.obj")
    bind = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj", "-o", "b.h5")
    assert run(*bind).code == 0
    shown = open_(replace(MODEL, **changes)).clip
    assert (shown.title, shown.target) == (title, command)
    render_view_page(shown).encode()


@pytest.mark.parametrize("settings", [CLIP, MODEL])
def test_cage_edits_are_those_of_the_command(clip, run, settings):
    """With handles after them, and alone; what was saved of an edit before goes with it."""
    saved = Path("c.json")
    session = open_(replace(settings, cage_edits_output=saved))
    Path("edits.json").write_text(json.dumps(EDITS))
    cage = () if settings is CLIP else ("--cage", "cage.obj")
    reference = Path("reference").with_suffix(settings.output.suffix)
    words = ("pose", settings.target, *cage, "--cage-edits", "edits.json", "-o", reference, "-q")
    for handles in ((), ("handles.json",), ()):
        assert run(*words, *handles, "--overwrite").code == 0
        apply(session, DOCUMENT if handles else None, cage_edits=EDITS)
        assert json.loads(saved.read_text()) == EDITS
        assert settings.handles_output.exists() == bool(handles)
        assert session.written[-1] == saved
        if settings is CLIP:
            np.testing.assert_array_equal(cages(settings.output), cages(reference))
        else:
            assert settings.output.read_bytes() == reference.read_bytes()
    apply(session)
    assert not saved.exists()


@pytest.mark.parametrize("settings", [CLIP, MODEL])
@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"moves": [{"vertex": 500, "offset": [0, 0, 0]}]}, "vertex 500: there is no such cage"),
        ({"frames": [0, 99]}, "frames: "),
    ],
)
def test_cage_edits_that_do_not_fit_leave_all_files(clip, settings, changes, told):
    wrong = {"edits": [EDITS["edits"][0] | changes]}
    Path("edits.json").write_text(json.dumps(wrong))
    with pytest.raises(InputError, match=r"^edits\.json: edit 'tip': "):
        open_(replace(settings, cage_edits=Path("edits.json")))
    session = open_(settings)
    apply(session)
    before = files()
    with pytest.raises(InputError, match=r"^cage edits of the page: edit 'tip': ") as error:
        apply(session, None, cage_edits=wrong)
    assert told in str(error.value)
    assert files() == before


def test_a_page_begins_with_cage_edits(clip):
    same = Path("edits.json")
    same.write_text(json.dumps(EDITS))
    session = open_(replace(CLIP, cage_edits=same, cage_edits_output=same, overwrite=True))
    assert json.loads(session.first_cage_edits) == EDITS
    with pytest.raises(CageikError, match="by this command already"):
        open_(replace(CLIP, cage_edits=same, cage_edits_output=same))
    with pytest.raises(CageikError, match=r"cage edits are written as \.json"):
        open_(replace(CLIP, cage_edits_output=Path("c.txt")))


@pytest.mark.parametrize("settings", [CLIP, MODEL])
def test_edits_replace_those_before_them(clip, settings):
    session = open_(settings)
    apply(session)
    first = files()
    second = {"handles": [LIFT | {"offset": [0, 0.4, 0]}, *PINS]}
    apply(session, second)
    changed = {path for path, data in files().items() if first[path] != data}
    assert changed == {*settings.outputs()}
    apply(session)
    assert files() == first


@pytest.mark.parametrize("settings", [CLIP, MODEL])
@pytest.mark.parametrize("k", [0, 1])
def test_a_file_of_someone_else_is_not_replaced(clip, settings, k):
    """Written while the page is open, before the first edit or between two."""
    foreign = settings.outputs()[k]
    session = open_(settings)
    foreign.write_text("mine")
    before = files()
    with pytest.raises(InputError, match=f"^{foreign}: exists already"):
        apply(session)
    assert files() == before
    foreign.unlink()
    apply(session)
    foreign.write_text("mine")
    before = files()
    with pytest.raises(InputError, match=f"^{foreign}: exists already"):
        apply(session)
    assert files() == before


@pytest.mark.parametrize("settings", [CLIP, MODEL])
def test_what_another_program_writes_during_an_edit_stays(clip, settings, monkeypatch):
    """Also during the second edit, when the output is one that this run may replace."""
    session = open_(settings)
    apply(session)
    foreign = settings.output

    def solve_slowly(*arguments, solve=session._solve):
        monkeypatch.setattr(outputs, "_rename_into_place", rename_late)
        return solve(*arguments)

    def rename_late(path, new, overwrite, rename=outputs._rename_into_place):
        if path == foreign:
            foreign.unlink()
            foreign.write_text("mine")
        rename(path, new, overwrite)

    monkeypatch.setattr(session, "_solve", solve_slowly)
    with pytest.raises(InputError, match=f"^{foreign}: another run has written it meanwhile"):
        apply(session)
    assert foreign.read_text() == "mine"


@pytest.mark.parametrize("settings", [CLIP, MODEL])
def test_outputs_that_exist_are_refused_before_any_work(clip, settings):
    for path in settings.outputs():
        path.write_text("mine")
        with pytest.raises(InputError, match=f"^{path}: exists already"):
            open_(settings)
        assert open_(replace(settings, overwrite=True)).can_apply
        assert path.read_text() == "mine"
        path.unlink()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (replace(CLIP, output=Path("edited.obj")), "edited.obj: the output is an HDF5 file"),
        (replace(CLIP, output=Path("cages.h5"), overwrite=True), "cages.h5: is read or written"),
        (replace(CLIP, handles_output=Path("h.txt")), "h.txt: handles are written as .json"),
        (replace(CLIP, handles_output=Path("edited.h5")), "edited.h5: is read or written"),
        (replace(CLIP, output=Path("no/edited.h5")), "no/edited.h5: the folder no does not exist"),
        (
            replace(CLIP, handles=Path("handles.json"), handles_output=Path("handles.json")),
            "handles.json: is read or written",
        ),
        (replace(MODEL, output=Path("posed.fbx")), "posed.fbx: `.fbx` is not a mesh format"),
        (replace(MODEL, cage_output=Path("cage.obj"), overwrite=True), "cage.obj: is read or"),
        (replace(MODEL, target=Path("none.obj")), "none.obj: "),
        (replace(MODEL, cage=Path("none.obj")), "none.obj: "),
        (ViewSettings(Path("none.h5")), "none.h5: "),
        (ViewSettings(Path("frames")), "frames: is a folder, expected a model, a binding or a"),
        (ViewSettings(Path("bare.h5")), "bare.h5: has no weights"),
    ],
)
def test_what_cannot_be_viewed_or_written_is_refused(clip, run, settings, told):
    words = ("extract", "frames", "--cage", "cage.obj", "-o", "bare.h5", "--no-weights", "-q")
    assert run(*words).code == 0
    before = files()
    with pytest.raises(CageikError) as error:
        open_(settings)
    assert str(error.value).startswith(told)
    assert files() == before


def test_handles_may_be_saved_where_they_were(clip):
    same = Path("handles.json")
    session = open_(replace(CLIP, handles=same, handles_output=same, overwrite=True))
    assert json.loads(session.first_handles) == DOCUMENT
    other = {"handles": [LIFT]}
    apply(session, other)
    assert json.loads(same.read_bytes()) == other


SCREEN = {"source": [1, 1], "target": [2, 2]}
CAMERA = {"position": [0, 0, 5], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov_degrees": 40}


@pytest.mark.parametrize("settings", [CLIP, MODEL])
@pytest.mark.parametrize(
    ("document", "told"),
    [
        ({}, "has no handles"),
        ({"handles": [{"name": "a", "position": [0, 0, 1], "pin": True}]}, "'a': has a position"),
        (
            {
                "camera": CAMERA | {"width": 9, "height": 9},
                "handles": [{"name": "a", "screen": SCREEN}],
            },
            "'a': has a position or a screen",
        ),
        ({"handles": [LIFT | {"vertex": 10**6}]}, "'tip': vertex: there is no vertex 1000000"),
        ({"frames": [0, 99], "handles": [LIFT]}, "frames: "),
    ],
)
def test_handles_that_the_page_cannot_show_are_refused_at_once(clip, settings, document, told):
    """In the page, the reason would be in a panel that is closed."""
    Path("handles.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"^handles\.json: ") as error:
        open_(replace(settings, handles=Path("handles.json")))
    assert told in str(error.value)


def test_handles_are_read_before_any_work(clip, monkeypatch):
    Path("handles.json").write_text("{}")
    monkeypatch.setattr("cageik_cli.view.session.load_surface", None)
    with pytest.raises(InputError, match=r"^handles\.json: has no handles"):
        open_(replace(MODEL, handles=Path("handles.json")))


def wrap(handles=b"null", edits=b"null"):
    """What a stranger sends in place of an edit."""
    return b'{"handles": %s, "cageEdits": %s}' % (handles, edits)


@pytest.mark.parametrize("settings", [CLIP, MODEL])
@pytest.mark.parametrize(
    ("data", "told"),
    [
        (wrap(b'{"handles": [{"name": "a", "vertex": 0, "offset": [0, NaN, 0]}]}'),
         "handles: handle 'a': offset[1]: is NaN"),
        (wrap(b'{"handles": [{"name": "a", "vertex": 0, "offset": [0, 1e999, 0]}]}'), "Infinity"),
        (wrap(b'{"output": "/etc/passwd", "handles": []}'), "is not a field"),
        (wrap(b"{}"), "has no handles"),
        (wrap(b"1"), "is 1, expected a handles file"),
        (b"[" * 100_000, "levels deep"),
        (b'{"handles": \xff}', "UTF-8"),
        (b"", "is not JSON"),
        (b"[]", "is an empty list, expected an object of handles and cageEdits"),
        (b"null", "expected an object of handles and cageEdits"),
        (b'{"handles": []}', "expected an object of handles and cageEdits"),
        (b'{"handles": null, "cageEdits": null, "output": "x"}', "expected an object of handles"),
        (b'{"handles": null, "handles": null}', '"handles" twice'),
        (wrap(), "has neither handles nor cage edits"),
        (wrap(edits=b"{}"), "has no edits"),
        (wrap(edits=b"[1]"), "expected a cage edits file"),
        (wrap(edits=b'{"edits": []}'), "edits: is an empty list"),
        (wrap(edits=b'{"edits": [{"name": "a", "moves": [{"vertex": 0, "offset": [0, NaN, 0]}]}]}'),
         "cage edits: edit 'a': moves[0]: offset[1]: is NaN"),
        (wrap(edits=b'{"edits": [{"name": "a", "moves": [{"vertex": 1.5, "offset": [0, 0, 0]}]}]}'),
         "moves[0]: vertex: is 1.5, expected a whole number"),
        (wrap(edits=b'{"edits": [{"name": "a", "moves": [%s]}]}' % b",".join(
            2 * [b'{"vertex": 3, "offset": [0, 0, 0]}'])), "edit 'a': vertex 3: is moved twice"),
    ],
)  # fmt: skip
def test_what_is_no_edit_is_refused(clip, settings, data, told):
    session, before = open_(settings), files()
    with pytest.raises(InputError) as error:
        session.parse(data, 0)
    assert told in str(error.value)
    assert files() == before


@pytest.mark.parametrize("field", ["handles", "cageEdits"])
def test_a_file_that_could_not_be_read_again_is_refused(clip, field):
    """What is sent may be larger than what is saved."""
    many = [{"vertex": k, "offset": 3 * [-1.2345678901234567e-100]} for k in range(24_000)]
    sent = {"handles": None, "cageEdits": None, field: {"edits": [{"name": "a", "moves": many}]}}
    data = json.dumps(sent, separators=(",", ":")).encode()
    assert 2_000_000 < len(data) < MAX_SUBMITTED_BYTES
    with pytest.raises(InputError, match="have more than 2000000 bytes"):
        open_(CLIP).parse(data, 0)


def test_an_edit_is_measured_as_it_is_sent(clip):
    """Indented it would be too large to be read again, and is saved as it was sent."""
    moves = [{"vertex": k, "offset": [0.5, 0.25, 0.125]} for k in range(20_000)]
    edits = {"edits": [{"name": "a", "moves": moves}]}
    sent = json.dumps({"handles": None, "cageEdits": edits}, separators=(",", ":"))
    saved = split_submitted(sent.encode())["cageEdits"]
    assert len(json.dumps(edits, indent=2)) > 2_000_000 > len(sent) > len(saved)
    assert json.loads(saved) == edits
    few = json.dumps({"handles": None, "cageEdits": {"edits": []}}).encode()
    assert split_submitted(few)["cageEdits"] == b'{\n  "edits": []\n}\n'


@pytest.mark.parametrize("settings", [CLIP, MODEL])
def test_handles_that_do_not_fit_leave_all_files(clip, settings):
    session = open_(settings)
    apply(session)
    before = files()
    wrong = {"handles": [LIFT | {"vertex": 10**6}]}
    with pytest.raises(InputError, match=r"^h.json: handle 'tip': vertex: there is no vertex"):
        apply(session, wrong)
    assert files() == before


def test_paths_in_names_are_names(clip):
    before = files().keys()
    names = ["../../evil.obj", "/etc/passwd", "C:\\evil.obj", "cages.h5"]
    handles = [LIFT | {"name": name, "vertex": k} for k, name in enumerate(names)]
    document = {"$schema": "file:///etc/passwd", "handles": handles}
    apply(open_(CLIP), document)
    assert files().keys() - before == {Path("edited.h5"), Path("h.json")}


def test_a_result_that_has_changed_is_refused(clip):
    session = open_(CLIP)
    os.utime("cages.h5", ns=(0, 0))
    before = files()
    with pytest.raises(InputError, match=r"^cages\.h5: has changed since the page was opened"):
        apply(session)
    assert files() == before


def test_a_full_disk_loses_nothing(clip, monkeypatch):
    session = open_(CLIP)
    apply(session)
    before = files()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(InputError, match="No space left"):
        apply(session)
    assert files() == before


@pytest.mark.parametrize(
    ("settings", "fails_at", "says"),
    [
        (CLIP, "h.json", "edited.h5 is of this edit already, h.json is not; apply it again"),
        (MODEL, "posed_cage.obj", "posed.obj is of this edit already, posed_cage.obj, h.json are"),
        (MODEL, "h.json", "posed.obj, posed_cage.obj are of this edit already, h.json is not"),
        (MODEL, "posed.obj", ""),
    ],
)
def test_a_disk_that_is_full_between_outputs_says_which_are_replaced(
    clip, monkeypatch, settings, fails_at, says
):
    session = open_(settings)
    apply(session)
    rename = os.replace

    def fill(source, target, **options):
        if Path(target).name == fails_at:
            raise OSError(28, "No space left on device")
        return rename(source, target, **options)

    monkeypatch.setattr("os.replace", fill)
    with pytest.raises(InputError, match="No space left") as caught:
        apply(session, {"handles": [LIFT | {"offset": [0, 0.25, 0]}]})
    told = str(format_error(caught.value))
    assert says in told
    assert bool(says) == ("already" in told)


class Interruptible(ViewListener):
    """Runs a client beside a page, and interrupts the page at the end or in an edit."""

    def __init__(self, use, interrupts_edit=False):
        self.use, self.interrupts_edit = use, interrupts_edit
        self.is_over, self.faults, self.told = threading.Event(), [], []

    def open(self, address):
        def work():
            try:
                self.use(Client(address))
            except BaseException as error:
                self.faults.append(error)
            self.is_over.set()

        threading.Thread(target=work, daemon=True).start()

    @contextmanager
    def show_edit(self):
        listener = self

        class Progress(ProgressListener):
            def update(self, done, total):
                if listener.interrupts_edit:
                    listener.told.append("interrupted")
                    raise KeyboardInterrupt

        yield Progress()

    def show_applied(self, result, written):
        self.told.append(result)

    def show_failed(self, error):
        self.told.append(error)


@pytest.fixture
def view(monkeypatch):
    """Serve a page until a client has used it."""
    wait = JobBoard.wait

    def serve(settings, use, interrupts_edit=False):
        listener = Interruptible(use, interrupts_edit)

        def wait_or_end(self, seconds):
            if listener.is_over.is_set():
                raise KeyboardInterrupt
            return wait(self, seconds)

        monkeypatch.setattr(JobBoard, "wait", wait_or_end)
        with pytest.raises(KeyboardInterrupt):
            run_view(open_(settings), 0, listener, wait_seconds=0.02)
        if listener.faults:
            raise listener.faults[0]
        return listener

    return serve


def wait_for_end(client):
    while (status := client.status())["state"] == "running":
        pass
    return status


@pytest.mark.parametrize("settings", [CLIP, MODEL])
def test_a_page_applies_handles(clip, view, settings):
    def use(client):
        page = client.ask()
        assert b"connect-src 'self'" in page.body
        assert client.apply(DOCUMENT, "?rigidity=2").status == 202
        status = wait_for_end(client)
        assert (status["state"], status["error"]) == ("done", "")
        assert status["written"] == [str(path) for path in settings.outputs()]
        assert [text for label, text in status["rows"] if text.startswith("tip: moved")]
        wrong = {"handles": [LIFT | {"vertex": 10**6}]}
        assert client.apply(wrong).value == {"job": 2}
        status = wait_for_end(client)
        assert (status["state"], status["rows"]) == ("failed", [])
        assert "there is no vertex 1000000" in status["error"]
        assert client.apply({"handles": []}).status == 422
        assert client.apply(DOCUMENT).value == {"job": 3}
        assert wait_for_end(client)["state"] == "done"

    before = files()
    listener = view(settings, use)
    assert files().keys() - before.keys() == {*settings.outputs()}
    assert [type(told) for told in listener.told] == [list, str, list]


def test_a_page_without_an_output_applies_nothing(clip, view):
    def use(client):
        assert client.ask().status == 200
        assert client.apply(DOCUMENT).status == 409

    before = files()
    view(ViewSettings(Path("cages.h5")), use)
    assert files() == before


def test_a_page_gives_its_handles_and_notes(clip, view):
    twin = LIFT | {"name": "twin"}
    Path("handles.json").write_text(json.dumps({"handles": [LIFT, twin]}))
    settings = replace(CLIP, handles=Path("handles.json"))

    def use(client):
        assert (
            b'<script type="application/json" id="player-handles">{"handles": ['
            in client.ask().body
        )
        client.apply(json.loads(Path("handles.json").read_text()))
        notes = [text for label, text in wait_for_end(client)["rows"] if label == "note"]
        assert [note for note in notes if "'tip + twin' are on the same point" in note]

    view(settings, use)


def apply_and_wait(client, document):
    """Apply until the server has gone."""
    assert client.apply(document).status == 202
    with suppress(ConnectionError, ValueError):
        wait_for_end(client)


def test_an_interrupt_during_an_edit_drops_it(clip, view):
    """What an earlier edit wrote stays; no part of the new one is left."""
    view(CLIP, lambda client: (client.apply(DOCUMENT), wait_for_end(client)))
    before = files()
    settings = replace(CLIP, overwrite=True)
    second = {"handles": [LIFT | {"offset": [0, 0.4, 0]}, *PINS]}
    listener = view(settings, lambda client: apply_and_wait(client, second), interrupts_edit=True)
    assert listener.told == ["interrupted"]
    assert files() == before


def test_two_clients_at_once_have_one_edit_at_a_time(clip, view):
    taken = []

    def use(client):
        def work():
            for _ in range(5):
                answer = client.apply(DOCUMENT)
                assert answer.status in (202, 409)
                taken.append(answer.status)

        threads = [threading.Thread(target=work) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        wait_for_end(client)

    listener = view(CLIP, use)
    assert len(taken) == 10
    assert taken.count(202) == len(listener.told) >= 1
    assert {type(told) for told in listener.told} == {list}
