"""What pages say of the package is true: its modules and the suffixes of its formats."""

import re
from pathlib import Path

import pytest

from cageik_cli.formats.base.files import MAX_UNPACKED_RATIO, MIN_UNPACKED_LIMIT
from cageik_cli.formats.find_files import clip_suffixes
from cageik_cli.formats.write import _find_writers
from cageik_cli.report.notes import (
    MAX_FAIR_DEVIATION,
    MAX_FAIR_RMS,
    MAX_GOOD_DEVIATION,
    MAX_GOOD_RMS,
)

ROOT = Path(__file__).parents[2]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")


def find_missing_modules(text):
    """List the modules with a folder that a text names, and that do not exist."""
    named = re.findall(r"`((?:\w+/)+\w+\.py)`", text)
    assert named
    roots = (ROOT, ROOT / "cageik_cli", ROOT / "cageik_cli/formats")
    return [name for name in named if not any((root / name).is_file() for root in roots)]


def find_missing_suffixes(text):
    """List the suffixes of files, read or written, that have no row in a table of formats."""
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `.")]
    named = {suffix for cell in cells for suffix in re.findall(r"`([.\w]+)`", cell)}
    return sorted({*clip_suffixes(), *_find_writers()} - named)


def test_all_modules_that_the_architecture_names_exist():
    assert find_missing_modules(ARCHITECTURE) == []
    assert find_missing_modules("`cages/check/faults.py` `cages/nowhere.py`") == [
        "cages/nowhere.py"
    ]


def test_where_is_what_is_answered_by_modules():
    table = ARCHITECTURE.split("## Where is")[1].split("\n## ")[0]
    answers = [line.split("|")[2] for line in table.splitlines() if line.startswith("| ")][1:]
    assert len(answers) >= 10
    for answer in answers:
        assert find_missing_modules(answer) == []


def test_every_format_has_a_row():
    text = (ROOT / "docs/formats.md").read_text(encoding="utf-8")
    assert find_missing_suffixes(text) == []
    assert find_missing_suffixes(text.replace("| `.mdd`", "| `.xyz`")) == [".mdd"]
    limit = f"{MAX_UNPACKED_RATIO} times their size, or to {MIN_UNPACKED_LIMIT >> 20} MiB"
    assert f"They may unpack to {limit}" in text


def read_bounds(text):
    """Return the bounds on rms and largest deviation of each word, as the page's table has them."""
    rows = re.findall(r"^\| (good|fair) \| ([\d.]+) % \| ([\d.]+) %", text, flags=re.M)
    return {word: (float(rms), float(largest)) for word, rms, largest in rows}


def test_the_page_on_quality_has_the_bounds():
    text = (ROOT / "docs/quality.md").read_text(encoding="utf-8")
    bounds = {
        "good": (MAX_GOOD_RMS, MAX_GOOD_DEVIATION),
        "fair": (MAX_FAIR_RMS, MAX_FAIR_DEVIATION),
    }
    assert read_bounds(text) == bounds
    assert read_bounds(text.replace("| 0.75 %", "| 0.8 %")) != bounds
    assert f"darkest: {MAX_FAIR_DEVIATION:g} %" in text


@pytest.mark.parametrize("word", ["--help", "-h"])
def test_refresh_shows_its_help(word, capsys):
    from tests.docs.refresh import main

    with pytest.raises(SystemExit) as end:
        main([word])
    assert end.value.code == 0
    assert "PAGE" in capsys.readouterr().out
