"""The blend from what it is to be: smooth, complete, nothing outside."""

import numpy as np
import pytest

from cageik_cli.editing.handles.model import Motion
from cageik_cli.editing.handles.schedule import HandleSchedule, ScheduledAnchor
from cageik_cli.method.pose.anchors import Anchor, point_at_vertex
from cageik_cli.util.errors import HandlesError
from tests.editing.handles.test_model import FRAMES, KEYS, POSITIONS, STANDING, VALUES
from tests.shapes import box

OFFSET = np.array([[1.0, -2.0, 0.5]])


def drag_of(*motions, hold=range(20, 31), falloff=10):
    names = [f"h{k}" for k in range(len(motions))]
    scheduled = tuple(
        ScheduledAnchor(Anchor(name, point_at_vertex(box(), k)), (name,), (motion,), np.ones(1))
        for k, (name, motion) in enumerate(zip(names, motions, strict=True))
    )
    return HandleSchedule(scheduled, hold, range(50), falloff)


def test_the_blend_is_1_at_full_strength_and_0_outside():
    blend = drag_of().blend(np.arange(50))
    assert (blend[20:31] == 1).all()
    assert (blend[:11] == 0).all()
    assert (blend[40:] == 0).all()
    assert ((blend[11:20] > 0) & (blend[11:20] < 1)).all()
    assert (np.diff(blend[10:21]) > 0).all()


def test_the_blend_is_symmetric():
    blend = drag_of().blend(np.arange(50))
    np.testing.assert_array_equal(blend[10:21], blend[30:41][::-1])


def test_a_fade_in_and_a_fade_out_sum_to_one():
    """s(x) + s(1 − x) = 1."""
    blend = drag_of().blend(np.arange(10, 21))
    np.testing.assert_allclose(blend + blend[::-1], 1, rtol=1e-14)


@pytest.mark.parametrize("falloff", [100, 200, 400])
def test_two_derivatives_vanish_at_both_ends(falloff):
    """At a step h from an end it differs from it by 10 h³, to first order in h.

    The first difference quotient there goes as h², the second as h: both vanish with it.
    """
    h = 1 / falloff
    blend = drag_of(hold=range(1000, 1002), falloff=falloff).blend
    before, start, after = blend(1000 - falloff + np.array([-1, 0, 1]))
    assert before == start == 0
    assert after == pytest.approx(10 * h**3, rel=2 * h)
    before, full, after = blend(1000 + np.array([-1, 0, 1]))
    assert full == after == 1
    assert 1 - before == pytest.approx(10 * h**3, rel=2 * h)


@pytest.mark.parametrize("falloff", [0, 1])
def test_without_a_falloff_it_is_a_step(falloff):
    np.testing.assert_array_equal(
        drag_of(falloff=falloff).blend(np.arange(50)),
        (np.arange(50) // 1 >= 20) & (np.arange(50) <= 30),
    )


def test_targets_and_displacements_of_several():
    drag = drag_of(
        Motion("target", OFFSET),
        Motion("offset", OFFSET),
        Motion("pin"),
        hold=range(4, 8),
        falloff=3,
    )
    positions = np.stack([POSITIONS, POSITIONS + 1, POSITIONS - 1], axis=1)
    targets = drag.targets(FRAMES, positions)
    np.testing.assert_array_equal(targets[:, 0], np.tile(OFFSET, (12, 1)))
    np.testing.assert_array_equal(targets[:, 1], positions[:, 1] + OFFSET)
    np.testing.assert_array_equal(targets[:, 2], positions[:, 2])
    moved = drag.displacements(FRAMES, positions)
    blend = drag.blend(FRAMES)
    np.testing.assert_allclose(moved[:, 1], blend[:, None] * OFFSET, rtol=1e-12, atol=1e-15)
    assert not moved[:, 2].any()
    assert not moved[[0, 1, 10, 11]].any()
    np.testing.assert_allclose((positions + moved)[4:8, 0], np.tile(OFFSET, (4, 1)), rtol=1e-12)


def test_blocks_of_frames_are_parts_of_all():
    moving = Motion("target", VALUES, KEYS)
    drag = drag_of(moving, Motion("pin"), hold=range(4, 8), falloff=3)
    positions = np.stack([POSITIONS, POSITIONS + 1], axis=1)
    blocks = [drag.displacements(FRAMES[k : k + 5], positions[k : k + 5]) for k in (0, 5, 10)]
    np.testing.assert_array_equal(np.concatenate(blocks), drag.displacements(FRAMES, positions))


def test_motions_are_averaged_by_shares():
    other = np.array([[3.0, 0.0, 0.0]])
    anchor = Anchor("a + b", point_at_vertex(box(), 0))
    mover = ScheduledAnchor(
        anchor,
        ("a", "b"),
        (Motion("target", OFFSET), Motion("target", other)),
        np.array([0.25, 0.75]),
    )
    np.testing.assert_allclose(
        mover.targets(FRAMES, POSITIONS), np.tile(0.25 * OFFSET + 0.75 * other, (12, 1)), rtol=1e-15
    )


@pytest.mark.parametrize("kind", ["screen.target", "screen.offset"])
def test_a_point_behind_the_camera_is_named(kind):
    drag = drag_of(Motion("pin"), Motion(kind, np.array([[1.0, 2.0]]), camera=STANDING))
    positions = np.stack([POSITIONS, POSITIONS], axis=1)
    positions[6, 1] += [2, 4, 18]
    with pytest.raises(HandlesError, match=f"^handle 'h1': {kind}: frame 106: .* behind"):
        drag.targets(FRAMES + 100, positions)


def test_a_target_too_far_away_is_named():
    motions = (Motion("pin"), Motion("offset", np.array([[1e50, 0.0, 0.0]])))
    positions = np.zeros((12, 2, 3))
    assert np.isfinite(drag_of(*motions).targets(FRAMES, positions)).all()
    positions[9, 1] = 1e49
    with pytest.raises(HandlesError, match=r"^handle 'h1': offset: frame 9: .* 1e\+50"):
        drag_of(*motions).targets(FRAMES, positions)
