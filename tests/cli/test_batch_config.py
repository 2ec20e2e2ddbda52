"""Options of clips from `cageik.toml`: layer over layer, the nearest on top."""

import os
from functools import partial
from pathlib import Path

import click
import pytest

from cageik_cli.cli.config import ClipTables
from cageik_cli.cli.extract import extract_command

TABLES = partial(ClipTables, extract_command, ("extract", "report"))


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def write(path, text):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(text)


def given(home, place=None):
    return TABLES().collect_options(Path(home).absolute(), Path(place or home).absolute())


def test_the_nearer_file_and_the_later_table_win():
    write("cageik.toml", '[extract]\nalpha = 1\nbeta = 2\nfps = 30\n[clips."a/walk*"]\nbeta = 3\n')
    write("a/walk1/cageik.toml", "[extract]\nfps = 25\n")
    assert given("a/walk1") == {"alpha": 1, "beta": 3, "fps": 25}
    assert given("a/run") == {"alpha": 1, "beta": 2, "fps": 30}


def test_tables_of_other_commands_may_stand_in_the_file():
    write("cageik.toml", '[report]\nmax-rms = "1%"\n[extract]\nfps = 25\n')
    assert given("walk") == {"fps": 25}


def test_files_are_matched_by_their_path():
    write("a/cageik.toml", '[clips."f*.pc2"]\nfps = 25\n[clips."bodies.hdf5/*jump"]\nfps = 60\n')
    assert given("a", "a/face.pc2") == {"fps": 25}
    assert given("a", "a/bodies.hdf5/high_jump") == {"fps": 60}
    assert given("a", "a/body.pc2") == {}


def test_paths_are_from_the_files_folder():
    write("a/cageik.toml", '[extract]\ncage = "cages/cage.obj"\nmemory = "2GiB"\n')
    root = Path.cwd()
    expected = {"cage": str(root / "a" / "cages" / "cage.obj"), "memory": "2GiB"}
    assert given("a/walk") == expected
    assert TABLES().find_auxiliary_files(root / "a/walk") == {Path(expected["cage"]).resolve()}


def test_options_above_the_tables_are_those_of_all_clips():
    write("cageik.toml", 'cage = "c.obj"\nfps = 25\nalpha = 1\n[extract]\nalpha = 2\n[report]\n')
    assert given("walk") == {"cage": str(Path.cwd() / "c.obj"), "fps": 25, "alpha": 2}
    write("walk/cageik.toml", "fps = 30\n")
    assert given("walk")["fps"] == 30


def test_a_path_may_be_in_the_folder_of_each_clip():
    write("anim/cageik.toml", 'cage = "{clip}/cage.obj"\nvertex-weights = "of {clip}/w.txt"\n')
    root = Path.cwd() / "anim"
    for place in ("walk", "runs/fast"):
        assert given(root / place)["cage"] == str(root / place / "cage.obj")
        assert (root / place / "cage.obj").resolve() in TABLES().find_auxiliary_files(root / place)
    assert given(root, root / "face.npz")["cage"] == str(root / "cage.obj")


