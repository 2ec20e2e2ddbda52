"""The checks of the rules find what breaks them."""

import subprocess
from pathlib import Path

import pytest

from tests.rules import (
    RULES,
    find_long_modules,
    find_lost_modules,
    find_option_words,
    find_repeated_constants,
    find_stray_entries,
    read_modules,
)

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("rule", RULES)
def test_the_package_keeps_the_rules(rule):
    assert list(rule(read_modules())) == []


def test_constant_of_two_modules_is_found():
    modules = [("run/a.py", "MAX_ROUNDS = 3\n"), ("cages/b.py", "A, MAX_ROUNDS = 1, 4\n")]
    (fault,) = find_repeated_constants(modules)
    assert fault.startswith("cages/b.py:1: MAX_ROUNDS is also a constant of run/a.py:1")


def test_constants_of_other_names_and_locals_pass():
    modules = [("a.py", "MAX_A: int = 3\n"), ("b.py", "def f():\n    MAX_A = 4\nT = 1\n")]
    assert list(find_repeated_constants(modules)) == []


def test_long_modules_are_found_and_short_ones_pass():
    modules = [("a.py", "x = 1\n" * 701), ("b.py", "x = 1\n" * 700), ("c.py", "x = 1\n")]
    assert [fault.split(":")[0] for fault in find_long_modules(modules)] == ["a.py"]


def test_options_below_the_command_line_are_found():
    message = 'raise ValueError("give it with --rest-frame")\n'
    modules = [("run/a.py", message), ("cli/b.py", message)]
    (fault,) = find_option_words(modules)
    assert fault.startswith("run/a.py:1: names --rest-frame")


def test_short_options_below_the_command_line_are_found():
    (fault,) = find_option_words([("run/a.py", 'TEXT = "start cageik view with -o"\n')])
    assert fault.startswith("run/a.py:1: names -o")


def test_the_help_of_a_declared_setting_may_name_options():
    declared = 'guide: bool = declare_setting(False, "With --with-model, hides the cage.")\n'
    assert list(find_option_words([("run/a.py", declared)])) == []


@pytest.mark.parametrize(
    "text",
    [
        "run blender --background; then give --rest",
        "run `blender --background`, and --rest",
        "give --rest to blender",
        "open it in blender and give --rest",
    ],
)
def test_own_options_beside_those_of_other_programs_are_found(text):
    (fault,) = find_option_words([("run/a.py", f'TEXT = "{text}"\n')])
    assert fault.startswith("run/a.py:1: names --rest")


PACKAGE = [("cages/push.py", "def push():\n    pass\n"), ("cages/mesh_parts.py", "")]


@pytest.mark.parametrize("name", ["cages.pull", "cages.push.pull", "file_data.pull"])
def test_docstrings_that_name_lost_modules_are_found(name):
    (fault,) = find_lost_modules([*PACKAGE, ("a.py", f'"""See `{name}`."""\n')])
    assert fault.startswith(f"a.py: names {name}, which is not there")


@pytest.mark.parametrize("name", ["cages.push", "cages.push.push", "push.push", "result.frames"])
def test_docstrings_that_name_modules_or_values_pass(name):
    assert list(find_lost_modules([*PACKAGE, ("a.py", f'"""See `{name}`."""\n')])) == []


@pytest.mark.parametrize(
    "source",
    [
        'WORDS = ["cageik", "cage", "--repair", "cage.obj"]\n',
        'TEXT = "start `dask worker --nthreads 1`"\n',
        'TEXT = "bake it: blender --background --python bake.py -- {file} {stem}.abc"\n',
    ],
)
def test_words_of_commands_pass(source):
    assert list(find_option_words([("run/a.py", source)])) == []


def test_parameters_in_backticks_and_docstrings_pass():
    source = '"""As --rest does."""\nTEXT = "give it with `rest`, or a -- dash"\n'
    assert list(find_option_words([("run/a.py", source)])) == []


def test_the_top_level_holds_what_is_agreed_on():
    """What a test or a trial has left there is not committed."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    paths = listed.stdout.rstrip(b"\0").split(b"\0")
    assert b"pyproject.toml" in paths
    assert list(find_stray_entries(paths)) == []


def test_strays_at_the_top_level_are_found():
    paths = [b"bound.h5", b"k\xff.usdc", b".ci/run", b"docs/api.md", b"doc/api.md"]
    assert list(find_stray_entries(paths)) == [b"bound.h5", b"k\xff.usdc", b"doc/api.md"]
