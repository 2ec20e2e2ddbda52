"""The reach of handles: what is beyond their radius stays, whatever they do."""

import numpy as np
import pytest

from cageik_cli.cages.bind import bind
from cageik_cli.editing.cage_edits import EditFiles
from cageik_cli.editing.edits import EditTarget, LayeredEdit
from cageik_cli.editing.summary import PoseStatistics
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.method.pose import constraints
from cageik_cli.method.pose.anchors import Anchor, point_at_vertex
from cageik_cli.method.pose.constraints import MAX_LEAK, find_reach, mirror_pairs
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import HandlesError
from tests.editing.handles.files import read

HAND, OTHER_HAND, FOOT, CHEST = 1040, 1136, 994, 889
LIFT = {"name": "hand", "vertex": HAND, "offset": [0.1, 0.8, 0.3], "radius": 0.75}
PINS = [{"name": str(vertex), "vertex": vertex, "pin": True} for vertex in (FOOT, CHEST)]
PLANE = Mirror(np.array([1.0, 0, 0]), np.zeros(3))


@pytest.fixture(scope="module")
def binding(fixtures_folder):
    walker = fixtures_folder / "walker"
    rest = load_mesh(walker / "frames" / "walker_1.obj").mesh
    return bind(rest, load_mesh(walker / "cage.obj").mesh, BindSettings(accuracy="preview"))


@pytest.fixture
def pose(tmp_path, binding):
    """One frame that a document edits, and its summary."""

    def edit(document, **settings):
        handles, target = read(tmp_path, document), EditTarget.of_model(binding)
        layered = LayeredEdit(EditFiles(handles), target, PosingSettings(**settings))
        block = layered.edit_frames(np.zeros(1, np.int64), binding.cage.vertices[None])
        statistics = PoseStatistics(layered)
        statistics.update(block)
        return block, statistics.summarize()

    return edit


def distances_from(binding, *vertices):
    """How far every vertex is from the nearest of some vertices, in the rest pose."""
    rest = binding.rest.vertices
    return np.min([np.linalg.norm(rest - rest[vertex], axis=1) for vertex in vertices], axis=0)


def motions(block):
    return np.sqrt(block.squared_displacements[0])


def cage_motions(block):
    return np.linalg.norm(block.cages_after[0] - block.cages_before[0], axis=1)


@pytest.mark.parametrize(
    "settings", [{}, {"rigidity": 10}, {"alpha": 1e-2}, {"hard": True, "rigidity": 3}]
)
def test_what_is_beyond_the_radius_stays(binding, pose, settings):
    block, summary = pose({"handles": [LIFT, *PINS]}, **settings)
    is_beyond = distances_from(binding, HAND) > LIFT["radius"]
    assert 0.2 < is_beyond.mean() < 0.9
    largest = motions(block)[is_beyond].max()
    assert largest <= MAX_LEAK * cage_motions(block).max()
    assert summary.beyond_moved == pytest.approx(largest, rel=1e-9)
    assert summary.beyond_moved_percent == pytest.approx(100 * largest / binding.rest.diagonal)
    assert motions(block)[HAND] > 0.5


def test_without_a_radius_much_else_moves(binding, pose):
    """The check of the test above can fail."""
    free = {name: value for name, value in LIFT.items() if name != "radius"}
    block, summary = pose({"handles": [free, *PINS]})
    is_beyond = distances_from(binding, HAND) > LIFT["radius"]
    assert motions(block)[is_beyond].max() > 20 * MAX_LEAK * cage_motions(block).max()
    assert summary.beyond_moved is None


def test_the_handle_is_met_and_the_mesh_is_that_of_the_cage(binding, pose):
    block, summary = pose({"handles": [LIFT, *PINS]})
    assert summary.anchors[0].residual_percent < 1e-3
    expected = binding.rest.vertices + binding.weights @ (
        block.cages_after[0] - binding.cage.vertices
    )
    np.testing.assert_allclose(block.meshes_after[0], expected, rtol=0, atol=1e-12)


def test_hard_pins_beyond_are_held_by_the_radius(pose):
    """Forces of their own could not be met: no free cage vertex moves them."""
    _, summary = pose({"handles": [LIFT, *PINS]}, hard=True)
    assert [anchor.moved < 1e-3 for anchor in summary.anchors] == [False, True, True]


def test_pins_beyond_do_not_change_the_pose(pose):
    alone, _ = pose({"handles": [LIFT]})
    pinned, _ = pose({"handles": [LIFT, *PINS]})
    np.testing.assert_allclose(pinned.cages_after, alone.cages_after, rtol=0, atol=1e-9)


