"""What a command does not need it does not import: the start is most of a warm run."""

import pytest

WATCHED = "{'scipy', 'igl', 'matplotlib', 'jinja2', 'jsonschema', 'trimesh', 'PIL'}"
RUN = f"""
import sys
from cageik_cli.cli import main
try:
    main(sys.argv[1:])
finally:
    print(sorted({WATCHED} & set(sys.modules)), file=sys.stdout)
"""


@pytest.fixture
def extraction(fixtures_folder, tmp_path, monkeypatch, run):
    """The words of an extraction without bad regions, whose weights are in the cache."""
    monkeypatch.chdir(tmp_path)
    walker = fixtures_folder / "walker"
    words = ["extract", walker / "frames", "--cage", walker / "cage.obj", "-o", "cages.h5"]
    words += ["--overwrite", "--accuracy", "preview", "--frames", ":4"]
    assert run(*words).code == 0
    return words


def test_a_warm_extraction_imports_neither_scipy_nor_libigl(extraction, run_process):
    outcome = run_process("-c", RUN, *extraction)
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines()[-1] == "[]"


def test_an_extraction_that_binds_imports_them(extraction, run_process):
    """The test above would see it."""
    outcome = run_process("-c", RUN, *extraction, "--no-cache")
    assert outcome.code == 0, outcome.err
    assert "scipy" in outcome.out.splitlines()[-1]


def test_a_report_as_text_imports_none_of_them(extraction, run_process):
    outcome = run_process("-c", RUN, "report", "cages.h5")
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines()[-1] == "[]"
