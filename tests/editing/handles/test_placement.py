from dataclasses import replace

import numpy as np
import pytest

from cageik_cli.editing.handles.model import HandleSet, PosedSurface
from cageik_cli.editing.handles.placement import describe_place, place_handles
from cageik_cli.formats.timeline import Timeline
from cageik_cli.method.pose.anchors import anchor_positions
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.util.errors import HandlesError, SettingError
from tests.editing.handles.files import (
    CAMERA,
    CLIP,
    FRAMES,
    HAND,
    KEYS,
    MESH,
    STILL,
    drag,
    read_set,
    step,
)
from tests.method.pose.test_camera import stand
from tests.refusals import refused
from tests.texts import texts

PIN = {"name": "foot", "vertex": 0, "pin": True}
KNEE = {"name": "knee", "face": 4, "barycentric": [0.2, 0.3, 0.5], "pin": True}
NEAR = {"name": "near", "position": [0.2, 0.3, 1.5], "pin": True}
NOSE = {"name": "nose", "screen": {"source": [320, 240], "target": [300, 200]}}


def with_screen(**fields):
    return NOSE | {"screen": NOSE["screen"] | fields}


def test_vertices_and_faces_are_where_they_are(tmp_path):
    found = drag(read_set(tmp_path, HAND | {"weight": 3, "hard": True}, KNEE))
    assert [(a.name, a.weight, a.hard) for a in found.anchors] == [
        ("hand", 3.0, True),
        ("knee", 1.0, False),
    ]
    hand, knee = anchor_positions(found.anchors, MESH.vertices)
    np.testing.assert_array_equal(hand, MESH.vertices[7])
    corners = MESH.vertices[MESH.faces[4]]
    np.testing.assert_allclose(knee, np.array([0.2, 0.3, 0.5]) @ corners, rtol=1e-15)
    assert texts(found.notes) == ()


def test_all_handles_are_hard_on_request(tmp_path):
    found = drag(read_set(tmp_path, HAND, KNEE), hard=True)
    assert [anchor.hard for anchor in found.anchors] == [True, True]


def test_a_position_snaps_to_the_pose_of_the_pick_frame(tmp_path):
    there = np.array([0.2, 0.3, 1.5]) + step(5)
    found = drag(read_set(tmp_path, NEAR | {"position": [*there]}, pick_frame=5), snap=15)
    place = found.anchors[0].point.position(MESH.vertices + step(5))
    np.testing.assert_allclose(place, np.array([0.2, 0.3, 1.0]) + step(5), rtol=0, atol=1e-12)
    (note,) = texts(found.notes)
    place = describe_place(MESH, found.anchors[0].point)
    shares = ", ".join(f"{share:.4g}" for share in place.values)
    assert note == (
        f"handle 'near': position snapped to face {place.number} (barycentric {shares}), 0.5 away "
        "(14.4 % of the diagonal)"
    )


def test_a_position_snaps_to_a_vertex_if_that_is_nearest(tmp_path):
    found = drag(read_set(tmp_path, NEAR | {"position": [1.1, 1.1, 1.1]}), snap=6)
    (note,) = texts(found.notes)
    vertex = np.flatnonzero((MESH.vertices == 1).all(axis=1))[0]
    assert f"position snapped to vertex {vertex}, 0.173 away (5 % of the diagonal)" in note


@pytest.mark.parametrize(("snap", "is_near"), [(14.43, False), (14.44, True), (0, False)])
def test_a_position_is_refused_if_it_is_too_far_from_the_surface(tmp_path, snap, is_near):
    """It is 0.5 away; the diagonal is 2 √3, so that is 14.434 %."""
    handles = read_set(tmp_path, NEAR)
    if is_near:
        assert drag(handles, snap=snap).anchors
        return
    with pytest.raises(HandlesError) as error:
        drag(handles, snap=snap)
    told = str(error.value)
    assert told.startswith("handle 'near': position: is 0.5 away from the surface (14.4 % of")
    assert f"at most {snap:g} %" in told
    assert told.endswith("or allow it with `snap=15%`")


def test_the_advised_limit_is_enough(tmp_path):
    for distance in (1.2345e-7, 0.0999, 0.1, 3.2, 1234.5):
        handles = read_set(tmp_path, NEAR | {"position": [0.2, 0.3, 1 + distance]})
        with pytest.raises(HandlesError) as error:
            drag(handles, snap=0)
        advised = float(str(error.value).rsplit("=", 1)[1].removesuffix("%`"))
        assert drag(handles, snap=advised).anchors


