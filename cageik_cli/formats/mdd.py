"""MDD point caches: int32 F and m, the time of each frame in seconds, float32 positions."""

import struct

import numpy as np

from cageik_cli.formats.base.readers import (
    ArrayClip,
    ArrayClipFile,
    BinaryFile,
    StoredFrames,
    check_file_size,
)
from cageik_cli.formats.base.sequence import ClipRequest
from cageik_cli.formats.base.writers import Animation, PointCacheWriter
from cageik_cli.formats.settings import SceneHints, find_frame_step
from cageik_cli.util.errors import FormatError
from cageik_cli.util.messages import Said, say


class Reader(ArrayClipFile):
    """Frames of one `.mdd`, big-endian throughout."""

    suffixes = (".mdd",)

    @classmethod
    def open_clip(cls, request: ClipRequest) -> ArrayClip:
        """Find the frames and their times."""
        file = BinaryFile.open(request.path)
        frames, vertices = file.read_header(">2i", "an MDD file")
        size = 8 + 4 * frames + 12 * frames * vertices
        check_file_size(file, size, {"frames": frames, "vertices": vertices})
        float32 = np.dtype(">f4")
        scene, notes = _infer_timing(file.read_array(8, float32, (frames,)))
        stored = StoredFrames(
            file, 8 + 4 * frames, float32, frame_count=frames, vertex_count=vertices
        )
        return ArrayClip(stored, None, scene, notes)


def _infer_timing(times: np.ndarray) -> tuple[SceneHints, tuple[Said, ...]]:
    """Return frame rate and frame numbers, if the times (F,) are evenly spaced.

    They are rounded to single precision, so the simplest number is taken that rounds to them. The
    step is 1, or the smallest that makes the number of the first frame whole.
    """
    if not np.isfinite(times).all():
        frame = int(np.argmin(np.isfinite(times)))
        raise FormatError(
            f"the time of sample {frame} is {times[frame]}, expected seconds; export it again"
        )
    if len(times) == 1:
        return SceneHints(), ()
    rounding = float(np.spacing(np.abs(times).max()))
    seconds = times.astype(np.float64)
    duration = seconds[-1] - seconds[0]
    even = np.linspace(seconds[0], seconds[-1], len(seconds))
    if duration <= 0 or np.abs(seconds - even).max() > duration / (len(times) - 1) / 100 + rounding:
        note = (
            f"the times of its frames, {times[0]:g} s, {times[1]:g} s to {times[-1]:g} s, "
            "are not evenly spaced, so the frame rate is unknown; " + say("give `fps=`")
        )
        return SceneHints(), (note,)
    fps = (len(times) - 1) / duration
    fps = _simplest_number(fps, fps * rounding / duration)
    step = find_frame_step(seconds[0] * fps, rounding * fps)
    rate = float(fps * (step or 1))
    start = _simplest_number(float(seconds[0]) * rate, rounding * rate)
    return SceneHints(rate, start, frame_step=step), ()


def _simplest_number(value: float, tolerance: float) -> float:
    """Return the number of fewest decimals within the tolerance."""
    rounded = (round(value, digits) for digits in range(10))
    return next((number for number in rounded if abs(number - value) <= tolerance), value)


class Writer(PointCacheWriter):
    """Writes a sample per frame, at the time of the frame in the scene."""

    suffixes = (".mdd",)
    dtype = ">f4"

    def make_header(self, animation: Animation) -> bytes:
        """Return both counts, and the times."""
        scene = animation.scene
        numbers = scene.start + scene.frame_step * np.arange(animation.frame_count)
        counts = struct.pack(">ii", animation.frame_count, len(animation.rest.vertices))
        return counts + (numbers / scene.fps).astype(">f4").tobytes()
