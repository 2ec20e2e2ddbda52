"""Values without a letter: messages name the option, and print no empty quotes."""

import click
import pytest

from cageik_cli.cli import main

COMMANDS = main.list_commands(click.Context(main))


@pytest.mark.parametrize("name", COMMANDS)
def test_empty_values_are_wrong_usage(name, run):
    command = main.get_command(click.Context(main), name)
    arguments = [one for one in command.params if isinstance(one, click.Argument)]
    options = [
        max(one.opts, key=len)
        for one in command.params
        if isinstance(one, click.Option) and not one.is_flag and not one.is_eager and not one.count
    ]
    typed = [[option, value] for option in options for value in ("", " ")]
    for words in [*typed, *([[""], [" "]] if arguments else [])]:
        outcome = run(name, *words)
        assert outcome.code == 2, (words, outcome)
        assert "given a value without any letter" in outcome.err
        assert not any(quotes in outcome.err for quotes in ("``", "''", '""', "' '", "` `"))