@pytest.mark.parametrize("snap", [-1, np.nan, np.inf])
def test_impossible_limits_of_snap_are_refused(snap):
    with pytest.raises(SettingError, match=f"`snap=` is {snap}, expected a finite number"):
        PosingSettings(snap=snap)


def test_a_place_is_what_a_handles_file_gives(tmp_path):
    """Vertices and points of faces, also a point of a face that is at a corner of it."""
    found = drag(read_set(tmp_path, HAND, KNEE, KNEE | {"name": "c", "barycentric": [0, 1, 0]}))
    hand, knee, corner = (describe_place(MESH, anchor.point) for anchor in found.anchors)
    assert (hand.kind, hand.number) == ("vertex", 7)
    assert knee.number == 4
    np.testing.assert_allclose(knee.values, [0.2, 0.3, 0.5], rtol=1e-15)
    assert (corner.kind, corner.number) == ("vertex", MESH.faces[4, 1])


def test_a_position_needs_snap(tmp_path):
    with pytest.raises(HandlesError, match=r"^handle 'near': position: .* `snap=`"):
        drag(read_set(tmp_path, NEAR))


EYE, TARGET, UP = (np.array(CAMERA[name], float) for name in ("position", "look_at", "up"))
AXES = stand(EYE, TARGET, UP).view[:3, :3]


def ray_of(pixel):
    """From the eye through a pixel, by the angles of the picture."""
    right, up, back = AXES
    half = np.tan(np.radians(CAMERA["fov_degrees"]) / 2)
    x, y = (pixel[0] - 320) / 240 * half, (240 - pixel[1]) / 240 * half
    return EYE, x * right + y * up - back


@pytest.mark.parametrize(
    ("said", "frame"), [({}, 0), ({"frames": [4, 6]}, 4), ({"pick_frame": 7}, 7)]
)
def test_a_pixel_is_picked_in_the_pose_of_the_pick_frame(tmp_path, said, frame):
    found = drag(read_set(tmp_path, with_screen(source=[350, 230]), **said))
    place = found.anchors[0].point.position(MESH.vertices + step(frame))
    eye, way = ray_of([350, 230])
    ahead = (step(frame)[2] + 1 - eye[2]) / way[2]  # the box's face towards +z is in front
    np.testing.assert_allclose(place, eye + ahead * way, rtol=0, atol=1e-9)


def test_a_screen_target_is_followed_in_every_frame(tmp_path):
    found = drag(read_set(tmp_path, with_screen(target=[300, 200])))
    frames = np.arange(FRAMES)
    positions = np.array([anchor_positions(found.anchors, CLIP.pose_at(k)) for k in frames])
    targets, (eye, way) = found.targets(frames, positions)[:, 0], ray_of([300, 200])
    ahead = (positions[:, 0] - eye) @ AXES[2] / (way @ AXES[2])
    np.testing.assert_allclose(targets, eye + ahead[:, None] * way, rtol=0, atol=1e-9)


def test_only_needed_poses_are_computed(tmp_path):
    asked = []
    surface = PosedSurface(MESH, lambda k: asked.append(k) or CLIP.pose_at(k), CLIP.timeline)
    drag(read_set(tmp_path, HAND, KNEE), surface)
    assert asked == []
    drag(read_set(tmp_path, HAND, NOSE, NEAR, pick_frame=3), surface, snap=100)
    assert asked == [3]


@pytest.mark.parametrize(
    ("said", "hold", "span"),
    [
        ({}, range(12), range(12)),
        ({"frames": [4, 6]}, range(4, 7), range(4, 7)),
        ({"frames": [4, 6], "falloff": 1}, range(4, 7), range(4, 7)),
        ({"frames": [4, 6], "falloff": 3}, range(4, 7), range(2, 9)),
        ({"frames": [4, 6], "falloff": 99}, range(4, 7), range(12)),
        ({"frames": [0, 11], "falloff": 3}, range(12), range(12)),
    ],
)
def test_frames(tmp_path, said, hold, span):
    found = drag(read_set(tmp_path, HAND, **said))
    assert (found.full_strength, found.affected_frames) == (hold, span)
    blend = found.blend(np.arange(FRAMES))
    np.testing.assert_array_equal(np.flatnonzero(blend), np.array(span))
    np.testing.assert_array_equal(np.flatnonzero(blend == 1), np.array(hold))


