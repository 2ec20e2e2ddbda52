"""The script from a clip to a skinned file runs, and its types are right."""

import json
import subprocess
import sys

import pytest

from tests.docs.pages import ROOT

SCRIPT = ROOT / "docs/scripts/walker_to_glb.py"


def check_types(path):
    """Return what mypy says of a script, strictly; nothing if all is well."""
    words = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", str(path)]
    return subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False).stdout


@pytest.mark.slow
def test_the_script_goes_from_a_clip_to_a_skinned_file(page_folder, run_process):
    (page_folder / "data_fixtures").symlink_to(ROOT / "data_fixtures")
    outcome = run_process(str(SCRIPT))
    assert outcome.code == 0, outcome.err
    lines = outcome.out.splitlines()
    assert "wrote out/waving.glb: 48 frames of 93 joints" in outcome.out
    assert lines[-1].startswith("out/waving.glb: exists already; ")
    data = (page_folder / "out/waving.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    assert len(document["skins"]) == len(document["animations"]) == 1
    assert (page_folder / "out/walker.html").stat().st_size > 100_000


@pytest.mark.slow
def test_the_types_of_the_script_are_right():
    assert check_types(SCRIPT) == ""


@pytest.mark.slow
def test_a_wrong_type_in_a_script_is_found(tmp_path):
    wrong = tmp_path / "wrong.py"
    wrong.write_text("from cageik_cli import load_mesh\nload_mesh(3)\n")
    assert "incompatible type" in check_types(wrong)
