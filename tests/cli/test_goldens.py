"""Every help, and the message of every combination of options that is refused, word by word.

`REWRITE_GOLDENS=1 python -m pytest tests/cli/test_goldens.py` writes the files of `goldens` anew;
`git diff` then shows what has changed.
"""

import difflib
import os
import re
import shlex
import shutil
from pathlib import Path

import pytest

from cageik_cli.cli import main
from tests.conftest import run_in_process

GOLDENS = Path(__file__).parent / "goldens"
REFUSALS = GOLDENS / "refused_options.txt"
LINES = re.findall(r"^\$ cageik (.*)$", REFUSALS.read_text(encoding="utf-8"), re.MULTILINE)


def compare(found: str, golden: Path) -> None:
    """Compare a text with a golden file, or write it there."""
    if os.environ.get("REWRITE_GOLDENS"):
        golden.write_text(found, encoding="utf-8")
    expected = golden.read_text(encoding="utf-8").splitlines()
    assert list(difflib.unified_diff(expected, found.splitlines(), "expected", "found")) == []


@pytest.mark.parametrize("name", ["", *main.commands], ids=lambda name: name or "cageik")
def test_the_help_is_as_before(name):
    lines = [[name, "--help"], [name, "--help-all"]] if name else [["--help"]]
    helps = [run_in_process(*line) for line in lines]
    assert {outcome.code for outcome in helps} == {0}
    text = "\n".join(outcome.out for outcome in helps)
    compare(text, GOLDENS / "help" / f"{name or 'cageik'}.txt")


@pytest.fixture(scope="module")
def inputs(tmp_path_factory, tiny_files) -> Path:
    """A folder with what the refused commands name."""
    folder = tmp_path_factory.mktemp("refused") / "inputs"
    shutil.copytree(tiny_files, folder)
    (folder / "handles.json").write_text('{"handles": [{"vertex": 0, "pin": true}]}')
    return folder


def test_refused_combinations_of_options_say_the_same(monkeypatch, inputs):
    monkeypatch.chdir(inputs)
    monkeypatch.setattr("cageik_cli.view.run.run_view", None)
    before = sorted(Path().rglob("*"))
    blocks = []
    for line in LINES:
        outcome = run_in_process(*shlex.split(line))
        message = outcome.err.splitlines()[-1].removeprefix("Error: ")
        blocks.append(f"$ cageik {line}\n{outcome.code}: {message}\n")
        assert outcome.code in (1, 2), blocks[-1]
    compare("\n".join(blocks), REFUSALS)
    assert sorted(Path().rglob("*")) == before


def test_another_text_than_the_golden_one_is_found(tmp_path, monkeypatch):
    monkeypatch.delenv("REWRITE_GOLDENS", raising=False)
    golden = tmp_path / "golden.txt"
    golden.write_text("$ cageik\n2: one\n", encoding="utf-8")
    compare("$ cageik\n2: one", golden)
    for found in ("$ cageik\n2: two", "$ cageik", "$ cageik\n2: one\n3: more"):
        with pytest.raises(AssertionError):
            compare(found, golden)
