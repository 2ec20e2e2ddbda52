"""`cageik report`: data alone on stdout when asked, and no file replaced unasked."""

import csv
import io
import json
import shutil
from pathlib import Path

import pytest
from PIL import Image

from cageik_cli.cli.group import spell_option
from cageik_cli.report.html.page import is_page_current
from cageik_cli.report.record import build_report
from cageik_cli.store.result import read_result
from cageik_cli.util.text import format_bytes


@pytest.fixture
def results(tmp_path, monkeypatch, tiny_result):
    """The current folder, with two results."""
    for name in ("cages.h5", "other.h5"):
        shutil.copy(tiny_result, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_text_goes_to_stdout(run, results):
    outcome = run("report")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("cages.h5: 5 frames, 18 vertices")
    assert "  see it    cageik view cages.h5\n" in outcome.out
    assert "  quality   poor: " in outcome.out
    assert outcome.out.endswith("cageik export cages.h5 cages.usdc --with-model\n")
    assert run("report", "other.h5").out == outcome.out.replace("cages", "other")


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


@pytest.mark.parametrize(("name", "start"), [("f.png", b"\x89PNG"), ("f.SVG", b"<?xml")])
def test_a_plot_is_of_the_kind_its_name_says(run, results, name, start):
    outcome = run("report", "--plot", name, "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    assert Path(name).read_bytes().startswith(start)


def test_the_remedy_is_one_that_report_has(run, results):
    Path("there").write_text("old")
    assert " -o" not in run("report", "--json", "there").err


@pytest.mark.slow
def test_the_page_is_that_of_the_record(run, results):
    outcome = run("report", "--html", "page.html", "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    report = build_report(read_result(Path("cages.h5")), spelling=spell_option)
    assert is_page_current(Path("page.html"), report, has_pictures=True, has_player=True)
    assert Path("page.html").read_text().count("<img ") == 1 + 5 * 3 + 2
    first = Path("page.html").read_bytes()
    assert run("report", "--html", "page.html", "--overwrite", "-q").code == 0
    assert Path("page.html").read_bytes() == first


@pytest.mark.slow
def test_a_page_can_do_without_the_player(run, results):
    assert run("report", "--html", "page.html", "--no-player", "-q").code == 0
    report = build_report(read_result(Path("cages.h5")), spelling=spell_option)
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
    outcome = run("report")
    assert "  see it    cageik report cages.h5 --html cages.html\n" in outcome.out
    assert outcome.out.endswith("  use it    cageik export cages.h5 cages.usdc\n")


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


def test_the_meshes_are_not_needed(run, results, monkeypatch):
    """A report reads the result alone, from any folder."""
    (results / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    outcome = run("report", "../cages.h5")
    assert outcome.code == 0
    assert outcome.out.startswith("cages.h5: ")


def test_names_with_blanks_can_be_pasted(run, results):
    Path("my walk.h5").write_bytes(Path("cages.h5").read_bytes())
    shown, used = run("report", "my walk.h5").out.splitlines()[-2:]
    assert shown.split(maxsplit=2)[2] == "cageik view 'my walk.h5'"
    assert used.endswith("cageik export 'my walk.h5' 'my walk.usdc' --with-model")


SEND = [
    "--film",
    "walk.webp",
    "--film-size",
    "64x64",
    "--player",
    "walk.html",
]


@pytest.mark.slow
def test_what_is_sent_is_named_with_its_size(run, results):
    outcome = run("report", *SEND)
    assert outcome.code == 0, outcome.err
    lines = [line for line in outcome.out.splitlines() if line.startswith("wrote ")]
    assert [line.split()[1] for line in lines] == ["walk.html", "walk.webp"]
    assert ", 5 pictures of 64x64, 0.2 s, drawn in " in lines[1]
    for line in lines:
        assert f"({format_bytes(Path(line.split()[1]).stat().st_size)}" in line
    assert "data-player" in Path("walk.html").read_text()
    with Image.open("walk.webp") as film:
        assert (film.n_frames, film.size) == (5, (64, 64))
    first = [Path(name).read_bytes() for name in ("walk.html", "walk.webp")]
    assert run("report", *SEND).err.startswith("Error: walk.html: exists already")
    assert run("report", *SEND, "--overwrite", "-q").out == ""
    assert [Path(name).read_bytes() for name in ("walk.html", "walk.webp")] == first


@pytest.mark.slow
def test_the_settings_of_a_film_are_taken(run, results):
    words = ["--film-size", "80x64", "--film-seconds", "0.5", "--film-turntable"]
    assert run("report", "--film", "turn.gif", *words).code == 0
    with Image.open("turn.gif") as film:
        assert (film.n_frames, film.size) == (12, (80, 64))
    words = ["--film-size", "64x64", "--film-follow", "--film-seconds", "0.1"]
    assert run("report", "--film", "start.gif", *words).code == 0
    with Image.open("start.gif") as film:
        assert film.n_frames == 2


def test_a_film_of_pictures_is_named_with_its_size(run, results):
    words = ["--film", "shown/walk_##.png", "--film-size", "64x64"]
    view = ["--film-view", "-20,40,1.5,0,0,0", "--film-no-cage"]
    outcome = run("report", *words, *view)
    assert outcome.code == 0, outcome.err
    size = format_bytes(sum(file.stat().st_size for file in Path("shown").iterdir()))
    assert f"wrote shown/walk_##.png ({size}, 5 pictures of 64x64, 0.2 s" in outcome.out
    assert "the model is beyond the edges of 3 of 5 pictures" in outcome.err
    assert "give --film-view without a distance" in outcome.err
    assert run("report", *words).err.startswith("Error: shown: exists already")
    outcome = run("report", *words, *view, "--overwrite", "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("walk.png", "walk.png: a .png file holds one picture; name files in a folder"),
        ("walk_##.png", ".: is a folder with files that this command reads or writes"),
        ("mine/walk_##.png", "mine: holds notes.txt"),
        ("figures.json/walk_##.png", "figures.json: is a file"),
        ("cages.h5/walk_##.png", "cages.h5: is read or written by this command already"),
    ],
)
def test_a_film_that_cannot_be_written_is_refused_before_any_work(run, results, name, said):
    Path("mine").mkdir()
    Path("mine/notes.txt").touch()
    Path("figures.json").touch()
    outcome = run("report", "--csv", "figures.csv", "--film", name)
    assert (outcome.code, outcome.out) == (1, "")
    assert said in outcome.err
    assert not Path("figures.csv").exists()


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_without_ffmpeg_nothing_is_written(run, results, monkeypatch, suffix):
    monkeypatch.setenv("PATH", "")
    outcome = run("report", "--json", "figures.json", "--film", f"walk{suffix}")
    assert outcome.code == 1
    assert (
        f"walk{suffix}: is written by the program ffmpeg, which is not on the PATH" in outcome.err
    )
    assert not Path("figures.json").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--film walk.avi", "walk.avi: expected a name that ends in .webp or .gif or .mp4"),
        ("--film -", "-: expected a name that ends in .webp or .gif"),
        ("--film w.gif --film-view front", "--film-view front: is no view"),
        ("--film w.gif --film-view 0,95", "--film-view 0,95: the tilt 95 is out of range"),
        ("--film-no-cage", "--film-no-cage: no film is written"),
        ("--player walk.txt", "walk.txt: expected a name that ends in .html"),
        ("--film w.gif --film-size 640", "'640' is not a width and a height such as 640x480"),
        ("--film w.gif --film-size 10x640", "--film-size 10x640: a side is out of range"),
        ("--film w.gif --film-seconds 0", "--film-seconds 0: is out of range"),
        ("--film w.gif --film-seconds 1e9", "--film-seconds 1e+09: is out of range"),
        ("--film w.gif --film-turntable --film-follow", "leave out this or --film-turntable"),
        ("--film-follow", "--film-follow: no film is written"),
        ("--html page.html --film-size 99x99", "--film-size: no film is written"),
        *(
            (f"cages.h5 other.h5 {word}", f"{word.split()[0]} shows one result, 2 were named")
            for word in ("--film w.gif", "--player w.html")
        ),
    ],
)
def test_wrong_words_of_what_is_sent_are_refused(run, results, words, said):
    before = sorted(Path().iterdir())
    outcome = run("report", *words.split())
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err
    assert sorted(Path().iterdir()) == before


@pytest.mark.parametrize("words", ["--film w.gif", "--player w.html"])
def test_what_shows_a_model_needs_its_weights(run, folder, words):
    assert run("extract", "frames", "--cage", "cage.obj", "--no-weights").code == 0
    outcome = run("report", *words.split())
    assert outcome.code == 1
    assert "cages.h5: has no weights, which a " in outcome.err
    assert "without --no-weights" in outcome.err
    assert not Path(words.split()[1]).exists()
