"""The cage of a result in a page: bad places, repairs, advice, and the clip extracted again."""

import json
import os
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.formats.open import load_mesh
from cageik_cli.run.settings import ViewSettings
from cageik_cli.store.result import checkpoint_path, read_result
from cageik_cli.util.errors import CageikError
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view import result_cage
from cageik_cli.view.rest_cage import encode_cage, list_polygons, open_rest_cage
from cageik_cli.view.server import JobBoard, Site, serve
from tests.view.client import Client
from tests.view.rest_cages import BROKEN, WALKER, dent

SECRET = "s" * 32
CAGE = ViewSettings(Path("cages.h5"), edits_cage=True)


@pytest.fixture
def session(extracted):
    with closing(open_rest_cage(CAGE, ProgressListener())) as opened:
        yield opened


def encode(mesh, **values):
    return encode_cage(mesh, **values).encode()


def read_session(page):
    start = page.index('id="player-session">') + len('id="player-session">')
    return json.loads(page[start : page.index("</script>", start)])


def enlarge(result):
    return result.cage.move(1.2 * result.cage.vertices)


def test_the_page_has_the_errors_of_the_clip_and_its_worst_place(session):
    result, again = read_result(Path("cages.h5")), read_session(session.render_page())["again"]
    assert (again["name"], again["problem"]) == ("cages-2.h5", "")
    rms = 100 * np.sqrt((result.metrics.rms**2).mean()) / result.rest.diagonal
    assert again["before"]["average"] == pytest.approx(rms)
    (place, *_) = again["places"]
    assert (
        f"vertex {result.metrics.worst_vertex[result.metrics.max_deviation.argmax()]}"
        in (place["sentence"])
    )
    assert place["faces"] >= 1


def test_a_clip_that_is_not_there_is_told_at_once(extracted):
    shutil.rmtree("frames")
    with closing(open_rest_cage(CAGE, ProgressListener())) as opened:
        problem = read_session(opened.render_page())["again"]["problem"]
    assert "not found in the current folder" in problem
    assert "`clip=`" in problem


def test_a_clip_is_extracted_again_beside_the_result(session):
    result = read_result(Path("cages.h5"))
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    cage = enlarge(result)
    edit = session.jobs["extract"](encode(cage, name="new.h5"))
    rows = dict(edit(ProgressListener()))
    after = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    assert after.keys() - before.keys() == {Path("new.h5"), Path("new.cage.obj")}
    assert after.items() >= before.items()
    assert session.written == (Path("new.h5"), Path("new.cage.obj"))
    written = load_mesh(Path("new.cage.obj")).mesh
    assert written.vertices.tobytes() == cage.vertices.tobytes()
    found = read_result(Path("new.h5"))
    assert found.settings == result.settings
    assert found.sources["frames"] == result.sources["frames"]
    errors = session.compare(b"{}")
    for name, one in (("before", result), ("after", found)):
        percents = 100 * one.vertex_rms / one.rest.diagonal
        np.testing.assert_allclose(errors[name]["rms"], percents, rtol=1e-4)
        assert errors[name]["text"] == rows[name]
    assert errors["before"]["average"] != errors["after"]["average"]
    assert errors["after"]["name"] == "new.h5"


def test_before_an_extraction_nothing_is_after_it(session):
    assert session.compare(b"{}")["after"] is None
    with pytest.raises(CageikError, match="expected an object of nothing"):
        session.compare(b'{"name": "x"}')


def test_a_cage_that_is_not_fit_is_refused_and_leaves_nothing(session):
    result = read_result(Path("cages.h5"))
    before = set(Path().rglob("*"))
    small = result.cage.move(0.3 * result.cage.vertices)
    edit = session.jobs["extract"](encode(small, name="new.h5"))
    with pytest.raises(CageikError, match="outside the cage"):
        edit(ProgressListener())
    assert set(Path().rglob("*")) == before


def test_frames_that_changed_are_refused_and_nothing_is_left(session):
    result = read_result(Path("cages.h5"))
    path = Path("frames/frame_2.obj")
    path.write_text(path.read_text() + "# changed\n")
    before = set(Path().rglob("*"))
    edit = session.jobs["extract"](encode(enlarge(result), name="new.h5"))
    with pytest.raises(CageikError, match=r"has changed since cages\.h5 was extracted"):
        edit(ProgressListener())
    assert set(Path().rglob("*")) == before


def test_a_result_that_changed_is_refused(session):
    result = read_result(Path("cages.h5"))
    edit = session.jobs["extract"](encode(enlarge(result), name="new.h5"))
    os.utime("cages.h5", ns=(0, 0))
    with pytest.raises(CageikError, match=r"^cages\.h5: has changed since the page was opened"):
        edit(ProgressListener())


def test_what_an_interrupted_extraction_has_solved_is_kept_with_its_cage(session, monkeypatch):
    """So that the message that says so is true; the next one has another name."""

    def stop(result, cage, output, progress, **_):
        checkpoint_path(output).write_bytes(b"solved")
        raise KeyboardInterrupt

    result = read_result(Path("cages.h5"))
    monkeypatch.setattr(result_cage, "extract_again", stop)
    with pytest.raises(KeyboardInterrupt):
        session.jobs["extract"](encode(result.cage, name="new.h5"))(ProgressListener())
    assert Path("new.cage.obj").exists()
    with pytest.raises(CageikError, match=r"exists already; choose another name, such as new-2"):
        session.jobs["extract"](encode(result.cage, name="new.h5"))


@pytest.mark.parametrize("taken", ["new.cage.obj", "new.h5.partial"])
def test_files_beside_the_new_one_are_not_replaced_either(session, taken):
    Path(taken).write_bytes(b"mine")
    with pytest.raises(CageikError, match="exists already"):
        session.jobs["extract"](encode(read_result(Path("cages.h5")).cage, name="new.h5"))
    assert Path(taken).read_bytes() == b"mine"


