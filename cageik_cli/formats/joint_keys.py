"""The keys of joints in a file: of all frames, or of as few as lines between them replace.

Between two keys, translations move on a line, and rotations turn evenly about one axis (slerp). The
frame that lies furthest off becomes a key, until all are within what is allowed (Ramer 1972;
Douglas and Peucker 1973).
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.gltf.file import VectorSpool, read_rounded, round_to
from cageik_cli.util.arrays import Floats, Integers

TRANSLATION, ROTATION = "translation", "rotation"
TRACK_WIDTHS = {TRANSLATION: 3, ROTATION: 4}
"""Numbers of a translation, and of a quaternion."""

MIN_SAVED_NUMBERS = 32
"""Numbers that the description of times of their own takes the space of."""


class JointKeys:
    """Translations and rotations of joints in all frames, relative to their parents.

    They are in temporary files in `folder`, in single precision.

    Parameters
    ----------
    joint_count, turn_count : int
        Joints that translate, and those of them that turn: the first ones.
    """

    def __init__(self, folder: Path, joint_count: int, turn_count: int) -> None:
        self._spools = {
            TRANSLATION: VectorSpool(folder, joint_count, TRACK_WIDTHS[TRANSLATION]),
            ROTATION: VectorSpool(folder, turn_count, TRACK_WIDTHS[ROTATION]),
        }

    def append(self, places: NDArray[np.float32], turns: NDArray[np.float32]) -> None:
        """Keep translations (J, 3) and quaternions (T, 4), real part last, of the next frame."""
        self._spools[TRANSLATION].append(places)
        self._spools[ROTATION].append(turns)

    @property
    def frame_count(self) -> int:
        """Number of frames."""
        return self._spools[TRANSLATION].frame_count

    @property
    def track_count(self) -> int:
        """Number of tracks: one per joint that translates, and one per joint that turns."""
        return sum(spool.vertex_count for spool in self._spools.values())

    def read_frames(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Return translations (k, J, 3) and quaternions (k, T, 4) of some frames."""
        moves, turns = (spool.read_frames(start, stop) for spool in self._spools.values())
        return moves, turns

    def read_rounded_frames(self, start: int, stop: int) -> tuple[Floats, Floats]:
        """Return the same, with quaternions as they are read of 16 bits."""
        moves, turns = self.read_frames(start, stop)
        return moves, read_rounded(round_to(turns, np.int16))

    def read_tracks(self) -> Iterator[tuple[str, int, Floats]]:
        """Yield `TRANSLATION` or `ROTATION`, the joint, and its values in all frames, (F, w)."""
        for path, spool in self._spools.items():
            for first, block in spool.read_blocks(0, spool.vertex_count):
                count = block.shape[1] // spool.width
                values = block.reshape(len(block), count, spool.width)
                yield from ((path, first + k, values[:, k]) for k in range(count))

    def close(self) -> None:
        """Delete the temporary files."""
        for spool in self._spools.values():
            spool.close()


class Track:
    """Values of a joint at its keys, (k, w), and the frames of these, (k,)."""

    def __init__(self, path: str, joint: int, frames: Integers, values: Floats) -> None:
        self.path, self.joint, self.frames, self.values = path, joint, frames, values

    def evaluate(self, start: int, stop: int) -> Floats:
        """Return the values at some frames, (stop - start, w)."""
        wanted = np.arange(start, stop)
        if len(self.frames) == 1:
            return np.repeat(self.values, len(wanted), axis=0)
        after = np.searchsorted(self.frames, wanted, side="right").clip(1, len(self.frames) - 1)
        first, last = self.frames[after - 1], self.frames[after]
        shares = (wanted - first) / (last - first)
        between = interpolate_moves if self.path == TRANSLATION else interpolate_turns
        return between(self.values[after - 1], self.values[after], shares)


