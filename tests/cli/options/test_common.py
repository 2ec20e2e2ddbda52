"""Options: wrong usage is exit code 2, and a file of options counts less than the command line."""

import json
import os
import sys
from pathlib import Path

import click
import h5py
import pytest

from cageik_cli.cli.options.types import SizeType
from cageik_cli.formats.find_files import find_readers
from cageik_cli.formats.write import _find_writers

TYPED = ("extract", "frames", "--cage", "cage.obj")


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("1000000B", 10**6),
        ("1K", 1024),
        ("512MiB", 512 << 20),
        ("512 mb", 512 << 20),
        ("1.5GiB", 3 << 29),
        ("2T", 2 << 40),
        ("7B", 7),
    ],
)
def test_sizes(text, size):
    assert SizeType().convert(text, None, None) == size


@pytest.mark.parametrize("text", ["lots", "0", "-1GiB", "1XiB", "1e9", "inf", "", "1 GiB 2"])
def test_what_is_no_size(text):
    with pytest.raises(click.BadParameter, match=f"'{text}' is not a size"):
        SizeType().convert(text, None, None)


@pytest.mark.parametrize(("text", "shown"), [("2", "2GiB or 2MiB"), ("1.5", "1.5GiB or 1.5MiB")])
def test_a_size_has_its_unit(text, shown):
    """Else `--memory 2` would be two bytes."""
    with pytest.raises(click.BadParameter, match=f"'{text}' has no unit; give {shown}"):
        SizeType().convert(text, None, None)


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["extract", "-h"], ["report", "--help"]])
def test_help(run, words):
    outcome = run(*words)
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("Usage: ")
    assert max(map(len, outcome.out.splitlines())) <= 80


def test_help_names_every_kind_of_clip(run):
    """Of USD as one, and of what gzip may pack as .gz."""
    said = run("extract", "--help").out
    for suffix in find_readers():
        shown = ".usd*" if suffix.startswith(".usd") else suffix
        shown = ".h5" if suffix == ".hdf5" else shown
        assert Path(shown).suffix in said


@pytest.mark.parametrize("command", ["export", "deform"])
def test_help_names_every_kind_of_file_that_is_written(run, command):
    said = run(command, "--help").out
    for suffix in _find_writers():
        assert (".usd*" if suffix.startswith(".usd") else suffix) in said


def test_help_is_quick_to_come(run_process):
    """No numerics are imported to show it."""
    program = """
import sys
from cageik_cli.cli import main
try:
    main(["--help"])
finally:
    heavy = {"numpy", "scipy", "h5py", "igl", "trimesh", "tqdm", "platformdirs"}
    print(sorted(heavy & set(sys.modules)), file=sys.stderr)
"""
    outcome = run_process("-c", program)
    assert (outcome.code, outcome.err) == (0, "[]\n")


@pytest.mark.parametrize("command", ["extract", "bind"])
def test_help_states_the_tolerances(run, command):
    said = " ".join(run(command, "--help-all").out.split())
    assert "0.03 preview, 0.005 standard, 0.001 fine" in said


@pytest.mark.parametrize(
    ("words", "table", "environment", "expected"),
    [
        (["--cache", "typed"], 'cache = "told"', "set", "typed"),
        (["--cache", "typed"], "no-cache = true", "set", "typed"),
        ([], 'cache = "told"', "set", "told"),
        ([], "", "set", "set"),
        ([], "", "", "home/cageik"),
        ([], "no-cache = true", "set", None),
        ([], 'cache = "told"\nno-cache = true', "set", None),
        (["--no-cache"], 'cache = "told"', "set", None),
        (["--no-cache"], "", "", None),
    ],
)
@pytest.mark.skipif(sys.platform != "linux", reason="the user's caches are told otherwise there")
def test_the_cache_is_that_of_the_nearest_word(
    run, folder, monkeypatch, words, table, environment, expected
):
    """Command line, file of options, environment, the user's own caches."""
    monkeypatch.setenv("CAGEIK_CACHE", environment)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "home"))
    Path("cageik.toml").write_text(f"[extract]\n{table}\n")
    before = set(folder.iterdir())
    assert run(*TYPED, *words, "-q", "--config", "cageik.toml").code == 0
    made = {path.name for path in set(folder.iterdir()) - before} - {"cages.h5"}
    assert made == (set() if expected is None else {expected.split("/")[0]})
    if expected:
        assert len(list((folder / expected).glob("*.weights"))) == 1


