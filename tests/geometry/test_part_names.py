"""Parts in sentences: where a vertex is, and how many of some vertices each part has."""

import numpy as np
import pytest

from cageik_cli.geometry.parts import (
    MAX_PARTS_NAMED,
    PartShare,
    count_by_part,
    describe_by_part,
    get_parts,
    join_meshes,
    name_part,
    name_vertex,
)
from tests.shapes import box, octahedron

MODEL = join_meshes([box(), octahedron(), box()], ["/a/box", "/a/ball", "last"])


def test_the_place_of_a_vertex_is_its_part_and_its_number_there():
    places = {0: "0 (/a/box[0])", 7: "7 (/a/box[7])", 8: "8 (/a/ball[0])", 21: "21 (last[7])"}
    assert {vertex: name_vertex(MODEL, vertex) for vertex in places} == places
    assert [name_part(MODEL, vertex) for vertex in (7, 13, 14)] == ["/a/box", "/a/ball", "last"]


def test_vertices_are_counted_by_part_the_most_first():
    found = count_by_part(MODEL, np.array([1, 14, 15, 20]))
    assert found == [PartShare("last", 3, 8), PartShare("/a/box", 1, 8)]
    assert describe_by_part(found) == " (last 3 of 8, /a/box 1 of 8)"
    assert count_by_part(MODEL, np.empty(0, np.int64)) == []


@pytest.mark.parametrize("mesh", [box(), join_meshes([box()], ["/a"])], ids=["none", "one part"])
def test_a_model_of_one_part_is_not_named(mesh):
    assert get_parts(mesh) is None
    assert (name_vertex(mesh, 3), name_part(mesh, 3)) == ("3", None)
    assert describe_by_part(count_by_part(mesh, np.array([3]))) == ""


def test_a_sentence_names_few_parts():
    many = [PartShare(f"part{k}", 1, 2) for k in range(MAX_PARTS_NAMED + 1)]
    text = describe_by_part(many)
    assert f"part{MAX_PARTS_NAMED - 1} 1 of 2, ..." in text
    assert f"part{MAX_PARTS_NAMED}" not in text