def test_pins_within_the_radius_are_kept(binding, pose):
    elbow = int(np.abs(distances_from(binding, HAND) - 0.3).argmin())
    pin = {"name": "elbow", "vertex": elbow, "pin": True}
    block, _ = pose({"handles": [LIFT, pin]})
    free, _ = pose({"handles": [LIFT]})
    assert motions(block)[elbow] < 1e-4 < motions(free)[elbow]


def test_a_vertex_within_one_of_several_radii_moves(binding, pose):
    other = LIFT | {"name": "other", "vertex": OTHER_HAND}
    block, _ = pose({"handles": [LIFT, other, *PINS]})
    is_beyond = distances_from(binding, HAND, OTHER_HAND) > LIFT["radius"]
    assert motions(block)[is_beyond].max() <= MAX_LEAK * cage_motions(block).max()
    assert motions(block)[[HAND, OTHER_HAND]].min() > 0.5


def test_the_mirror_image_of_a_radius_is_free_too(binding, pose):
    mirror = {"normal": [1, 0, 0], "point": [0, 0, 0]}
    block, _ = pose({"handles": [LIFT, *PINS], "mirror": mirror})
    image = PLANE.reflect(binding.rest.vertices[HAND])
    rest = binding.rest.vertices
    near_image = np.linalg.norm(rest - image, axis=1) <= LIFT["radius"]
    is_beyond = (distances_from(binding, HAND) > LIFT["radius"]) & ~near_image
    assert motions(block)[is_beyond].max() <= MAX_LEAK * cage_motions(block).max()
    assert motions(block)[near_image].max() > 0.5


def test_locked_vertices_of_the_file_stay_locked(binding, pose):
    free = cage_motions(pose({"handles": [LIFT]})[0])
    vertex = int(free.argmax())
    block, _ = pose({"handles": [LIFT], "locked": [vertex]})
    assert cage_motions(block)[vertex] == 0 < free[vertex]


def test_what_is_beyond_one_of_two_sets_counts_only_beyond_both(binding, pose):
    second = {"name": "other", "vertex": OTHER_HAND, "offset": [0, 0.3, 0], "radius": 0.9}
    document = {"sets": [{"handles": [LIFT]}, {"handles": [second]}]}
    block, summary = pose(document)
    is_beyond = distances_from(binding, HAND) > LIFT["radius"]
    is_beyond &= distances_from(binding, OTHER_HAND) > second["radius"]
    assert summary.beyond_moved == pytest.approx(motions(block)[is_beyond].max(), rel=1e-9)
    del second["radius"]
    assert pose(document)[1].beyond_moved is None


def reach_of(binding, radius, vertex=HAND, mirror=None):
    """What is beyond, and what is locked."""
    anchors = [Anchor("hand", point_at_vertex(binding.rest, vertex))]
    is_beyond, locked, _ = find_reach(binding, anchors, np.array([radius]), mirror)
    return is_beyond, locked


def test_the_sum_of_free_weights_is_the_bound(binding):
    """As many cage vertices are free as the bound allows, the least influential ones first."""
    is_beyond, locked = reach_of(binding, 1.0)
    is_free = np.ones(len(binding.cage.vertices), bool)
    is_free[locked] = False
    beyond = np.abs(binding.weights[is_beyond])
    assert beyond[:, is_free].sum(axis=1).max() <= MAX_LEAK
    influence = beyond.max(axis=0)
    assert influence[is_free].max() <= influence[~is_free].min()
    more = is_free | (influence == influence[~is_free].min())
    assert beyond[:, more].sum(axis=1).max() > MAX_LEAK


def test_blocks_do_not_change_the_reach(binding, monkeypatch):
    _, locked = reach_of(binding, 1.0)
    monkeypatch.setattr(constraints, "MAX_REACH_ROWS", 7)
    np.testing.assert_array_equal(reach_of(binding, 1.0)[1], locked)


def test_partners_are_free_together(binding):
    _, locked = reach_of(binding, 1.0, mirror=PLANE)
    partner = mirror_pairs(binding.cage, PLANE)
    assert 0 < len(locked) < len(partner)
    assert {*partner[locked].tolist()} == {*locked.tolist()}


def test_a_radius_around_all_locks_nothing(binding):
    is_beyond, locked = reach_of(binding, 10.0)
    assert not is_beyond.any()
    assert not len(locked)


@pytest.mark.parametrize("vertex", [HAND, CHEST])
def test_a_radius_that_is_too_small_names_the_smallest_one(binding, vertex):
    with pytest.raises(HandlesError) as error:
        reach_of(binding, 0.01, vertex)
    told = str(error.value)
    assert told.startswith("handle 'hand': radius: 0.01 is too small for this cage: ")
    assert "has 0 % of the weights there (at least 50 %)" in told
    smallest = float(told.split("of at least ")[1].split(",")[0])
    assert len(reach_of(binding, smallest, vertex)[1])
    with pytest.raises(HandlesError):
        reach_of(binding, 0.98 * smallest, vertex)
