"""The help of commands, in groups, and options that are repeated."""

import click
import pytest
from click.testing import CliRunner

from cageik_cli.cli import main
from cageik_cli.cli.command import MAX_HELP_LINES, GroupedCommand, find_help_group, option
from cageik_cli.cli.options import common_options
from cageik_cli.cli.options.group import OptionGroup
from cageik_cli.util.settings import HelpGroup

NAMES = sorted(main.commands)


def list_options(name):
    return [param for param in main.commands[name].params if isinstance(param, click.Option)]


def spell(param):
    return max(param.opts, key=len)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("columns", ["80", "100"])
def test_the_help_of_every_command_is_short_and_names_all_options(run, monkeypatch, name, columns):
    monkeypatch.setenv("COLUMNS", columns)
    said = run(name, "--help").out
    assert len(said.splitlines()) <= MAX_HELP_LINES
    assert max(map(len, said.splitlines())) <= int(columns)
    for param in list_options(name):
        assert find_help_group(param) in HelpGroup
        assert spell(param) in said.replace("\n", " ") or spell(param) == "--help-all"


@pytest.mark.parametrize("name", NAMES)
def test_the_help_of_all_describes_every_option_in_its_group(run, name):
    outcome = run(name, "--help-all")
    assert outcome.code == 0
    words = outcome.out.split()
    sections = [line[:-1] for line in outcome.out.splitlines() if line[:-1] in list(HelpGroup)]
    assert sections == [title for title in HelpGroup if title in sections]
    for param in list_options(name):
        text = outcome.out.split(f"\n{find_help_group(param)}:\n")[1].split("\n\n")[0]
        starts = [line for line in text.splitlines() if line.startswith("  -")]
        assert any(spell(param) in line for line in starts)
        assert set((param.help or "").split()[:-1]) <= set(words)


def make_command(count):
    """A command of `count` options of limits, which have no group of their own, and two others."""

    @click.command(cls=GroupedCommand)
    @option("--name", help="A name.")
    @OptionGroup(
        "limits",
        dict,
        *(option(f"--max-{k:02}", help=f"Limit {k}.") for k in range(count)),
        option("--jobs", help="Threads.", group=HelpGroup.RUNNING),
        group=HelpGroup.LIMITS,
    )
    @common_options
    def command(**values):
        click.echo(repr(values["limits"]))

    return command


def test_a_member_that_names_no_group_has_that_of_its_group_of_options():
    groups = {spell(param): find_help_group(param) for param in make_command(1).params}
    assert (groups["--name"], groups["--max-00"]) == (HelpGroup.FIRST, HelpGroup.LIMITS)
    assert groups["--jobs"] == groups["--help-all"] == HelpGroup.RUNNING


@pytest.mark.parametrize(("count", "is_short"), [(3, False), (60, True)])
def test_only_a_long_help_leaves_out_what_options_do(count, is_short):
    said = CliRunner().invoke(make_command(count), ["--help"]).output
    assert ("Limit 1." not in said) == ("which --help-all describes" in said) == is_short
    assert "A name." in said
    assert "--max-02" in said
    assert "Limit 1." in CliRunner().invoke(make_command(count), ["--help-all"]).output


@pytest.mark.parametrize(
    ("words", "option_names"),
    [
        ("extract frames --cage a.obj --cage b.obj", "--cage"),
        ("extract frames -o a.h5 --output=b.h5", "-o or --output"),
        ("batch walks -o out --max-rms 1% --max-rms 2%", "--max-rms"),
        ("report --json - --json a.json", "--json"),
        ("extract --cage a.obj --config a.toml --cage a.obj frames", "--cage"),
    ],
)
def test_a_repeated_option_is_refused(run, words, option_names):
    outcome = run(*words.split())
    assert outcome.code == 2
    assert f"{option_names}: given 2 times, expected once; leave out all but one" in outcome.err


@pytest.mark.parametrize("word", ["--help", "--help-all"])
def test_a_help_is_shown_whatever_is_repeated(run, word):
    for words in ((word, "--cage", "a", "--cage", "b"), ("--cage", "a", "--cage", "b", word)):
        outcome = run("extract", *words)
        assert outcome.code == 0
        assert "Extract the cage of every frame" in outcome.out


def test_flags_and_options_of_several_values_may_be_repeated(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = (
        "extract frames --overwrite --overwrite --align --no-align --exclude a --exclude b -v -v"
    )
    outcome = run(*words.split())
    assert outcome.code == 1
    assert "frames: " in outcome.err


def test_a_file_of_options_does_not_repeat_what_is_typed(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.toml").write_text('[extract]\nalpha = 0.1\ncage = "a.obj"\n')
    outcome = run("extract", "frames", "--alpha", "0.2", "--config", "c.toml")
    assert outcome.code == 1
    assert "frames: " in outcome.err


def test_the_nearest_option_alone_is_suggested(run):
    outcome = run("extract", "frames", "--cage-vertex", "50")
    assert outcome.code == 2
    assert outcome.err.rstrip().endswith("'--cage-vertex'. Did you mean '--cage-vertices'?")
    assert "Did you mean" not in run("extract", "frames", "--zzz").err
