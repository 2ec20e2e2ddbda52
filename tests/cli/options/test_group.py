"""Groups of options: every parameter of a record has its option, and no option is lost."""

from dataclasses import dataclass
from inspect import signature

import click
import pytest
from click.testing import CliRunner

from cageik_cli.cli import main
from cageik_cli.cli.options.group import OptionGroup


@dataclass(frozen=True)
class Size:
    width: int
    height: int


@dataclass(frozen=True)
class Picture:
    name: str
    size: Size


SIZE_OPTIONS = OptionGroup(
    "size",
    Size,
    click.option("--width", type=int, default=2),
    click.option("--height", type=int, default=1),
)


def run(group, *words):
    """The arguments that a command with this group is called with."""

    @click.command()
    @group
    @click.option("--quiet", is_flag=True)
    def command(**values):
        click.echo(repr(values))

    outcome = CliRunner().invoke(command, words, catch_exceptions=False)
    return outcome.output.strip()


def test_a_group_is_one_argument_of_the_command():
    assert run(SIZE_OPTIONS, "--width", "3") == repr({"quiet": False, "size": Size(3, 1)})


def test_a_group_in_a_group_is_part_of_its_record():
    group = OptionGroup("picture", Picture, click.argument("name"), SIZE_OPTIONS)
    assert run(group, "a", "--height", "7") == repr(
        {"quiet": False, "picture": Picture("a", Size(2, 7))}
    )
    assert group.option_names == {"name", "width", "height"}


def test_the_help_lists_the_options_in_order():
    group = OptionGroup("picture", Picture, click.argument("name"), SIZE_OPTIONS)
    lines = [line.split()[0] for line in run(group, "--help").splitlines() if line[:3] == "  -"]
    assert lines == ["--width", "--height", "--quiet", "--help"]


def test_a_record_without_an_option_for_a_field_is_a_mistake():
    group = OptionGroup("size", Size, click.option("--width", type=int, default=2))
    with pytest.raises(TypeError, match="height"):
        run(group)


@pytest.mark.parametrize("name", sorted(main.commands))
def test_every_argument_of_a_command_has_an_option(name):
    """And every option that has a value is an argument, of the command or of a record."""
    command = main.commands[name]
    callback, groups = command.callback, []
    options = {param.name for param in command.params if param.expose_value}
    while hasattr(callback, "__wrapped__"):
        groups.append(callback.__closure__)
        callback = callback.__wrapped__
    cells = [cell.cell_contents for closure in groups for cell in closure]
    found = [cell for cell in cells if isinstance(cell, OptionGroup)]
    names = set(signature(callback).parameters) - {group.name for group in found}
    for group in found:
        names |= group.option_names
    assert names == options
