import numpy as np
import pytest

from cageik_cli.cages.findings import Finding, format_elements


@pytest.mark.parametrize(
    ("noun", "numbers", "text"),
    [
        ("face", [12], "face 12"),
        ("vertex", [3, 4], "2 vertices (3, 4)"),
        ("edge", [[3, 7]], "edge 3-7"),
        ("face pair", [[3, 7], [1, 2]], "2 face pairs (3-7, 1-2)"),
        ("face", range(12), "12 faces (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, ...)"),
    ],
)
def test_elements_are_formatted(noun, numbers, text):
    assert format_elements(noun, np.array(numbers)) == text


def test_the_sentence_has_message_and_remedy():
    finding = Finding("open-edge", "unfit", "it is open", "close it")
    assert finding.sentence == "it is open; close it"
