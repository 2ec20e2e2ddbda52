"""Blocks that do not run are still checked, or say why not; options that pages name exist."""

import ast
import importlib.util
import json
import re
import shlex
import tomllib
from collections import Counter
from doctest import DocTestParser

import click
import jsonschema
import pytest
import yaml

from cageik_cli.cli import main
from tests.docs.pages import ROOT, find_pages, name_page, read_all_blocks, read_blocks, read_prose
from tests.docs.session import find_reason_to_skip

NOT_RUN = [
    ("docs/blender.md", "sh", "needs Blender"),
    ("docs/cluster.md", "python", "needs SLURM"),
    ("docs/cluster.md", "sh", "needs a Dask cluster"),
    ("docs/cluster.md", "sh", "needs a Dask cluster"),
    *[("docs/editing-cages.md", "console", "serves a page until Ctrl-C")] * 2,
    ("docs/getting-started.md", "console", "serves a page until Ctrl-C"),
    ("docs/handles-file.md", "python", "needs Blender"),
    *[("docs/continuous-integration.md", "yaml", "GitHub workflow")] * 2,
    ("docs/reports-and-limits.md", "console", "needs ffmpeg"),
    ("docs/rigs.md", "sh", "needs Blender"),
    ("docs/rigs.md", "sh", "needs Node.js"),
    ("docs/viewing.md", "console", "needs a browser"),
    ("docs/viewing.md", "console", "needs a second machine"),
    ("docs/viewing.md", "console", "serves a page until Ctrl-C"),
]
"""The blocks that do not run, by page, language and reason."""

WAITING = [block for block in read_all_blocks() if "skip" in block.marks]
"""The blocks that run as soon as the package has the names that they import."""

LANGUAGES = {"console", "json", "python", "sh", "text", "toml", "yaml"}
TABLES = set(main.commands) | {"clips"}


def check_shell_line(line):
    """Return what is wrong with a line of shell, or None: targets, extras and options exist."""
    words = shlex.split(line, comments=True)
    if not words:
        return None
    if words[0] == "make":
        makefile = (ROOT / "Makefile").read_text()
        missing = [w for w in words[1:] if not re.search(rf"^{re.escape(w)}:", makefile, re.M)]
        return f"the Makefile has no target {', '.join(missing)}" if missing else None
    if words[:2] == ["pip", "install"]:
        project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
        extras = [extra for word in words for extra in _extras_in(word)]
        missing = [extra for extra in extras if extra not in project["optional-dependencies"]]
        return f"no extra {', '.join(missing)}" if missing else None
    if words[0] == "cageik":
        return check_command(words[1:])
    if words[:2] == ["python", "-m"]:
        return None if importlib.util.find_spec(words[2]) else f"no module {words[2]}"
    return f"{words[0]}: not known here; say why it does not run"


def _extras_in(word):
    match = re.search(r"\[([\w,]+)\]$", word)
    return match.group(1).split(",") if match else []


def check_command(words):
    """Return what click says against the words of a command, or None; nothing is run."""
    try:
        # A command keeps its option of help, whose names the settings of the group say.
        with click.Context(main, **main.context_settings) as context:
            _, command, rest = main.resolve_command(context, list(words))
            command.make_context(command.name, rest, parent=context)
    except click.ClickException as error:
        return error.format_message()
    return None


def list_options(command):
    """Return the options of a command, as they are typed."""
    return {word for one in command.params for word in [*one.opts, *one.secondary_opts]}


ALL_OPTIONS = set().union(*(list_options(command) for command in [main, *main.commands.values()]))


def find_unknown_options(text):
    """Return the options in code spans of a text that no command of cageik has."""
    spans = [span for span in re.findall(r"`([^`]+)`", text) if not span.startswith("pip ")]
    named = {word for span in spans for word in re.findall(r"(?<![\w-])--[a-z][a-z-]*", span)}
    return sorted(named - ALL_OPTIONS - {"--help"})


def read_workflow_faults(text):
    """Return what is wrong with a GitHub workflow: its steps and the commands in them."""
    (job,) = yaml.safe_load(text)["jobs"].values()
    faults = [] if "runs-on" in job else ["no runs-on"]
    for step in job["steps"]:
        if ("run" in step) == ("uses" in step):
            faults.append(f"not one of run and uses: {step}")
        line = step.get("run", "")
        if line.startswith("cageik"):
            faults += [fault for fault in [check_command(shlex.split(line)[1:])] if fault]
    return faults


def read_toml_faults(text):
    """Return the tables and keys of a file of options that no command has.

    Keys above the first table are options of `extract`.
    """
    faults, entries = [], tomllib.loads(text)
    above = {name: value for name, value in entries.items() if not isinstance(value, dict)}
    tables = {name: table for name, table in entries.items() if name not in above}
    for table, values in [("extract", above), *tables.items()]:
        if table not in TABLES:
            faults.append(f"[{table}]")
            continue
        command = main.commands["extract" if table == "clips" else table]
        known = {option.removeprefix("--") for option in list_options(command)}
        groups = values.values() if table == "clips" else [values]
        faults += [f"[{table}] {key}" for group in groups for key in group if key not in known]
    return faults