def reduce_track(path: str, joint: int, values: Floats, allowed: float) -> Track:
    """Keep few keys of values (F, w), which give the others within `allowed`.

    That is a distance of translations, and an angle of rotations. All keys are kept where that
    takes fewer bytes, because keys of all frames share their times.
    """
    every = np.arange(len(values))
    measure = _measure_distances if path == TRANSLATION else _measure_angles
    if measure(values, values[:1]).max() <= allowed:
        return Track(path, joint, every[:1], values[:1])
    frames = every[[0, -1]]
    while True:
        guess = Track(path, joint, frames, values[frames]).evaluate(0, len(values))
        errors = measure(values, guess)
        errors[frames] = 0
        starts = frames[:-1]  # the worst frame of each span, all spans at once
        worst = np.maximum.reduceat(errors, starts)
        spans = np.searchsorted(frames, every, side="right").clip(1, len(starts)) - 1
        is_worst = (errors > allowed) & (errors == worst[spans])
        if not is_worst.any():
            break
        frames = np.union1d(frames, every[is_worst])
    width = TRACK_WIDTHS[path]
    if (width + 1) * len(frames) + MIN_SAVED_NUMBERS > width * len(every):
        frames = every
    return Track(path, joint, frames, values[frames])


def keep_length(tracks: list[Track], keys: JointKeys) -> None:
    """Give a track its last key, in place, where no other has a key in the last frame.

    Otherwise the animation would end before.
    """
    last = keys.frame_count - 1
    if not any(track.frames[-1] == last for track in tracks):
        first = tracks[0]
        values = np.concatenate([first.values, keys.read_frames(last, last + 1)[0][:, 0]])
        tracks[0] = Track(first.path, first.joint, np.array([*first.frames, last]), values)


def evaluate_tracks(tracks: Sequence[Track], start: int, stop: int) -> tuple[Floats, Floats]:
    """Return translations (k, J, 3) and quaternions (k, T, 4) of some frames."""
    moves, turns = (
        np.stack([track.evaluate(start, stop) for track in tracks if track.path == path], axis=1)
        for path in (TRANSLATION, ROTATION)
    )
    return moves, turns


def round_track(track: Track) -> Track:
    """Return a track whose quaternions are those that are read of 16 bits."""
    if track.path == TRANSLATION:
        return track
    values = read_rounded(round_to(track.values, np.int16))
    return Track(track.path, track.joint, track.frames, values)


def interpolate_moves(start: Floats, end: Floats, shares: Floats) -> Floats:
    """Return points at shares (k,) of the lines between `start` and `end`, (k, 3)."""
    return np.asarray((1 - shares[:, None]) * start + shares[:, None] * end)


def interpolate_turns(start: Floats, end: Floats, shares: Floats) -> Floats:
    """Return quaternions at shares (k,) of the short way between `start` and `end` (slerp)."""
    start, end = _normalize(start), _normalize(end)
    cosines = (start * end).sum(axis=1, keepdims=True)
    end = np.where(cosines < 0, -end, end)
    angles = 2 * np.arctan2(
        np.linalg.norm(end - start, axis=1), np.linalg.norm(end + start, axis=1)
    )
    sines = np.sin(angles)
    is_still = sines < 1e-9  # the limit is a line
    safe = np.where(is_still, 1.0, sines)
    before = np.where(is_still, 1 - shares, np.sin((1 - shares) * angles) / safe)
    after = np.where(is_still, shares, np.sin(shares * angles) / safe)
    return _normalize(before[:, None] * start + after[:, None] * end)


def _normalize(quaternions: Floats) -> Floats:
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def _measure_distances(values: Floats, guess: Floats) -> Floats:
    return np.asarray(np.linalg.norm(values - guess, axis=1))


def _measure_angles(values: Floats, guess: Floats) -> Floats:
    """Return the angles of the rotations between quaternions, radians."""
    values = _normalize(values)
    apart, together = (np.linalg.norm(values + s * guess, axis=1) for s in (-1, 1))
    return np.asarray(4 * np.arctan2(np.minimum(apart, together), np.maximum(apart, together)))
