"""Names as text."""

from pathlib import Path

import pytest

from cageik_cli.layout import printable


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("é_1.obj", "é_1.obj"),
        ("\U0001f40e.obj", "\U0001f40e.obj"),
        ("p\udcff_1.obj", "p\ufffd_1.obj"),
        ("\ud800", "\ufffd"),
        (Path("a") / "\udcfe", str(Path("a") / "\ufffd")),
    ],
)
def test_names_become_text_that_can_be_written(name, shown):
    assert printable(name) == shown
    shown.encode()
