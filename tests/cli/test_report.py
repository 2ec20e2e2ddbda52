"""`cageik report`: data alone on stdout when asked, and no file replaced unasked."""

import csv
import io
import json
from pathlib import Path

import pytest

from cageik_cli.report.html.page import is_page_current
from cageik_cli.report.record import build_report
from cageik_cli.store.result import read_result


@pytest.fixture(scope="session")
def result_bytes(tmp_path_factory, animation, write_obj):
    """The bytes of a result of the little animation."""
    import numpy as np

    from cageik_cli.workflows.extract import extract
    from cageik_cli.workflows.settings import ExtractSettings

    folder = tmp_path_factory.mktemp("report")
    np.savez(folder / "clip.npz", verts=animation.frames, faces=animation.rest.faces)
    cage = write_obj(folder / "cage.obj", animation.cage.vertices, animation.cage.faces)
    settings = ExtractSettings((str(folder / "clip.npz"),), cage, folder / "cages.h5")
    return extract(settings).path.read_bytes()


@pytest.fixture
def results(tmp_path, monkeypatch, result_bytes):
    """The current folder, with two results."""
    for name in ("cages.h5", "other.h5"):
        (tmp_path / name).write_bytes(result_bytes)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_text_goes_to_stdout(run, results):
    outcome = run("report")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("cages.h5: 5 frames of 18 vertices")
    assert run("report", "other.h5").out == outcome.out.replace("cages.h5", "other.h5")


def test_several_results_follow_each_other(run, results):
    pages = run("report", "other.h5", "cages.h5").out.split("\n\n")
    assert [page.split(":")[0] for page in pages] == ["other.h5", "cages.h5"]


@pytest.mark.parametrize("names", [["cages.h5"], ["cages.h5", "other.h5"]])
def test_json_on_stdout_is_alone_there(run, results, names):
    outcome = run("report", *names, "--json", "-")
    records = json.loads(outcome.out)
    found = [records] if len(names) == 1 else records
    assert [record["result"] for record in found] == names
    assert outcome.err.startswith("cages.h5: 5 frames")
    assert run("report", *names, "--json", "-", "-q").err == ""


def test_csv_on_stdout_is_alone_there(run, results):
    outcome = run("report", "cages.h5", "other.h5", "--csv", "-")
    rows = list(csv.DictReader(io.StringIO(outcome.out)))
    assert [row["result"] for row in rows] == ["cages.h5"] * 5 + ["other.h5"] * 5
    assert outcome.err.startswith("cages.h5: 5 frames")


