"""Handles on one point of the surface."""

from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.editing.handles import schedule
from cageik_cli.editing.handles.model import PosedSurface
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.anchors import anchor_positions
from cageik_cli.util.errors import HandlesError
from tests.editing.handles.files import CLIP, FRAMES, HAND, MESH, STILL, drag, read_set
from tests.texts import texts

CORNER = int(np.flatnonzero(MESH.faces[0] == MESH.faces[0, 1])[0])
SHARES = np.eye(3)[CORNER].tolist()
VERTEX = int(MESH.faces[0, CORNER])
HERE = MESH.vertices[VERTEX]
ALL = np.arange(FRAMES)


def handle(name, **fields):
    return {"name": name, "vertex": VERTEX} | fields


def on_face(name, **fields):
    """The same point, by a face."""
    return {"name": name, "face": 0, "barycentric": SHARES} | fields


def targets(found, surface=CLIP):
    frames = np.array(found.affected_frames)
    positions = np.array([anchor_positions(found.anchors, surface.pose_at(k)) for k in frames])
    return found.targets(frames, positions), positions


SAME = {
    "targets": (handle("a", target=[1, 2, 3]), on_face("b", target=[1, 2, 3])),
    "pins": (handle("a", pin=True), handle("b", pin=True)),
    "a pin and no offset": (handle("a", pin=True), on_face("b", offset=[0, 0, 0])),
    "within rounding": (handle("a", target=[1, 2, 3]), handle("b", target=[1, 2, 3 + 1e-9])),
    "keys of one value": (
        handle("a", offset=[1, 2, 3]),
        handle("b", offset={"frames": [2, 4], "values": [[1, 2, 3]] * 2}),
    ),
}


@pytest.mark.parametrize("handles", SAME.values(), ids=SAME)
def test_handles_that_agree_are_merged(tmp_path, handles):
    found = drag(read_set(tmp_path, *handles))
    alone = drag(read_set(tmp_path, handles[0]))
    (anchor,) = found.anchors
    assert (anchor.name, anchor.weight, anchor.hard) == ("a + b", 2.0, False)
    np.testing.assert_array_equal(targets(found)[0], targets(alone)[0])
    (note,) = texts(found.notes)
    assert "'a + b'" in note
    assert "merged" in note


DIFFERENT = {
    "targets": (handle("a", target=[1, 2, 3]), on_face("b", target=[1, 2, 3.5]), "0.5 apart"),
    "a hair": (handle("a", target=[1, 2, 3]), handle("b", target=[1, 2, 3 + 1e-8]), "1e-08 apart"),
    "a pin and an offset": (handle("a", pin=True), handle("b", offset=[0, 0.2, 0]), "0.2 apart"),
    "in one frame of all": (
        handle("a", offset=[0, 0, 0]),
        handle("b", offset={"frames": [6, 7, 8], "values": [[0] * 3, [0, 0, 2], [0] * 3]}),
        "2 apart in frame 7",
    ),
    "a place and an offset": (
        handle("a", target=HERE.tolist()),
        handle("b", pin=True),
        f"{np.linalg.norm(CLIP.pose_at(11)[0] - MESH.vertices[0]):.3g} apart in frame 11",
    ),
}


@pytest.mark.parametrize(("one", "other", "apart"), DIFFERENT.values(), ids=DIFFERENT)
def test_handles_that_differ_are_refused(tmp_path, one, other, apart):
    with pytest.raises(HandlesError) as error:
        drag(read_set(tmp_path, one, other))
    message = str(error.value)
    assert message.startswith("handles 'a' and 'b' conflict")
    assert apart in message
    assert "`allow_conflicts=True`" in message


def test_only_affected_frames_are_compared(tmp_path):
    """A place and a pin of a clip that moves agree in its first frame alone."""
    handles = handle("a", target=HERE.tolist()), handle("b", pin=True)
    assert len(drag(read_set(tmp_path, *handles, frames=[0, 0])).anchors) == 1
    with pytest.raises(HandlesError, match="in frame 2;"):
        drag(read_set(tmp_path, *handles, frames=[0, 0], falloff=3))


def test_a_conflict_in_a_single_pose_names_no_frame(tmp_path):
    handles = handle("a", pin=True), handle("b", offset=[0, 0, 1])
    with pytest.raises(HandlesError, match=r"1 apart;"):
        drag(read_set(tmp_path, *handles), STILL)


def test_the_two_handles_that_differ_are_named(tmp_path):
    handles = [handle(name, target=[0, 0, z]) for name, z in (("a", 0), ("b", 0), ("c", 1))]
    with pytest.raises(HandlesError, match="handles 'a' and 'c' conflict"):
        drag(read_set(tmp_path, *handles))