def test_edits_and_bindings_are_refused(bound, run):
    handles = {"handles": [{"name": "tip", "vertex": 0, "offset": [0.1, 0, 0]}]}
    Path("handles.json").write_text(json.dumps(handles))
    assert run("pose", "cages.h5", "handles.json", "-o", "edit.h5").code == 0
    for name, told in (
        ("edit.h5", r"^edit\.h5: is an edit, .*; give the result that it was made from, cages\.h5"),
        ("binding.h5", r"^binding\.h5: is a binding"),
    ):
        with pytest.raises(CageikError, match=told):
            open_rest_cage(replace(CAGE, target=Path(name)), ProgressListener())


def test_a_clip_is_only_named_for_a_result(folder, run):
    words = ("view", "frames/frame_1.obj", "--cage", "cage.obj", "--clip", "frames")
    assert "--clip" in run(*words, "--edit-cage").err
    assert "--edit-cage" in run(*words[:2], "--clip", "frames").err


def test_models_have_nothing_to_extract(folder):
    settings = ViewSettings(Path("frames/frame_1.obj"), cage=Path("cage.obj"), edits_cage=True)
    with closing(open_rest_cage(settings, ProgressListener())) as opened:
        assert "again" not in read_session(opened.render_page())
        site = Site(SECRET, b"", JobBoard(), None, opened.answers, jobs=opened.jobs)
        with serve(site, 0) as address:
            for path in ("extract", "errors"):
                assert Client(address).ask(path, "POST", b"{}").status == 404


@pytest.fixture
def walker():
    rest, cage = WALKER / "frames/walker_1.obj", WALKER / "cage.obj"
    settings = ViewSettings(rest, cage=cage, edits_cage=True)
    with closing(open_rest_cage(settings, ProgressListener())) as opened:
        yield opened


def test_advice_is_for_the_vertex(walker):
    """A vertex that is pushed in is named, with its depth, and no cage is inflated for it."""
    rest, cage = walker._rest, walker._cage
    (found,) = walker.check(encode(dent(cage, rest, [40], 0.012)))["findings"]
    assert found["kind"] == "outside"
    assert found["vertices"] == [40]
    assert found["sentence"].endswith(
        "; vertex 40 of the cage is 1.2 % of the diagonal inside the model: drag it out, or Repair"
    )
    assert len(found["points"]) > 5


def test_advice_has_the_unit_of_the_model(walker):
    model = walker.subprocess
    model._kept = replace(model._kept, metres_per_unit=1.0)
    (found,) = walker.check(encode(dent(walker._cage, walker._rest, [40], 0.012)))["findings"]
    assert "vertex 40 of the cage is 2.9 cm inside the model: drag it out" in found["sentence"]


def test_of_a_cage_that_is_too_small_all_over_that_is_said(walker):
    cage = walker._cage
    found = walker.check(encode(cage.move(0.93 * cage.vertices)))["findings"][0]
    assert "the cage is too small all over: Inflate by 7.4 %, or Repair" in found["sentence"]
    assert found["vertices"] == []


def make_three_faults(walker):
    """A hole, a face that is turned over, and a vertex inside the model."""
    dented = dent(walker._cage, walker._rest, [40], 0.012)
    polygons = list_polygons(dented)
    polygons[100] = polygons[100][::-1]
    del polygons[3]
    return {"vertices": dented.vertices.tolist(), "polygons": polygons}


def test_faults_that_others_hide_are_found_at_once(walker):
    found = walker.check(json.dumps(make_three_faults(walker)).encode())["findings"]
    kinds = {one["kind"]: one for one in found}
    assert kinds.keys() == {"open-edge", "orientation", "outside"}
    assert {one["severity"] for one in found} == {"unfit"}
    assert kinds["outside"]["vertices"] == [40]
    assert kinds["outside"]["sentence"].startswith("when its faces are mended, ")
    assert len(kinds["open-edge"]["edges"]) == 3
    assert len(kinds["orientation"]["edges"]) == 3


def test_a_repair_mends_all_of_them(walker):
    repaired = walker.repair(json.dumps(make_three_faults(walker)).encode())
    assert repaired["is_fit"]
    assert len(repaired["steps"]) >= 3
    body = {name: repaired[name] for name in ("vertices", "polygons")}
    assert walker.check(json.dumps(body).encode())["verdict"] == "fit"


def test_a_repair_that_is_not_possible_says_so(walker):
    half = {
        "vertices": walker._cage.vertices.tolist(),
        "polygons": list_polygons(walker._cage)[:60],
    }
    repaired = walker.repair(json.dumps(half).encode())
    assert not repaired["is_fit"]
    flat = {"vertices": [[0, 0, 0]] * 3, "polygons": [[0, 0, 0]]}
    with pytest.raises(CageikError):
        walker.repair(json.dumps(flat).encode())


@pytest.mark.parametrize("folder", BROKEN, ids=lambda folder: folder.name)
def test_every_fault_has_advice_that_the_page_can_follow(folder):
    frame, cage = folder / "frames/frame_1.obj", folder / "cage.obj"
    settings = ViewSettings(frame, cage=cage, edits_cage=True)
    with closing(open_rest_cage(settings, ProgressListener())) as opened:
        for found in opened.check(encode(load_mesh(cage).mesh))["findings"]:
            if "of another model" not in found["sentence"]:  # no page can help
                assert "`" not in found["sentence"], found["sentence"]
            if found["severity"] == "unfit":
                places = [found[name] for name in ("vertices", "edges", "faces", "points")]
                assert any(places), found
