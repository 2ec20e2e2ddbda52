"""What a pose, or an edit of an animation, came to: anchors, motion, volume, smoothness."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cageik_cli.posing.edits import Clip, EditedBlock, Layer, acting, anchors_of
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True)
class AnchorFigures:
    """How an anchor went, in the frames that its layer changes.

    Attributes
    ----------
    name : str
    layer : str
        Its layer's name; "" for that of the only one.
    moved : float
        Farthest from where it was before, file units.
    residual, residual_percent : float
        Farthest from its target when all layers are applied, file units and percent of the
        diagonal.
    frame : str
        Where that is; "" for a single pose.
    acceleration, acceleration_before : float, optional
        Largest second difference of its position, |p(k+1) − 2 p(k) + p(k−1)| over frames that
        follow each other, one of which is changed, after the edit and before; None without such.
    """

    name: str
    layer: str
    moved: float
    residual: float
    residual_percent: float
    frame: str
    acceleration: float | None
    acceleration_before: float | None


@dataclass(frozen=True, slots=True)
class PoseFigures:
    """What a pose or an edit came to; lengths in file units.

    Attributes
    ----------
    diagonal : float
        Of the rest model.
    anchors : tuple of AnchorFigures
    rms, rms_percent : float
        How far the mesh moved: sqrt(mean |v' − v|²) over vertices and frames.
    moved : float
        Farthest that a vertex moved.
    moved_least : float
        Least that a vertex moved in that frame.
    vertex : int
        Which one.
    frame : str
        Where; "" for a single pose.
    cage_moved : float
        Farthest that a cage vertex moved.
    cage_vertex : int
    volume_change_percent : float, optional
        The one of largest size, against the frame before the edit; None for an open model.
    condition_number : float
        The largest of the layers' systems.
    rigidity : int
        Rounds in which cells turned.
    changed : tuple of str, optional
        First and last frame that are not as they were.
    """

    diagonal: float
    anchors: tuple[AnchorFigures, ...]
    rms: float
    rms_percent: float
    moved: float
    moved_least: float
    vertex: int
    frame: str
    cage_moved: float
    cage_vertex: int
    volume_change_percent: float | None
    condition_number: float
    rigidity: int
    changed: tuple[str, str] | None


class PoseLedger:
    """Takes block after block, and keeps what is largest.

    Parameters
    ----------
    layers : sequence of Layer
    diagonal : float
        Of the rest model.
    """

    def __init__(self, layers: Sequence[Layer], diagonal: float) -> None:
        self._layers, self._diagonal = layers, diagonal
        self._anchors = anchors_of(layers)
        self._layer_names = [layer.name for layer in layers for _ in layer.drag.anchors]
        self._moved, self._residual = np.zeros((2, len(self._anchors)))
        self._residual_frame = np.zeros(len(self._anchors), np.int64)
        self._squares, self._count = 0.0, 0
        self._farthest, self._vertex, self._frame = 0.0, 0, 0
        self._least = 0.0
        self._cage_farthest, self._cage_vertex = 0.0, 0
        self._volume: float | None = None
        self._changed: list[int] = []
        self._bends = _Bend(), _Bend()

    def take(self, block: EditedBlock) -> None:
        """Look at the next frames, if there are any."""
        if not len(block.frames):
            return
        acts = acting(self._layers, block.frames)
        distances = np.linalg.norm(block.anchors_after - block.anchors_before, axis=2) * acts
        self._moved = np.maximum(self._moved, distances.max(axis=0))
        residuals = np.linalg.norm(block.anchors_after - block.edit.targets, axis=2) * acts
        worst, largest = residuals.argmax(axis=0), residuals.max(axis=0)
        is_worse = largest > self._residual
        self._residual_frame[is_worse] = block.frames[worst[is_worse]]
        self._residual = np.maximum(self._residual, largest)
        is_changed = (block.edit.cages != block.cages).any(axis=(1, 2))
        for bend, positions in zip(
            self._bends, (block.anchors_before, block.anchors_after), strict=True
        ):
            bend.take(block.frames, positions, is_changed)
        self._take_meshes(block)
        if is_changed.any():
            numbers = block.frames[is_changed]
            self._changed = [*self._changed[:1], int(numbers[0]), int(numbers[-1])]

    def _take_meshes(self, block: EditedBlock) -> None:
        figures = block.figures
        self._squares += float(figures.rms @ figures.rms)
        self._count += len(block.frames)
        worst = int(figures.max_deviation.argmax())
        if figures.max_deviation[worst] > self._farthest:
            self._farthest = float(figures.max_deviation[worst])
            self._vertex = int(figures.worst_vertex[worst])
            self._frame = int(block.frames[worst])
            self._least = float(np.sqrt(block.squares[worst].min()))
        distances = np.linalg.norm(block.edit.cages - block.cages, axis=2).max(axis=0)
        if distances.max() > self._cage_farthest:
            self._cage_farthest, self._cage_vertex = float(distances.max()), int(distances.argmax())
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = 100 * (figures.volume_reconstructed / figures.volume - 1)
        known = changes[np.isfinite(changes)]
        if len(known):
            largest = float(known[np.abs(known).argmax()])
            self._volume = max(self._volume or 0.0, largest, key=abs)

    def figures(self, names: Sequence[str]) -> PoseFigures:
        """The figures of all blocks; `names` are those of the frames, or none for a single pose."""

        def named(frame: int) -> str:
            return names[frame] if names else ""

        rms = float(np.sqrt(self._squares / max(1, self._count)))
        return PoseFigures(
            diagonal=self._diagonal,
            anchors=tuple(
                self._anchor(k, named(int(frame))) for k, frame in enumerate(self._residual_frame)
            ),
            rms=rms,
            rms_percent=100 * rms / self._diagonal,
            moved=self._farthest,
            moved_least=self._least,
            vertex=self._vertex,
            frame=named(self._frame),
            cage_moved=self._cage_farthest,
            cage_vertex=self._cage_vertex,
            volume_change_percent=self._volume,
            condition_number=max(layer.poser.condition_number for layer in self._layers),
            rigidity=max(layer.rigidity for layer in self._layers),
            changed=(named(self._changed[0]), named(self._changed[-1])) if self._changed else None,
        )

    def _anchor(self, k: int, frame: str) -> AnchorFigures:
        before, after = (bend.largest for bend in self._bends)
        return AnchorFigures(
            name=self._anchors[k].name,
            layer=self._layer_names[k],
            moved=float(self._moved[k]),
            residual=float(self._residual[k]),
            residual_percent=float(100 * self._residual[k] / self._diagonal),
            frame=frame,
            acceleration=None if after is None else float(after[k]),
            acceleration_before=None if before is None else float(before[k]),
        )


class _Bend:
    """The largest second differences of l positions over frames that follow each other.

    Only those count in which a frame is changed: elsewhere a clip may accelerate as it likes.

    Attributes
    ----------
    largest : (l,) float64, optional
    """

    def __init__(self) -> None:
        self.largest: Floats | None = None
        self._frames = np.empty(0, np.int64)
        self._is_changed = np.empty(0, bool)
        self._positions: Floats | None = None

    def take(self, frames: Integers, positions: Floats, is_changed: NDArray[np.bool_]) -> None:
        """Go on with positions, (k, l, 3), of frames (k,) that are changed, or not."""
        if self._positions is not None:
            frames = np.concatenate([self._frames, frames])
            positions = np.concatenate([self._positions, positions])
            is_changed = np.concatenate([self._is_changed, is_changed])
        in_row = frames[2:] - frames[:-2] == 2
        in_row &= is_changed[2:] | is_changed[1:-1] | is_changed[:-2]
        if in_row.any():
            bends = np.linalg.norm(np.diff(positions, 2, axis=0)[in_row], axis=2).max(axis=0)
            self.largest = bends if self.largest is None else np.maximum(self.largest, bends)
        self._frames, self._positions = frames[-2:], positions[-2:]
        self._is_changed = is_changed[-2:]


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """One frame before and after an edit, to be drawn.

    Attributes
    ----------
    frame : str
        Its name; "" for a single pose.
    layers : sequence of Layer
        Of the edit.
    block : EditedBlock
        Of this frame alone.
    clip : Clip
    """

    frame: str
    layers: Sequence[Layer]
    block: EditedBlock
    clip: Clip


@dataclass(frozen=True, slots=True, eq=False)
class Posed:
    """What a run came to.

    Attributes
    ----------
    figures : PoseFigures
    snapshot : Snapshot
    up_axis : str
        One of the scene's.
    """

    figures: PoseFigures
    snapshot: Snapshot
    up_axis: str