def test_a_word_in_place_of_a_path_stays_a_word():
    write("anim/cageik.toml", 'vertex-weights = "area"\ncage = "area"\n')
    root = Path.cwd() / "anim"
    assert given(root / "walk") == {"vertex_weights": "area", "cage": str(root / "area")}
    assert TABLES().find_auxiliary_files(root / "walk") == {(root / "area").resolve()}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[extract", r"cageik\.toml: cannot be read as TOML"),
        (
            "[extract]\nalfa = 1\n",
            r"cageik\.toml: \[extract\] has no option alfa; did you mean alpha",
        ),
        ("[extract]\ngamma = 1\n", r"\[extract\] has no option gamma; expected some of accuracy"),
        ('[extract]\noutput = "x.h5"\n', r"cageik\.toml: \[extract\] sets output"),
        ('output = "x.h5"\n', r"cageik\.toml: the part above the tables sets output"),
        ("alfa = 1\n", r"cageik\.toml: the part above the tables has no option alfa; .* alpha"),
        ("alpha = []\n", r"alpha = \[\] is not a value of --alpha"),
        ("report = 1\n", r"cageik\.toml: `report` is not a table of options"),
        ('[clip."w*"]\nfps = 25\n', r'clip is not a command; .* or \[clips\."PATTERN"\]'),
        ('[extract]\nalpha = "a\\u0000"\n', "alpha = .* is not a value of --alpha"),
        ('[clips."w*"]\nfps = []\n', r"fps = \[\] is not a value of --fps"),
        ('clips = "w"\n', r"cageik\.toml: `clips` is not a table of options"),
        ('extract = "w"\n', r"cageik\.toml: `extract` is not a table of options"),
        ("[clips]\nwalk = 3\n", r"cageik\.toml: `clips\.walk` is not a table of options"),
    ],
)
def test_what_is_no_option_is_refused_by_the_files_name(text, says):
    write("cageik.toml", text)
    with pytest.raises(click.BadParameter, match=says):
        given("walk")
    assert TABLES().find_auxiliary_files(Path("walk")) == set()


def test_an_option_is_named_as_it_is_typed():
    write("cageik.toml", 'cage-out = "{clip}/cage.obj"\n')
    tables = ClipTables(extract_command, ("extract",))
    with pytest.raises(click.BadParameter, match="sets cage-out, "):
        tables.collect_options(Path("walk").absolute(), Path("walk").absolute())


def test_a_table_of_clips_may_stand_beside_those_of_commands(run):
    write("cageik.toml", '[clips."w*"]\nfps = 25\n[info]\nquiet = true\n[nonsense]\n')
    outcome = run("info", "--config", "cageik.toml", "x")
    assert outcome.code == 2
    assert "nonsense is not a command" in outcome.err
    write("cageik.toml", '[clips."w*"]\nfps = 25\n')
    assert "x: no such file" in run("info", "--config", "cageik.toml", "x").err


@pytest.mark.parametrize(
    "text", ['cache = "c"\n', '[extract]\ncache = "c"\n', '[clips."*"]\ncache = "c"']
)
def test_a_file_among_clips_cannot_say_where_to_write(text):
    write("walk/cageik.toml", text)
    with pytest.raises(click.BadParameter, match=r"cageik\.toml: .* sets cache, .*CAGEIK_CACHE"):
        given("walk")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="gives a link away")
def test_a_link_of_another_above_the_folder_is_not_read():
    write("mine/cageik.toml", "alpha = 1\n")
    write("clips/walk/a.obj", "")
    Path("cageik.toml").symlink_to("mine/cageik.toml")
    tables, walk = TABLES([Path("clips")]), Path("clips/walk").absolute()
    assert tables.collect_options(walk, walk) == {"alpha": 1}
    os.lchown("cageik.toml", 12345, -1)
    tables = TABLES([Path("clips")])
    assert tables.collect_options(walk, walk) == {}


@pytest.mark.skipif(os.name != "posix", reason="files have no owners on this system")
def test_files_of_others_above_the_folder_are_not_read(monkeypatch):
    write("cageik.toml", "alpha = 1\n")
    write("clips/cageik.toml", "beta = 2\n")
    write("clips/walk/cageik.toml", "fps = 3\n")

    def given(*folders):
        tables = TABLES([Path(folder) for folder in folders])
        return tables.collect_options(Path("clips/walk").absolute(), Path("clips/walk").absolute())

    assert given("clips") == {"alpha": 1, "beta": 2, "fps": 3}
    owner = os.stat("cageik.toml").st_uid
    monkeypatch.setattr(os, "getuid", lambda: owner + 1)
    if owner == 0:
        monkeypatch.setattr("cageik_cli.cli.config.SYSTEM_USER", 99)
    assert given("clips") == {"beta": 2, "fps": 3}
    assert given("clips/walk") == {"fps": 3}
    assert given(".") == {"alpha": 1, "beta": 2, "fps": 3}
