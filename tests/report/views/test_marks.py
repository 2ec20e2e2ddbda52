"""The marks of faults: on which vertices and faces they are, and what they are called."""

import numpy as np
import pytest

from cageik_cli.cages.check.faults import Finding
from cageik_cli.report.views.cage import list_marks
from tests.shapes import box

CAGE = box()


def mark(elements, numbers, mesh="cage"):
    found = Finding("some-fault", "unfit", "m", "r", elements, np.array(numbers), 1.0, mesh)
    (made,) = list_marks((found,), CAGE, CAGE)
    return made


@pytest.mark.parametrize(
    ("elements", "numbers", "mesh", "faces"),
    [
        # All corners of a box are corners of these faces, but the other faces have no fault.
        ("faces", [0, 5, 6, 11], "cage", [0, 5, 6, 11]),
        ("face pairs", [[7, 2], [2, 9]], "cage", [2, 7, 9]),
        ("face pairs", [[0, 3], [1, 3]], "both", [3]),
        ("faces", [0, 1], "rest", []),
        ("vertices", CAGE.faces[4].tolist(), "cage", [4]),
        ("vertices", [0], "cage", []),
        ("vertices", CAGE.faces[4].tolist(), "rest", []),
        ("edges", [CAGE.faces[4][:2].tolist()], "cage", []),
    ],
)
def test_only_faces_with_a_fault_are_coloured(elements, numbers, mesh, faces):
    assert mark(elements, numbers, mesh).cage_faces.tolist() == faces


@pytest.mark.parametrize(
    ("elements", "numbers", "text"),
    [
        ("faces", [3], "some fault: face 3"),
        ("edges", [[0, 1]], "some fault: edge 0-1"),
        ("vertices", [7], "some fault: vertex 7"),
        ("face pairs", [[0, 1]], "some fault: face pair 0-1"),
        ("vertices", [1, 2, 3, 4], "some fault: 4 vertices (1, 2, 3 and 1 more)"),
    ],
)
def test_a_mark_names_its_elements(elements, numbers, text):
    assert mark(elements, numbers).text == text