def test_files_hold_what_stdout_would(run, results):
    outcome = run("report", "--json", "r.json", "--csv", "f.csv", "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    assert Path("r.json").read_text() == run("report", "--json", "-").out
    assert Path("f.csv").read_text() == run("report", "--csv", "-").out


@pytest.mark.parametrize("option", ["--json", "--csv", "--html"])
def test_files_that_exist_are_refused_unless_they_may_be_replaced(run, results, option):
    Path("there").write_text("old")
    outcome = run("report", option, "there")
    assert outcome.code == 1
    assert "there: exists already" in outcome.err
    assert Path("there").read_text() == "old"
    assert run("report", option, "there", "--overwrite").code == 0
    assert len(Path("there").read_text()) > 500


@pytest.mark.parametrize(("name", "start"), [("f.png", b"\x89PNG"), ("f.SVG", b"<?xml")])
def test_a_plot_is_of_the_kind_its_name_says(run, results, name, start):
    outcome = run("report", "--plot", name, "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    assert Path(name).read_bytes().startswith(start)
    assert "exists already" in run("report", "--plot", name).err
    assert run("report", "--plot", name, "--overwrite").code == 0


@pytest.mark.parametrize("name", ["f.pdf", "-", "png"])
def test_a_plot_of_another_kind_is_wrong_usage(run, results, name):
    outcome = run("report", "--plot", name)
    assert (outcome.code, outcome.out) == (2, "")
    assert f"--plot {name}: expected a name that ends in .png or .svg" in outcome.err


def test_a_plot_keeps_away_from_other_files(run, results):
    outcome = run("report", "--csv", "f.svg", "--plot", "f.svg")
    assert outcome.code == 1
    assert "f.svg: is read or written by this command already" in outcome.err
    assert not Path("f.svg").exists()


@pytest.mark.slow
def test_only_pictures_need_the_libraries_that_draw(run_process, results):
    for command in ("extract", "report"):
        code = (
            f"import sys, cageik_cli.cli.{command}, cageik_cli.workflows.extract, "
            "cageik_cli.report.overview, cageik_cli.report.views.text; "
            "print({'matplotlib', 'PIL'} & set(sys.modules))"
        )
        assert run_process("-c", code).out == "set()\n"


def test_a_refused_file_leaves_none_of_the_others(run, results):
    Path("there").write_text("old")
    assert run("report", "--json", "new", "--csv", "there").code == 1
    assert not Path("new").exists()


def test_the_remedy_is_one_that_report_has(run, results):
    Path("there").write_text("old")
    assert " -o" not in run("report", "--json", "there").err


@pytest.mark.slow
def test_the_page_is_that_of_the_record(run, results):
    outcome = run("report", "--html", "page.html", "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    report = build_report(read_result(Path("cages.h5")))
    assert is_page_current(Path("page.html"), report, has_pictures=True, has_player=True)
    assert Path("page.html").read_text().count("<img ") == 1 + 5 * 3 + 2
    first = Path("page.html").read_bytes()
    assert run("report", "--html", "page.html", "--overwrite", "-q").code == 0
    assert Path("page.html").read_bytes() == first


@pytest.mark.slow
def test_a_page_can_do_without_the_player(run, results):
    assert run("report", "--html", "page.html", "--no-player", "-q").code == 0
    report = build_report(read_result(Path("cages.h5")))
    assert is_page_current(Path("page.html"), report, has_pictures=True)
    assert "player" not in Path("page.html").read_text()


def test_the_page_may_go_to_stdout(run, results):
    outcome = run("report", "--html", "-")
    assert outcome.out.startswith("<!doctype html>")
    assert outcome.err.startswith("cages.h5: 5 frames")


def test_a_result_without_weights_has_a_page_without_pictures(run, folder):
    assert run("extract", "frames", "--cage", "cage.obj", "--no-weights").code == 0
    assert run("report", "--html", "page.html").code == 0
    page = Path("page.html").read_text()
    assert page.count("<img ") == 1
    assert "--no-weights" in page


@pytest.mark.parametrize("view", ["--html", "--plot"])
def test_a_view_of_one_result_of_several_is_wrong_usage(run, results, view):
    outcome = run("report", "cages.h5", "other.h5", view, "f.png")
    assert (outcome.code, outcome.out) == (2, "")
    assert f"{view} shows one result, 2 were named; name one, or use cageik batch" in outcome.err
    assert not Path("f.png").exists()


def test_a_page_is_not_written_over_its_result(run, results):
    outcome = run("report", "cages.h5", "--html", "cages.h5", "--overwrite")
    assert outcome.code == 1
    assert "cages.h5: is read or written by this command already" in outcome.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "used"),
    [
        (["extract", "frames", "--cage", "cage.obj", "-o", "other.h5"], []),
        (["report"], []),
        (["report", "--html", "page.html"], ["jinja2", "matplotlib"]),
    ],
    ids=["extract", "report", "page"],
)
def test_only_a_page_needs_what_pages_are_made_with(run_process, folder, run, words, used):
    assert run("extract", "frames", "--cage", "cage.obj").code == 0
    code = (
        f"import sys; from cageik_cli.cli import main; main({words}, standalone_mode=False); "
        "print(sorted({'jinja2', 'matplotlib'} & set(sys.modules)))"
    )
    outcome = run_process("-c", code)
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines()[-1] == str(used)


def test_both_on_stdout_is_wrong_usage(run, results):
    outcome = run("report", "--json", "-", "--csv", "-")
    assert (outcome.code, outcome.out) == (2, "")
    assert "--json and --csv both go to stdout" in outcome.err


def test_a_missing_result_is_refused(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = run("report")
    assert (outcome.code, outcome.out) == (1, "")
    assert "cages.h5: no such result" in outcome.err


def test_one_bad_result_spoils_no_output(run, results):
    Path("other.h5").write_text("bad")
    outcome = run("report", "cages.h5", "other.h5", "--json", "r.json")
    assert (outcome.code, outcome.out) == (1, "")
    assert "other.h5: is not an HDF5 file" in outcome.err
    assert not Path("r.json").exists()


def test_the_meshes_are_not_needed(run_process, results):
    """A report reads the result alone, from any folder."""
    (results / "elsewhere").mkdir()
    outcome = run_process("-m", "cageik_cli", "report", "../cages.h5", cwd=results / "elsewhere")
    assert outcome.code == 0
    assert outcome.out.startswith("cages.h5: ")
