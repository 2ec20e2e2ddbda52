"""What the README shows is so."""

import doctest
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
WALKER = Path("data_fixtures/walker")


@pytest.fixture
def at_root(monkeypatch):
    monkeypatch.chdir(ROOT)


def blocks(kind):
    return re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL)


def test_the_python_of_the_readme_runs(at_root):
    examples = [block for block in blocks("python") if ">>>" in block]
    assert examples
    for block in examples:
        test = doctest.DocTestParser().get_doctest(block, {}, "README.md", "README.md", 0)
        found = doctest.DocTestRunner(verbose=False).run(test)
        assert found.attempted > 0
        assert found.failed == 0


def test_a_readme_that_is_wrong_would_be_found():
    test = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "x", "x", 0)
    assert doctest.DocTestRunner(verbose=False).run(test, out=lambda _: None).failed == 1


def test_the_pose_of_the_readme_is_what_the_command_gives(at_root, run, tmp_path):
    """Of the figures as they are printed, in the order of the file."""
    words = (
        "pose", WALKER / "frames" / "walker_1.obj", WALKER / "handles.json", "--cage",
        WALKER / "cage.obj", "--rigidity", "10", "-o", tmp_path / "posed.obj", "--no-cache",
    )  # fmt: skip
    outcome = run(*words)
    assert outcome.code == 0, outcome.err
    shown = next(
        block for block in blocks("console") if "cageik pose" in block and "walker_1.obj" in block
    )
    for label in ("moved most", "mesh moved", "volume change", "system"):
        line = next(line for line in shown.splitlines() if line.strip().startswith(label))
        assert line in outcome.err.splitlines()


def test_the_handles_of_the_readme_are_those_of_the_fixture(at_root):
    shown = next(block for block in blocks("json") if "left elbow" in block)
    held = json.loads((WALKER / "handles.json").read_text())["handles"]
    for line in re.findall(r"\{.*\}", shown):
        assert json.loads(line) in held
