"""Numbered files: which is missing, and what is no gap."""

from pathlib import Path

import pytest

from cageik_cli.formats.base.file_names import check_no_gaps
from cageik_cli.util.errors import InputError


@pytest.mark.parametrize(
    ("names", "missing"),
    [
        ("f1 f2 f4", "f3"),
        ("f8 f9 f10 f12", "f11"),
        ("f_001 f_002 f_004 f_005", "f_003"),
        ("f10 f20 f40 f50", "f30"),
        ("walk2_f1.low walk2_f2.low walk2_f4.low", "walk2_f3.low"),
        ("1 2 3 7", "4"),
    ],
)
def test_a_gap_names_the_first_file_that_is_missing(names, missing):
    with pytest.raises(InputError) as caught:
        check_no_gaps([Path("clip") / f"{name}.obj" for name in names.split()])
    assert str(caught.value).startswith(f"{Path('clip') / missing}.obj: missing between")
    assert "--allow-gaps" in str(caught.value)


@pytest.mark.parametrize(
    "names",
    [
        "f1",
        "f1 f2 f3",
        "f10 f20 f30",
        "f7 f12",
        "f1 f01 f2",
        "walk run jump9",
        "a1 a2 b7 b8",
        "a/f1 a/f2 b/f9",
        "f1_low f2_low f3_high",
    ],
)
def test_numbers_without_a_gap_and_other_names_pass(names):
    assert check_no_gaps([Path(f"{name}.obj") for name in names.split()]) is None
