import igl
import numpy as np
import pytest

from cageik_cli.cages.check.faults import (
    Finding,
    count_fans,
    find_cage_faults,
    format_elements,
    validate_cage,
)
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import CageError
from tests.exact import improper_pairs
from tests.shapes import ball, box, changed, concave, finer, merged, moved, octahedron


def two_boxes(*shift):
    return merged(box(), moved(box(), shift))


def pinched():
    """Two boxes that share one corner: every edge has two faces, the corner two fans."""
    mesh = two_boxes(2, 2, 2)
    shared = int(np.flatnonzero((mesh.vertices[:8] == 1).all(axis=1))[0])
    other = 8 + int(np.flatnonzero((mesh.vertices[8:] == 1).all(axis=1))[0])
    faces = np.where(mesh.faces == other, shared, mesh.faces)
    faces = np.where(faces > other, faces - 1, faces)
    return TriMesh(np.delete(mesh.vertices, other, axis=0), faces)


def zero_area():
    """A divided box with the middle of an edge moved onto its end's line, beside a corner."""
    mesh = finer(box(), 1)
    a, b, c = mesh.faces[0]
    vertices = mesh.vertices.copy()
    vertices[a] = (vertices[b] + vertices[c]) / 2
    return changed(mesh, vertices=vertices)


def crossed():
    """A divided box whose top middle is pulled out through the bottom."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[(vertices == [0, 0, 1]).all(axis=1), 2] = -1.5
    return changed(mesh, vertices=vertices)


def folded():
    """A box with a flat fin, neighbours on the same side of their edge."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[(vertices == [0, 0, 1]).all(axis=1)] = [1.5, 0, 1]
    return changed(mesh, vertices=vertices)


def unmerged():
    """A box whose faces have vertices of their own."""
    return TriMesh(box().vertices[box().faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))


FAULTS = {
    "open": (changed(box(), box().faces[2:]), r"is open: no second face at 4 edges \(.*\); close"),
    "doubled face": (
        changed(box(), np.vstack([box().faces, box().faces[:1]])),
        "has faces that repeat others: face 12; delete it",
    ),
    "third face at an edge": (
        TriMesh(np.vstack([box().vertices, [[3.0, 0, 0]]]), np.vstack([box().faces, [[0, 1, 8]]])),
        "more than two faces meet at edge 0-1",
    ),
    "repeated vertex": (
        changed(box(), np.vstack([box().faces, [[0, 0, 1]]])),
        "has a vertex twice in a face: face 12; delete it",
    ),
    "no area": (zero_area(), "degenerate, corners on a line, at face 0"),
    "two components": (two_boxes(5, 0, 0), r"has 2 components \(of 8, 8 vertices\)"),
    "turned face": (
        changed(box(), np.vstack([box().faces[:1, ::-1], box().faces[1:]])),
        "has neighbours facing opposite ways at 3 edges",
    ),
    "lone vertex": (
        changed(box(), vertices=np.vstack([box().vertices, [[0, 0, 0]]])),
        "can move nothing: vertex 8; delete it",
    ),
    "pinched": (pinched(), "parts touch in a point at vertex 7"),
    "crossed": (crossed(), r"crosses or touches itself at 18 face pairs .*; move vertices until"),
    "folded": (folded(), "crosses or touches itself at"),
    "no volume": (
        changed(octahedron(), vertices=octahedron().vertices * [1, 1, 0]),
        r"bounds no volume \(0 in an area of 1\); give it thickness",
    ),
    "unmerged": (unmerged(), "36 edges .*; merge coincident vertices"),
}


@pytest.mark.parametrize(("cage", "says"), FAULTS.values(), ids=FAULTS.keys())
def test_every_fault_is_refused(cage, says):
    with pytest.raises(CageError, match=says) as caught:
        validate_cage(cage)
    assert "\n" not in str(caught.value)


NUMBERS = {
    "open": {"open-edge": [[0, 1], [1, 3], [2, 3], [0, 2]]},
    "doubled face": {"duplicate-face": [12]},
    "third face at an edge": {
        "non-manifold-edge": [[0, 1]],
        "open-edge": [[1, 8], [0, 8]],
        "self-intersection": None,
    },
    "repeated vertex": {"repeated-vertex": [12]},
    "no area": {"degenerate-face": None},
    "two components": {"components": list(range(8, 16))},
    "turned face": {"orientation": [[0, 1], [1, 3], [0, 3]]},
    "lone vertex": {"unreferenced-vertex": [8]},
    "pinched": {"pinched-vertex": [7]},
    "crossed": {"self-intersection": improper_pairs(crossed())},
    "folded": {"self-intersection": improper_pairs(folded())},
    "no volume": {"no-volume": [], "self-intersection": None},
    "unmerged": {"open-edge": None},
}


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_found_alone_with_its_numbers(name):
    found = {finding.kind: finding for finding in find_cage_faults(FAULTS[name][0])}
    assert found.keys() == NUMBERS[name].keys()
    for kind, numbers in NUMBERS[name].items():
        assert found[kind].severity == "unfit"
        if numbers is not None:
            assert sorted(found[kind].numbers.tolist()) == sorted(numbers)
            assert found[kind].elements or not numbers


