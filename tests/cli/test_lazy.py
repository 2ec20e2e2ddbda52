"""Commands are imported when they run, and the help of all needs none."""

import pytest
from click.testing import CliRunner

from cageik_cli.cli import main


@pytest.mark.parametrize("name", sorted(main.commands))
def test_the_summary_of_a_command_is_one_short_line(name):
    summary = main.commands.summaries[name]
    assert len(summary) <= 45
    assert (main.commands[name].help or "").splitlines()[0] == summary
    outcome = CliRunner().invoke(main, ["--help"])
    assert outcome.output.count(f"  {name} ") == 1
    assert f" {summary}\n" in outcome.output


def test_the_help_imports_no_command(run_process):
    program = """
import sys
from cageik_cli.cli import main
try:
    main(["--help"])
finally:
    print([name for name in main.commands if f"cageik_cli.cli.{name}" in sys.modules])
"""
    outcome = run_process("-c", program)
    assert outcome.out.splitlines()[-1] == "[]"


def test_a_command_that_is_not_there_is_none():
    assert main.commands.get("extrude") is None
    assert "extrude" not in main.commands
    assert len(main.commands) == len(list(main.commands)) == 11