def check_handles(text, run):
    """Check a file of handles or cage edits with the schema that the command prints."""
    is_of_cage = "edits" in json.loads(text)
    schema = json.loads(run("pose", "--cage-edits-schema" if is_of_cage else "--schema").out)
    jsonschema.validate(json.loads(text), schema)


def test_every_block_has_a_language_that_is_checked():
    unknown = [f"{block}: {block.language!r}" for block in read_all_blocks()
               if block.language not in LANGUAGES]  # fmt: skip
    assert unknown == []


def test_blocks_that_do_not_run_are_counted_and_say_why():
    found = [
        (block.page, block.language, block.marks["not run"])
        for block in read_all_blocks()
        if "not run" in block.marks
    ]
    assert Counter(found) == Counter(NOT_RUN)


def test_only_python_waits_for_the_package():
    assert {block.language for block in WAITING} <= {"python"}


def test_no_block_waits_for_names_that_the_package_has():
    assert [str(block) for block in WAITING if not find_reason_to_skip(block)] == []


def test_console_blocks_are_not_nested():
    assert [str(block) for block in read_all_blocks("console") if block.nested] == []


@pytest.mark.parametrize("block", read_all_blocks("python"), ids=str)
def test_python_compiles(block):
    if ">>>" in block.text:
        text = "".join(example.source for example in DocTestParser().get_examples(block.text))
    else:
        text = block.text
    assert ast.parse(text, str(block)).body


@pytest.mark.parametrize("block", read_all_blocks("json"), ids=str)
def test_json_is_complete_and_fits_its_schema(block, run):
    content = json.loads(block.text)
    if {"handles", "sets", "edits"} & content.keys():
        check_handles(block.text, run)
    if "file" in block.marks:
        assert content == json.loads((ROOT / block.marks["file"]).read_text())


@pytest.mark.parametrize("block", read_all_blocks("toml"), ids=str)
def test_options_in_toml_exist(block):
    assert read_toml_faults(block.text) == []


@pytest.mark.parametrize("block", read_all_blocks("yaml"), ids=str)
def test_the_workflow_is_one(block):
    assert read_workflow_faults(block.text) == []


@pytest.mark.parametrize("block", read_all_blocks("sh"), ids=str)
def test_shell_lines_name_what_exists(block):
    if "not run" not in block.marks:
        faults = [check_shell_line(line) for line in block.text.splitlines()]
        assert [fault for fault in faults if fault] == []


@pytest.mark.parametrize("path", find_pages(), ids=name_page)
def test_options_and_targets_in_the_text_exist(path):
    text = read_prose(path)
    allowed = {"--style"} if path.name == "CONTRIBUTING.md" else set()
    assert set(find_unknown_options(text)) <= allowed
    named = [span for span in re.findall(r"`([^`\n]+)`", text) if span.startswith("make ")]
    assert [fault for fault in map(check_shell_line, named) if fault] == []
    commands = re.findall(r"`cageik ([a-z]+)", text)
    assert set(commands) <= set(main.commands)


class TestAWrongBlock:
    """Each of the checks above finds what it is for."""

    @pytest.mark.parametrize(
        "line",
        [
            "make nothing",
            "pip install '.[nothing]'",
            "cageik nothing",
            "cageik extract frames --wrong",
            "cageik extract frames --alpha much",
            "python -m tests.nothing",
            "rm -rf x",
        ],
    )
    def test_of_shell(self, line):
        assert check_shell_line(line) is not None

    @pytest.mark.parametrize("line", ["make run  # runs", "pip install '.[usd,abc]'", "# a note"])
    def test_but_not_a_right_line(self, line):
        assert check_shell_line(line) is None

    @pytest.mark.parametrize(
        "text", ["[wrong]\n", "[extract]\nwrong = 1\n", "[clips.a]\nbad = 1\n"]
    )
    def test_of_toml(self, text):
        assert len(read_toml_faults(text)) == 1

    def test_of_json(self, run):
        with pytest.raises(jsonschema.ValidationError):
            check_handles('{"handles": [{"name": "a", "vertices": 1}]}', run)

    @pytest.mark.parametrize("step", ["{}", "{run: cageik batch a --wrong}", "{run: a, uses: b}"])
    def test_of_a_workflow(self, step):
        text = f"jobs: {{one: {{runs-on: x, steps: [{step}]}}}}"
        assert len(read_workflow_faults(text)) == 1

    def test_of_the_text(self):
        assert find_unknown_options("with `--wrong` or `--alpha A`") == ["--wrong"]


def test_marks_belong_to_the_next_block_only(write_page):
    block, mark = "```text\na\n```\n", "<!-- skip -->\n\n"
    page = write_page(f"{mark}{block}\n{mark}Text.\n\n{block}")
    first, second = read_blocks(page)
    assert first.marks == {"skip": ""}
    assert second.marks == {}