def test_allowed_conflicts_give_the_weighted_mean(tmp_path):
    handles = handle("a", target=[1, 0, 0]), on_face("b", target=[0, 0, 4], weight=3)
    found = drag(read_set(tmp_path, *handles), allow_conflicts=True)
    (anchor,) = found.anchors
    assert (anchor.name, anchor.weight, anchor.hard) == ("a + b", 4.0, False)
    np.testing.assert_allclose(targets(found)[0], np.tile([0.25, 0, 3], (FRAMES, 1, 1)), rtol=1e-15)
    (note,) = texts(found.notes)
    assert note.startswith("handles 'a' and 'b' conflict")
    assert note.endswith("weighted mean of 'a + b'")


def test_hard_handles_win(tmp_path):
    handles = [
        handle("a", target=[9, 9, 9], weight=100),
        handle("b", target=[1, 0, 0], hard=True),
        handle("c", target=[0, 0, 4], hard=True, weight=3),
    ]
    found = drag(read_set(tmp_path, *handles), allow_conflicts=True)
    assert found.anchors[0].hard
    np.testing.assert_allclose(targets(found)[0][0, 0], [0.25, 0, 3], rtol=1e-15)
    assert texts(found.notes)[0].endswith("weighted mean of 'b + c'")
    soft = drag(read_set(tmp_path, *handles[:2]), allow_conflicts=True)
    np.testing.assert_array_equal(targets(soft)[0][0, 0], [1, 0, 0])


def test_a_merged_anchor_is_hard_if_one_handle_is(tmp_path):
    handles = handle("a", target=[1, 2, 3]), handle("b", target=[1, 2, 3], hard=True)
    assert drag(read_set(tmp_path, *handles)).anchors[0].hard


def test_coincident_vertices_are_one_point(tmp_path):
    """As of a seam: two vertices of one place have the same weights."""
    doubled = TriMesh(np.vstack([MESH.vertices, HERE]), MESH.faces)
    surface = PosedSurface(doubled, lambda k: doubled.vertices)
    apart = handle("a", target=[1, 2, 3]), handle("b", vertex=8, target=[1, 2, 4])
    with pytest.raises(HandlesError, match="handles 'a' and 'b' conflict"):
        drag(read_set(tmp_path, *apart), surface)
    agreed = handle("a", target=[1, 2, 3]), handle("b", vertex=8, target=[1, 2, 3])
    assert [anchor.name for anchor in drag(read_set(tmp_path, *agreed), surface).anchors] == [
        "a + b"
    ]


@pytest.mark.parametrize(("slip", "count"), [(1e-11, 1), (1e-7, 2)])
def test_points_closer_than_the_tolerance_are_merged(tmp_path, slip, count):
    shares = np.roll([1 - slip, slip, 0], CORNER).tolist()
    handles = handle("a", pin=True), on_face("b", barycentric=shares, pin=True)
    assert len(drag(read_set(tmp_path, *handles)).anchors) == count


def test_a_handle_behind_the_camera_is_named(tmp_path):
    behind = PosedSurface(
        MESH, lambda k: MESH.vertices + np.array([0, 0, 20.0 * (k == 6)]), CLIP.timeline
    )
    nose = {"name": "nose", "screen": {"source": [320, 240], "offset": [0, 0]}}
    found = drag(read_set(tmp_path, nose), behind).anchors[0].point
    face = next(k for k, f in enumerate(MESH.faces) if set(f) == set(found.corners))
    order = [list(found.corners).index(vertex) for vertex in MESH.faces[face]]
    chin = {"name": "chin", "face": face, "barycentric": found.barycentric[order].tolist()}
    with pytest.raises(HandlesError, match=r"^handle 'nose': screen.offset: frame 6: the point is"):
        drag(read_set(tmp_path, nose, chin | {"pin": True}), behind)


@pytest.mark.parametrize("together", [2, 256])
def test_poses_are_computed_for_many_points_together(tmp_path, monkeypatch, together):
    """Each may take long; points are followed in turn, each with its own targets."""
    monkeypatch.setattr(schedule, "MAX_TRACED_GROUPS", together)
    frames, count = [], 3
    surface = replace(CLIP, pose_at=lambda k: (frames.append(k), CLIP.pose_at(k))[1])
    pairs = [
        HAND | {"name": f"{name}{vertex}", "vertex": vertex}
        for vertex in range(count)
        for name in "ab"
    ]
    found = drag(read_set(tmp_path, *pairs), surface)
    assert [anchor.name for anchor in found.anchors] == ["a0 + b0", "a1 + b1", "a2 + b2"]
    assert sorted(frames) == sorted([*ALL] * -(-count // together))
    wrong = pairs[-1] | {"target": [9, 9, 9]}
    with pytest.raises(HandlesError, match=r"^handles 'a2' and 'b2' conflict"):
        drag(read_set(tmp_path, *pairs[:-1], wrong), surface)