def test_tests_keep_out_of_the_users_caches(cache):
    from platformdirs import user_cache_path

    assert os.environ["CAGEIK_CACHE"] == str(cache)
    assert not cache.is_relative_to(user_cache_path())


def settings_of(path="cages.h5"):
    with h5py.File(path) as file:
        return json.loads(file.attrs["settings"]) | {"fps": file.attrs["fps"]}


def test_a_byte_order_mark_is_no_option(run, folder):
    Path("cageik.toml").write_text("[extract]\nalpha = 0.25\n", encoding="utf-8-sig")
    assert run(*TYPED, "--config", "cageik.toml").code == 0
    assert settings_of()["alpha"] == 0.25


def test_the_command_line_wins(run, folder):
    Path("cageik.toml").write_text("[extract]\nalpha = 0.25\nfps = 30\nalign = false\n")
    for words in (["--config", "cageik.toml", "--alpha", "0.5"],
                  ["--alpha", "0.5", "--config", "cageik.toml"]):  # fmt: skip
        assert run(*TYPED, *words, "--align", "--overwrite").code == 0
        found = settings_of()
        assert (found["alpha"], found["fps"], found["align"]) == (0.5, 30, True)


def test_a_file_without_this_command_changes_nothing(run, folder):
    Path("cageik.toml").write_text("[report]\nquiet = true\n")
    assert run(*TYPED, "--config", "cageik.toml").code == 0
    assert settings_of()["alpha"] == 1e-3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[extract]\ngamma = 1\n", "cageik.toml: [extract] has no option gamma; expected some of"),
        ("[extract]\nconfig = 'a'\n", "has no option config"),
        ("[extract]\nselection = ':2'\n", "has no option selection"),
        ("[extract]\nframes = 'a'\n", "'a'"),
        ("[extract\n", "cageik.toml: cannot be read as TOML"),
        ("\ud800", "cageik.toml: cannot be read as TOML"),
        ("extract = 5\n", "cageik.toml: `extract` is not a table of options"),
        ("[extract]\nalpha = 'much'\n", "'much' is not a valid float"),
        ("[extract]\nalpha = -1\n", "alpha is -1.0"),
        ("[extract]\njobs = 0\n", "0 is not in the range"),
        ("[extract]\nrest-frame = 'x'\n", "'x' is not the number of a frame"),
        ("[extract]\nmemory = -5\n", "-5 is not a size"),
        ("[extract]\noverwrite = 'maybe'\n", "'maybe' is not a valid boolean"),
        ("[extract]\nalpha = [1]\n", "alpha"),
        ("[extract]\nalpha = 2001-01-01\n", "alpha"),
        ("[extract]\nrest-frame = true\n", "rest-frame"),
        ("[extract]\noutput = ['a']\n", "output"),
        ("[extract]\noutput = 5\n", "output = 5 is not a value of --output"),
        ('[extract]\noutput = "a\\u0000"\n', "is not a value of --output"),
        ("[extract]\noverwrite = 2\n", "overwrite = 2 is not a value of --overwrite"),
        ("[extract]\nalign = 0.5\n", "align = 0.5 is not a value"),
        ("[extract]\nalpha = true\n", "alpha = True is not a value of --alpha"),
        ("[extract]\njobs = true\n", "jobs = True is not a value"),
        ("alpha = 1\n", "alpha"),
        ("[extrakt]\nalpha = 1\n", "extrakt"),
    ],
)
def test_a_file_of_other_things_is_wrong_usage(run, folder, text, says):
    Path("cageik.toml").write_bytes(text.encode(errors="surrogatepass"))
    outcome = run(*TYPED, "--config", "cageik.toml")
    assert (outcome.code, outcome.out) == (2, "")
    assert says in outcome.err
    assert not Path("cages.h5").exists()