def test_all_faults_of_one_cage_are_found_at_once():
    """A cage with a hole, a repeated face, a lone vertex and a second component."""
    mesh = two_boxes(5, 0, 0)
    faces = np.vstack([mesh.faces[1:], mesh.faces[5:6]])
    found = find_cage_faults(TriMesh(np.vstack([mesh.vertices, [[9.0, 9, 9]]]), faces))
    assert [(finding.kind, finding.value) for finding in found] == [
        ("duplicate-face", 1),
        ("unreferenced-vertex", 1),
        ("open-edge", 3),
        ("components", 2),
    ]
    assert found[0].numbers.tolist() == [23]


def test_a_cage_of_repeated_vertices_is_refused():
    (found,) = find_cage_faults(TriMesh(box().vertices, [[0, 0, 1], [2, 2, 2]]))[:1]
    assert (found.kind, found.numbers.tolist()) == ("repeated-vertex", [0, 1])


def test_a_degenerate_face_does_not_cross_its_neighbours():
    """Its corner lies on a neighbour's edge; what crosses elsewhere is still found."""
    kinds = [finding.kind for finding in find_cage_faults(zero_area())]
    assert kinds == ["degenerate-face"]


@pytest.mark.parametrize("shift", [1e-6, -1e-6])
def test_parts_that_nearly_touch_do_not_cross(shift):
    """A dent whose tip ends just before the wall opposite, or just behind it."""
    mesh = finer(box(), 1)
    vertices = mesh.vertices.copy()
    vertices[(vertices == [0, 0, 1]).all(axis=1)] = [0.3, 0.2, -1 + shift]
    found = [finding.kind for finding in find_cage_faults(changed(mesh, vertices=vertices))]
    assert found == ([] if shift > 0 else ["self-intersection"])


@pytest.mark.parametrize("cage", [box(), concave(), ball(1)], ids=["box", "concave", "ball"])
def test_clean_cages_pass_unchanged(cage):
    checked, notes = validate_cage(cage)
    assert checked is cage
    assert notes == ()


def test_an_inward_cage_is_flipped_with_a_note():
    checked, notes = validate_cage(concave().flip())
    assert checked.volume == pytest.approx(3)
    assert len(notes) == 1
    assert "turned outward" in str(notes[0])


def test_ten_numbers_are_listed_at_most():
    cage = changed(box(), vertices=np.vstack([box().vertices, np.zeros((12, 3))]))
    with pytest.raises(
        CageError, match=r"nothing: 12 vertices \(8, 9, .*, 17 and 2 more\); delete them$"
    ):
        validate_cage(cage)


@pytest.mark.parametrize("seed", range(30))
def test_fans_of_any_faces_are_those_of_libigl(seed):
    """Random faces: open, with edges of many faces, folded, and vertices without a face."""
    generator = np.random.default_rng(seed)
    faces = np.array([generator.permutation(9)[:3] for _ in range(2 + seed)])
    mesh = TriMesh(generator.normal(size=(10, 3)), faces)
    fans = count_fans(mesh)
    used = np.unique(faces)
    np.testing.assert_array_equal(fans > 0, np.isin(np.arange(10), used))
    is_edge_manifold = (mesh.edges.face_counts <= 2).all()
    expected = np.asarray(igl.is_vertex_manifold(faces))
    if is_edge_manifold:
        np.testing.assert_array_equal(fans[used] == 1, expected[used])


def test_fans_are_counted():
    assert count_fans(box()).tolist() == [1] * 8
    assert count_fans(pinched())[7] == 2
    book = TriMesh(np.random.default_rng(0).normal(size=(5, 3)), [[0, 1, 2], [0, 1, 3], [1, 0, 4]])
    assert count_fans(book).tolist() == [1] * 5
    loose = TriMesh(np.random.default_rng(0).normal(size=(7, 3)), [[0, 1, 2], [0, 3, 4], [0, 5, 6]])
    assert count_fans(loose).tolist() == [3, 1, 1, 1, 1, 1, 1]


@pytest.mark.parametrize(
    ("noun", "numbers", "text"),
    [
        ("face", [12], "face 12"),
        ("vertex", [3, 4], "2 vertices (3, 4)"),
        ("edge", [[3, 7]], "edge 3-7"),
        ("face pair", [[3, 7], [1, 2]], "2 face pairs (3-7, 1-2)"),
        ("face", range(12), "12 faces (0, 1, 2, 3, 4, 5, 6, 7, 8, 9 and 2 more)"),
    ],
)
def test_elements_are_formatted(noun, numbers, text):
    assert format_elements(noun, np.array(numbers)) == text


def test_the_sentence_has_message_and_remedy():
    finding = Finding("open-edge", "unfit", "it is open", "close it")
    assert finding.sentence == "it is open; close it"
