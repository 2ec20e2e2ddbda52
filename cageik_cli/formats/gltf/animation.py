"""Animations: what their samplers give at a time, and the frames that they are sampled at."""

from dataclasses import dataclass
from functools import cached_property
from math import floor

import numpy as np

from cageik_cli.formats.base.scene_graph import find_step
from cageik_cli.formats.gltf.document import Document, Item, count_rows, read_floats
from cageik_cli.formats.gltf.nodes import TRS_WIDTHS, NodeTree
from cageik_cli.formats.settings import GLTF_RATE_KEY, SceneHints
from cageik_cli.formats.timeline import MAX_TIMELINE_NUMBER
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FormatError, SettingError
from cageik_cli.util.messages import Hint, Said, say

DEFAULT_SAMPLING_RATE = 24.0
"""Frames per second at which animations are sampled, as glTF states none."""

MAX_SAMPLED_TIMES = 100_000
"""Frames between the first and the last key."""

KEY_TOL = 1e-6
"""Times this near to a key, of it or of a second, are at the key: files have single precision.

That is at most a tenth of a frame, and of the way to another key: mocap may count from midnight.
"""

_INTERPOLATIONS = ("LINEAR", "STEP", "CUBICSPLINE")


@dataclass(frozen=True, eq=False)
class Sampler:
    """Values at keys, and between them.

    Attributes
    ----------
    keys : (k,) float64
        Seconds, ascending; a time that is there twice is a jump.
    values : (k, width) or (k, 3, width) float64
        The latter of splines: in-tangent, value, out-tangent.
    is_rotation : bool
        Whether values are quaternions, which turn at an even speed on the shorter way.
    """

    keys: Floats
    values: Floats
    interpolation: str
    is_rotation: bool

    def evaluate(self, time: float) -> Floats:
        """Return the value at a time, (width,); before the first key and after the last, theirs."""
        k, part = self._locate(time)
        if self.interpolation == "CUBICSPLINE":
            return self._evaluate_spline(k, part)
        if part == 0 or self.interpolation == "STEP":
            return np.asarray(self.values[k])
        start, stop = self.values[k], self.values[k + 1]
        if self.is_rotation:
            return turn_between(start, stop, part)
        return np.asarray(start + part * (stop - start))

    def _locate(self, time: float) -> tuple[int, float]:
        """Return the last key that is not after a time, and the part of the way to the next."""
        keys = self.keys
        tolerance = find_tolerance(time, self._shortest_step)
        k = int(np.searchsorted(keys, time + tolerance, "right")) - 1
        if k < 0 or k == len(keys) - 1 or time - keys[k] <= tolerance:
            return max(k, 0), 0.0
        return k, float((time - keys[k]) / (keys[k + 1] - keys[k]))

    @cached_property
    def _shortest_step(self) -> float:
        steps = np.diff(self.keys)
        return float(min(steps[steps > 0], default=np.inf))

    def _evaluate_spline(self, k: int, t: float) -> Floats:
        value = self.values[k, 1]
        if t == 0:
            return np.asarray(value)
        step, after = self.keys[k + 1] - self.keys[k], self.values[k + 1]
        t2, t3 = t * t, t * t * t
        return np.asarray(
            (2 * t3 - 3 * t2 + 1) * value
            + step * (t3 - 2 * t2 + t) * self.values[k, 2]
            + (3 * t2 - 2 * t3) * after[1]
            + step * (t3 - t2) * after[0]
        )


def find_tolerance(time: float, step: float) -> float:
    """Return how near to a time a key is at it; a step is that of keys, or of frames."""
    return min(KEY_TOL * max(1.0, abs(time)), 0.1 * step)


def turn_between(start: Floats, stop: Floats, part: float) -> Floats:
    """Return the quaternion (4,) a part of the shorter way from one to another."""
    start, stop = (one / (np.linalg.norm(one) or 1.0) for one in (start, stop))
    if start @ stop < 0:
        stop = -stop
    # The half angle between them from both chords, as the arc cosine is inexact near 0.
    angle = 2 * np.arctan2(np.linalg.norm(stop - start), np.linalg.norm(stop + start))
    if np.sin(angle) < 1e-12:
        return np.asarray(start + part * (stop - start))
    return np.asarray(
        (np.sin((1 - part) * angle) * start + np.sin(part * angle) * stop) / np.sin(angle)
    )


