"""What fails before the command can report errors itself is one sentence, too."""

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
from click.testing import CliRunner

from cageik_cli.cli import main

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = """
import sys
from importlib.abc import MetaPathFinder

class Failing(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            raise {error}

sys.meta_path.insert(0, Failing())
sys.argv = ["cageik", "info", "nowhere.obj"]
from cageik_cli.__main__ import main
main()
"""
ERRORS = {
    "disk": ("OSError(28, 'No space left on device', '/lib/click')", "No space left on device"),
    "files": ("OSError(24, 'Too many open files')", "Too many open files"),
    "library": ("ImportError('click.so: cannot open shared object file')", "click.so: cannot"),
    "memory": ("MemoryError()", "MemoryError"),
}


@pytest.mark.parametrize(("error", "says"), ERRORS.values(), ids=ERRORS)
def test_an_error_while_the_command_is_imported_is_one_sentence(run_process, error, says):
    outcome = run_process("-c", SCRIPT.format(name="click", error=error))
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("Error: cageik cannot be loaded: ")
    assert says in outcome.err
    assert "ulimit -n" in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize(("error", "says"), ERRORS.values(), ids=ERRORS)
def test_an_error_while_a_command_imports_what_it_needs_is_one_sentence(run_process, error, says):
    outcome = run_process("-c", SCRIPT.format(name="cageik_cli.run.info", error=error))
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("Error: ")
    assert says.replace("MemoryError", "out of memory") in outcome.err
    assert len(outcome.err.splitlines()) == 1


@pytest.mark.parametrize("name", ["cageik_cli.cli", "click", "cageik_cli.run.info"])
def test_an_interruption_while_modules_are_imported_is_one_sentence(run_process, name):
    outcome = run_process("-c", SCRIPT.format(name=name, error="KeyboardInterrupt()"))
    assert (outcome.code, outcome.out, outcome.err) == (1, "", "Error: interrupted\n")


def test_an_interruption_after_the_command_is_one_sentence(run_process):
    script = SCRIPT.format(name="nothing", error="ImportError()").replace(
        "from cageik_cli.__main__ import main",
        "import cageik_cli.cli as cli\n"
        "def interrupted():\n    raise KeyboardInterrupt\n"
        "cli.main = interrupted\n"
        "from cageik_cli.__main__ import main",
    )
    outcome = run_process("-c", script)
    assert (outcome.code, outcome.out, outcome.err) == (1, "", "Error: interrupted\n")


def test_an_error_of_the_code_itself_is_not_hidden(run_process):
    """Only what the system or the installation may cause is one sentence."""
    outcome = run_process("-c", SCRIPT.format(name="click", error="ZeroDivisionError()"))
    assert outcome.code == 1
    assert "Traceback" in outcome.err


def test_the_installed_command_is_this_one():
    from cageik_cli.__main__ import main

    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    value = settings["project"]["scripts"]["cageik"]
    assert EntryPoint("cageik", value, "console_scripts").load() is main


def test_the_linear_algebra_of_a_command_has_one_thread(run_process, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    script = """
import sys
import cageik_cli.cli as cli
from cageik_cli.__main__ import main

def count():
    import scipy.linalg
    from threadpoolctl import threadpool_info
    print({pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"})

cli.main = count
main()
"""
    assert run_process("-c", script).out == "{1}\n"


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
