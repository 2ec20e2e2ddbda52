"""Names of joints by their place: sides, heights, and numbers from the top down."""

import numpy as np
import pytest

from cageik_cli.formats.base.skeleton import name_joints
from cageik_cli.geometry.mesh import TriMesh
from tests.shapes import box, merged, moved

# A figure: a body, a head in front, two legs; +x is its left, +z its front.
BODY = moved(box(1.0), (0, 2, 0))
HEAD = moved(box(0.5), (0, 3, 0.9))
LEGS = [moved(box(0.4), (side * 0.6, 0.5, 0)) for side in (1, -1)]
FIGURE = merged(BODY, HEAD, *LEGS)
LIMBS = np.repeat([0, 1, 2, 3], 8)
OWNERS = np.arange(32)


def name(rest=FIGURE, up_axis="Y", limbs=LIMBS):
    return name_joints(rest.vertices, limbs, OWNERS, rest, up_axis)


def test_limbs_have_the_names_of_their_places():
    limbs, joints = name()
    assert limbs == ["middle", "upper_front", "L_lower", "R_lower"]
    assert len(set(joints)) == 32
    for k, limb in enumerate(limbs):
        assert {j[: -len("_01")] for j in np.array(joints)[k == LIMBS]} == {limb}


def test_mirrored_joints_have_the_same_number():
    _, joints = name()
    mirrored = FIGURE.vertices * [-1, 1, 1]
    for k in np.flatnonzero(LIMBS == 2):
        other = int(np.linalg.norm(FIGURE.vertices - mirrored[k], axis=1).argmin())
        assert joints[other] == "R" + joints[k][1:]


def test_numbers_begin_at_the_top():
    _, joints = name()
    body = {joint: FIGURE.vertices[k, 1] for k, joint in enumerate(joints) if LIMBS[k] == 0}
    heights = [body[f"middle_{k:02}"] for k in range(1, 9)]
    assert heights == sorted(heights, reverse=True)


def test_z_up_has_the_front_at_minus_y():
    turned = TriMesh(FIGURE.vertices[:, [0, 2, 1]] * [1, -1, 1], FIGURE.faces[:, ::-1])
    assert name(turned, "Z") == name()


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_names_do_not_depend_on_the_unit(scale):
    assert name(moved(FIGURE, scale=scale)) == name()


def test_parts_at_one_place_have_numbers_and_parts_without_vertices_have_names():
    limbs, _ = name(limbs=np.where(LIMBS == 3, 2, LIMBS))
    assert limbs == ["middle", "upper_front", "lower"]
    twice = merged(BODY, BODY)
    limbs, _ = name_joints(twice.vertices, LIMBS[:16], OWNERS[:16], twice, "Y")
    assert limbs == ["middle", "middle_b"]
    places = np.vstack([FIGURE.vertices, [[0.6, 0.1, 0.2]]])
    own = name_joints(places, np.append(LIMBS, 4), OWNERS, FIGURE, "Y")[0]
    assert own[4].startswith("L_lower_")


def test_a_flat_model_has_names():
    flat = TriMesh(FIGURE.vertices * [1, 0, 1], FIGURE.faces)
    assert name(flat)[0] == ["lower", "lower_front", "L_lower", "R_lower"]


def test_joints_beyond_the_model_are_at_its_ends():
    """A joint that no vertex follows may be far below or above it."""
    places = np.vstack([FIGURE.vertices, [[0, -50, 0.2], [0, 50, 0.2]]])
    found = name_joints(places, np.append(LIMBS, [4, 5]), OWNERS, FIGURE, "Y")[0]
    assert [each.partition("_")[0] for each in found[4:]] == ["lower", "upper"]