class Animation:
    """What one of the animations of a file moves; None moves nothing.

    Attributes
    ----------
    notes : list of str or Text
        What is not read.
    """

    def __init__(
        self, document: Document, tree: NodeTree, item: Item | None, target_counts: dict[int, int]
    ) -> None:
        """Read the channels.

        Parameters
        ----------
        target_counts : dict
            How many morph targets the mesh of each node has, by the number of the node.
        """
        self._document, self._tree, self._target_counts = document, tree, target_counts
        self._item = item
        self._samplers: dict[tuple[int, str], Sampler] = {}
        self.notes: list[Said] = []
        self._read: dict[tuple[int, str, int], Sampler] = {}
        others: set[str] = set()
        channels = [] if item is None else item.list_items("channels")
        for channel in channels:
            target = channel.find_item("target")
            node = None if target is None else target.find_integer("node", len(document.nodes))
            path = "" if target is None else target.read_text("path")
            if node is None or path not in {*TRS_WIDTHS, "weights"}:
                others.add(path)
                continue
            self._add_channel(channel, node, path)
        if others:
            self.notes.append("channels that move no node are left out")
        if any((np.diff(each.keys) == 0).any() for each in self._samplers.values()):
            self.notes.append("some keys are at the same time, where values jump")

    def moves(self, node: int) -> bool:
        """Return whether the place of a node is animated."""
        return any((node, path) in self._samplers for path in TRS_WIDTHS)

    def evaluate_nodes(self, time: float) -> dict[str, Floats]:
        """Return the values of all nodes at a time, for `NodeTree.compute_worlds`."""
        found = {name: values.copy() for name, values in self._tree.values.items()}
        for (node, path), sampler in self._samplers.items():
            if path in found:
                found[path][node] = sampler.evaluate(time)
        return found

    def evaluate_weights(self, node: int, time: float) -> Floats | None:
        """Return the weights of the morph targets of a node at a time; None if not animated."""
        sampler = self._samplers.get((node, "weights"))
        return None if sampler is None else sampler.evaluate(time)

    def choose_times(self, fps: float | None) -> tuple[Floats, SceneHints]:
        """Return the times of the frames, (F,), and what that says of the scene.

        They are from the first to the last key, which is included to rounding. Without keys there
        is one frame, without a number.

        Parameters
        ----------
        fps : float, optional
            What cageik states in its own files if absent, or else `DEFAULT_SAMPLING_RATE`.

        Raises
        ------
        SettingError
            When there are too many.
        """
        keys = [each.keys for each in self._samplers.values()]
        if not keys:
            return np.zeros(1), SceneHints(up_axis="Y", metres_per_unit=1.0)
        first = min(float(each[0]) for each in keys)
        last = max(float(each[-1]) for each in keys)
        rate, step, stated_start = _find_stated_rate(self._item)
        if fps is not None and fps != rate:
            rate, step, stated_start = fps, 1.0, None
        tolerance = find_tolerance(max(abs(first), abs(last)), step / rate) * rate
        start = first * rate
        if abs(start - round(start)) <= tolerance:
            start = float(round(start))
        span = (last * rate - start + tolerance) / step
        count = max(1, floor(min(span, MAX_SAMPLED_TIMES)) + 1)
        if count > MAX_SAMPLED_TIMES:
            raise SettingError(
                f"its keys are from {first:g} to {last:g} s, which is {span:.0f} frames at "
                f"{rate:g} per second, expected at most {MAX_SAMPLED_TIMES}; "
                + say("give a lower `fps=`")
            )
        if fps is None:
            self._note_other_rate(np.unique(np.concatenate(keys)), rate / step)
        number = start if stated_start is None else stated_start
        hints = SceneHints(rate, number, "Y", 1.0, None if step == 1 else step)
        return np.asarray((start + step * np.arange(count)) / rate), hints

    def _note_other_rate(self, keys: Floats, fps: float) -> None:
        """Note even keys between which the frames fall."""
        step = find_step(keys) if len(keys) > 2 else None
        rate = 0.0 if step is None else round(1 / step, 3)
        if rate and abs(fps / rate - round(fps / rate)) > KEY_TOL:
            self.notes.append(
                f"its keys are {rate:g} per second, and it is sampled at {fps:g}; "
                + Hint("fps", f"{rate:g}")
                + " takes the keys as they are"
            )

    def _add_channel(self, channel: Item, node: int, path: str) -> None:
        width = TRS_WIDTHS.get(path) or self._target_counts.get(node, 0)
        if not width:
            self.notes.append(f"nodes[{node}] has no morph targets for its animated weights")
            return
        if (node, path) in self._samplers:
            raise FormatError(
                f"{channel.place} moves {path} of nodes[{node}] a second time; export the file "
                "again"
            )
        if path in TRS_WIDTHS and node in self._tree.matrices:
            raise FormatError(
                f"nodes[{node}] has a matrix, and its {path} is animated, expected translation, "
                "rotation and scale; export it again"
            )
        assert self._item is not None
        samplers = self._item.list_items("samplers")
        number = channel.read_integer("sampler", len(samplers))
        known = number, path, width
        if known not in self._read:
            self._read[known] = self._read_sampler(samplers[number], path, width)
        self._samplers[node, path] = self._read[known]

    def _read_sampler(self, item: Item, path: str, width: int) -> Sampler:
        document = self._document
        interpolation = item.read_text("interpolation") or "LINEAR"
        if interpolation not in _INTERPOLATIONS:
            expected = f"one of {', '.join(_INTERPOLATIONS)}"
            raise item.make_error("interpolation", interpolation, expected)
        count = len(document.accessors)
        keys = read_floats(document, item.read_integer("input", count), (1,), needs_float=True)
        document.claim(8 * len(keys))
        keys = keys[:, 0].astype(np.float64)
        late = np.flatnonzero(np.diff(keys) < 0)
        if not np.isfinite(keys).all() or len(late):
            where = f"key {late[0] + 1} is at {keys[late[0] + 1]:g} s, after" if len(late) else ""
            why = f"{where} one at {keys[late[0]]:g} s" if where else "they are not all finite"
            raise FormatError(
                f"{item.locate('input')} are not ascending times ({why}); export the file again"
            )
        output = item.read_integer("output", count)
        is_spline = interpolation == "CUBICSPLINE"
        widths = (width,) if path in TRS_WIDTHS else (1,)
        per_key = (3 if is_spline else 1) * (1 if path in TRS_WIDTHS else width)
        if count_rows(document, output) != len(keys) * per_key:
            raise FormatError(
                f"{item.locate('output')} has {count_rows(document, output)} values, expected "
                f"{len(keys) * per_key} for {len(keys)} keys; export the file again"
            )
        values = read_floats(document, output, widths)
        document.claim(8 * values.size)
        values = values.astype(np.float64)
        if not np.isfinite(values).all():
            raise FormatError(
                f"{item.locate('output')} has values that are not finite; export it again"
            )
        shape = (len(keys), 3, width) if is_spline else (len(keys), width)
        return Sampler(keys, values.reshape(shape), interpolation, path == "rotation")


def _find_stated_rate(item: Item | None) -> tuple[float, float, float | None]:
    """Return the frames per second, and step and first of frame numbers that cageik has written.

    A file without the first has its frames at the times of their numbers.
    """
    extras = None if item is None else item.values.get("extras")
    stated = extras.get(GLTF_RATE_KEY) if isinstance(extras, dict) else None
    if isinstance(stated, list) and len(stated) in (2, 3):
        rate, step, *start = stated
        is_number = all(isinstance(x, int | float) for x in stated)
        if is_number and all(0 < x < MAX_SAMPLED_TIMES for x in (rate, step)):
            is_late = start and abs(start[0]) >= MAX_TIMELINE_NUMBER
            first = float(start[0]) if start and not is_late else None
            return float(rate), float(step), first
    return DEFAULT_SAMPLING_RATE, 1.0, None
