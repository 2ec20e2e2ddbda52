"""For how many frames in a row motion tells where occluded vertices are."""

from types import SimpleNamespace

import numpy as np
import pytest

from cageik_cli.captured.bridge import MAX_BRIDGED_FRAMES, count_bridged_frames

SAMPLED = np.array([1, 4, 9])


def cut(tracks, size=4, hidden=None, skipped=()):
    """Blocks of displacements, (F, s, 3); `hidden` says which are, (F, s)."""
    for start in range(0, len(tracks), size):
        part = tracks[start : start + size]
        weights = [
            (SAMPLED, np.ones(3) if hidden is None else 1.0 - hidden[start + k])
            for k in range(len(part))
        ]
        yield SimpleNamespace(
            start=start,
            cages=part,
            sampled=np.concatenate(list(part), axis=1),
            kept=SimpleNamespace(get_weights=weights.__getitem__),
            skipped=skipped,
        )


def swing(period, count=120, size=0.2):
    """Three vertices that swing, in diagonals."""
    times = np.arange(count)
    wave = size * np.sin(2 * np.pi * (times[:, None] / period + [0, 0.2, 0.5]))
    return wave[..., None] * [1.0, 0, 0]


def miss(tracks, length):
    """The rms distance of a cubic through the frames around, by polynomials."""
    errors, inner = [], np.arange(length)
    for start in range(2, len(tracks) - length - 1):
        nodes = np.array([-2, -1, length, length + 1])
        flat = tracks[start + nodes].reshape(4, -1)
        found = np.vander(inner, 4) @ np.linalg.solve(np.vander(nodes.astype(float), 4), flat)
        errors.append(found - tracks[start + inner].reshape(length, -1))
    squares = np.stack(errors) ** 2
    return np.sqrt(squares.sum() / (squares.size / 3))


@pytest.mark.parametrize("size", [1, 4, 120])
@pytest.mark.parametrize("period", [10, 14, 20, 40])
def test_motion_tells_as_long_as_a_cubic_misses_little(period, size):
    tracks = swing(period)
    found = count_bridged_frames(cut(tracks, size), SAMPLED, len(tracks))
    misses = [miss(tracks, length) for length in range(1, MAX_BRIDGED_FRAMES + 1)]
    expected = next((k for k, one in enumerate(misses) if one > 0.05), MAX_BRIDGED_FRAMES)
    assert found == expected


def test_slow_motion_is_bridged_as_far_as_windows_reach_and_jumps_are_not():
    assert count_bridged_frames(cut(swing(1000)), SAMPLED, 120) == MAX_BRIDGED_FRAMES
    assert count_bridged_frames(cut(swing(2.3)), SAMPLED, 120) == 0


def test_what_is_hidden_or_skipped_tells_nothing():
    """A vertex that jumps while it is hidden, and in a frame without data."""
    tracks, hidden = swing(1000), np.zeros((120, 3), bool)
    tracks[::3, 1] += 5
    hidden[:, 1] = True
    tracks[60] = 9
    found = count_bridged_frames(cut(tracks, hidden=hidden, skipped=[60]), SAMPLED, 120)
    assert found == MAX_BRIDGED_FRAMES
    assert count_bridged_frames(cut(tracks, skipped=[60]), SAMPLED, 120) == 0
    assert count_bridged_frames(cut(tracks, hidden=hidden), SAMPLED, 120) == 0


@pytest.mark.parametrize("count", [0, 1, 4])
def test_clips_that_are_too_short_tell_nothing(count):
    assert count_bridged_frames(cut(swing(40, count)), SAMPLED, count) is None
    assert count_bridged_frames(cut(swing(40, 5)), SAMPLED, 5) == 1


def test_long_clips_are_measured_in_some_places():
    """All places would give the same."""
    tracks = swing(14, 900)
    assert count_bridged_frames(cut(tracks), SAMPLED, 900) == count_bridged_frames(
        cut(tracks[:120]), SAMPLED, 120
    )