def test_one_pose(tmp_path):
    found = drag(read_set(tmp_path, HAND, NOSE, NEAR), STILL, snap=100)
    assert (found.full_strength, found.affected_frames) == (range(1), range(1))
    positions = anchor_positions(found.anchors, MESH.vertices)[None]
    moved = positions + found.displacements(np.arange(1), positions)
    np.testing.assert_allclose(moved[0, 0], [1, 2, 3], rtol=1e-15)


REFUSED = {
    "a vertex": (HAND | {"vertex": 8}, {}, "handle 'hand': vertex: there is no vertex 8; the mesh"),
    "a face": (KNEE | {"face": 12}, {}, "handle 'knee': face: there is no face 12; the mesh has"),
    "shares": (KNEE | {"barycentric": [0.5, 0.5, 0.5]}, {}, "handle 'knee': face: barycentric has"),
    "a share below zero": (
        KNEE | {"barycentric": [1.5, -0.5, 0]},
        {},
        "handle 'knee': face: barycentric has -0.5",
    ),
    "a miss": (with_screen(source=[1, 2]), {}, "handle 'nose': screen.source: pixel (1, 2) of 640"),
    "the first": (
        HAND,
        {"frames": [12, 13]},
        "frames: there is no frame 12; the clip has 12 frames, 0 to 11",
    ),
    "the last": (
        HAND,
        {"frames": [3, 12]},
        "frames: there is no frame 12; the clip has 12 frames, 0 to 11",
    ),
    "the pick": (HAND, {"pick_frame": 12}, "pick_frame: there is no frame 12; the clip has 12"),
    "a key": (
        HAND | {"target": KEYS | {"frames": [2, 5, 12]}},
        {},
        "handle 'hand': target: there is no frame 12; the clip has 12",
    ),
    "a key of pixels": (
        with_screen(target={"frames": [15], "values": [[1, 2]]}),
        {},
        "handle 'nose': screen.target: there is no frame 15",
    ),
}


@pytest.mark.parametrize(("handle", "fields", "place"), REFUSED.values(), ids=REFUSED)
def test_wrong_places_are_refused(tmp_path, handle, fields, place):
    with refused(HandlesError, place):
        drag(read_set(tmp_path, handle, **fields))


def test_frames_are_named_by_the_numbers_of_the_clip(tmp_path):
    """A clip from 1001 in steps of 2: an edit fades over numbers, so over half as many frames."""
    hold = HAND | {"target": KEYS | {"frames": [1005, 1011, 1013]}}
    late = replace(CLIP, timeline=Timeline(12, 1001, 2))
    found = place_handles(read_set(tmp_path, hold, frames=[1009, 1011], falloff=5), late)
    assert (found.full_strength, found.affected_frames) == (range(4, 6), range(2, 8))
    np.testing.assert_allclose(found.blend(np.array([1, 2, 4, 5, 8])) > 0, [0, 1, 1, 1, 0])
    same = HAND | {"target": KEYS | {"frames": [2, 5, 6]}}
    plain = place_handles(read_set(tmp_path, same, frames=[4, 5]), CLIP)
    frames, places = np.arange(2, 8), np.zeros((6, 1, 3))
    np.testing.assert_allclose(
        found.targets(frames, places), plain.targets(frames, places), rtol=1e-12
    )
    for number in (4, 1010, 1025):
        with pytest.raises(
            HandlesError, match=rf"frames: there is no frame {number}; .* steps of 2"
        ):
            place_handles(read_set(tmp_path, HAND, frames=[number, number]), late)


def test_frames_in_the_wrong_order_are_refused(tmp_path):
    handles = read_set(tmp_path, HAND).handles
    with pytest.raises(HandlesError, match="frames: the last, 3, is before the first, 5"):
        drag(HandleSet(handles, frames=(5, 3)))


OF_A_CLIP = {
    "frames": (HAND, {"frames": [0, 0]}, "frames: "),
    "falloff": (HAND, {"frames": [0, 0], "falloff": 2}, "frames: "),
    "pick_frame": (HAND, {"pick_frame": 0}, "pick_frame: "),
    "keys": (HAND | {"target": KEYS}, {}, "handle 'hand': target: keyframes: "),
}


@pytest.mark.parametrize(("handle", "fields", "place"), OF_A_CLIP.values(), ids=OF_A_CLIP)
def test_a_single_pose_has_no_frames(tmp_path, handle, fields, place):
    with refused(HandlesError, place):
        drag(read_set(tmp_path, handle, **fields), STILL)
