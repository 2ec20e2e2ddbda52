"""What edits are applied to: a pose or an animation, and the meshes of its cages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cageik_cli.formats.settings import Scene
from cageik_cli.formats.timeline import Timeline
from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, anchor_positions
from cageik_cli.method.weights.binding import Binding, reconstruct
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class EditTarget:
    """The pose or the animation that layers are applied to, and the meshes of its cages.

    A cage gives the mesh `base_mesh + weights @ (cage - base_cage)`. Of a binding that has offsets,
    the base mesh turns with each frame of an animation.

    Attributes
    ----------
    cage_at : callable
        The cage of a frame, (n, 3), by its index.
    base_cage : (n, 3) float64
    base_mesh : (m, 3) float64
        The mesh that `base_cage` gives exactly, whatever `weights @ base_cage` is. If both are
        zeros, meshes are `weights @ cages`.
    rotations : (F, 3, 3) float64, optional
        Of the rest pose to each frame: `points @ R`. None for frames that do not turn.
    frame_names : sequence of str, optional
        None for a single pose, whose only frame is 0.
    up_axis : str
        "Y" or "Z", for drawings.
    timeline : Timeline, optional
        The numbers of the frames, which are counted from 0 here; None for a single pose.
    """

    binding: Binding
    cage_at: Callable[[int], Floats]
    base_cage: Floats
    base_mesh: Floats
    rotations: Floats | None = None
    frame_names: Sequence[str] | None = None
    up_axis: str = "Y"
    timeline: Timeline | None = None

    @classmethod
    def of_model(cls, binding: Binding) -> "EditTarget":
        """Return the rest pose of a model, which the rest cage gives bit for bit."""
        cage = binding.cage.vertices
        return cls(binding, lambda _: cage, cage, binding.rest.vertices)

    @classmethod
    def of_animation(
        cls,
        binding: Binding,
        cage_at: Callable[[int], Floats],
        frame_names: Sequence[str],
        rotations: Floats | None = None,
        scene: Scene | None = None,
    ) -> "EditTarget":
        """Return an animation whose meshes are the reconstructions of a result, `weights @ cages`.

        With the rotations of its frames, (F, 3, 3), they have the offsets of the binding, too, and
        mirror planes turn with them.
        """
        m, n = binding.weights.shape
        base = np.zeros((m, 3)) if binding.offsets is None else binding.offsets
        scene = scene or Scene()
        timeline = scene.make_timeline(len(frame_names))
        still = np.zeros((n, 3))
        return cls(binding, cage_at, still, base, rotations, frame_names, scene.up_axis, timeline)

    def name_frame(self, frame: int) -> str:
        """Return the name of a frame; "" for a single pose."""
        return self.frame_names[frame] if self.frame_names else ""

    def deform(self, frames: Integers, cages: Floats) -> Floats:
        """Return the meshes (k, m, 3) of the cages (k, n, 3) of frames (k,)."""
        meshes = reconstruct(self.binding.weights, cages - self.base_cage)
        meshes += self._turn(self.base_mesh, frames)
        return meshes

    def anchor_positions(
        self, anchors: Sequence[Anchor], frames: Integers, cages: Floats
    ) -> Floats:
        """Return the positions of anchors on the meshes of the cages of frames, as (k, l, 3)."""
        rows = anchor_matrix(anchors, self.binding.weights)
        base = self._turn(anchor_positions(anchors, self.base_mesh), frames)
        return np.asarray(base + rows @ (cages - self.base_cage))

    def _turn(self, points: Floats, frames: Integers) -> Floats:
        """Return points of the base mesh, (p, 3), in each frame: (k, p, 3), or as they are."""
        if self.rotations is None or self.binding.offsets is None:
            return points
        return np.asarray(points @ self.rotations[frames])
