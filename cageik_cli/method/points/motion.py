"""Points in a cage, with what turns with them, for any pose of the cage.

A point x goes to Σ_k w_k(x) c_k. Its normal n goes to J⁻ᵀ n, and the covariance Σ of a Gaussian
splat to J Σ Jᵀ, where J = Σ_k c_k ⊗ ∇w_k(x) is the derivative of the deformation. Weights and
gradients are computed once. Weights W that do not reproduce the rest pose X from the cage C have
offsets, which turn with a rotation R: points go to W c + (X - W C) R = W (c - C R) + X R.
"""

from collections import Counter
from collections.abc import Callable

import numpy as np

from cageik_cli.geometry.surface import closest_points, winding_numbers
from cageik_cli.method.points.oriented import Oriented, count_map_faults
from cageik_cli.method.weights.binding import Binding, Poses
from cageik_cli.method.weights.settings import COORDINATES
from cageik_cli.util.arrays import Floats, allocate_floats
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import say
from cageik_cli.util.progress import ignore_progress

MAX_MOVED_POINTS = 4096
"""Points that are moved together; constant, because last digits depend on it."""

MAX_GRADIENT_BYTES = 1 << 26
"""Bytes of gradients that are computed together: neighbours among them share near panels."""

AddGradients = Callable[[Floats, Floats], None]
"""Adds to gradients of weights, (m, n, 3), those of a change of the weights at points, (m, 3)."""


class PointMotion:
    """Moves points with a cage, and what turns with them.

    Parameters
    ----------
    binding : Binding
        Of the places of m points, with weights that have gradients.
    memory : int
        Bytes for gradients, 32 m n. More go to a temporary file.
    jobs : int
        Threads.
    progress : callable
        Called with (points done, points).
    add_gradients : callable, optional
        Adds the gradients of what was added to the computed weights.

    Attributes
    ----------
    blocks : list of slice
        The points that are moved together.

    Raises
    ------
    SettingError
        When weights of their kind have no gradients here.
    FileAccessError
        When the disk has no room for the temporary file.
    """

    def __init__(
        self,
        binding: Binding,
        oriented: Oriented,
        memory: int,
        jobs: int,
        progress: Callable[[int, int], None] = ignore_progress,
        add_gradients: AddGradients | None = None,
    ) -> None:
        kind = COORDINATES[binding.settings.coordinates]
        if kind.field is None:
            raise SettingError(
                f"splats need gradients of weights, which {binding.settings.coordinates} "
                "weights do not have here; " + say("use `coordinates=harmonic`")
            )
        self._oriented = oriented
        count, n = binding.weights.shape
        self.blocks = [
            slice(start, min(start + MAX_MOVED_POINTS, count))
            for start in range(0, count, MAX_MOVED_POINTS)
        ]
        self._stored = allocate_floats(4 * n * count, memory)
        self._cage_count = n
        self._rest, self._has_offsets = binding.cage.vertices, binding.has_offsets
        self._points = binding.rest.vertices
        # Weights of points outside the cage are those of the nearest points on it.
        points, cage = binding.rest.vertices, binding.cage
        is_outside = winding_numbers(cage, points) < 0.5
        points = np.where(is_outside[:, None], closest_points(cage, points).position, points)
        assert kind.field is not None
        solve = kind.load(kind.field, binding.settings.accuracy)
        field = solve(cage, points, jobs=jobs)
        together = max(1, MAX_GRADIENT_BYTES // (24 * n * MAX_MOVED_POINTS))
        for first in range(0, len(self.blocks), together):
            group = self.blocks[first : first + together]
            start, stop = group[0].start, group[-1].stop
            gradients = field.gradient(points[start:stop], jobs)
            if add_gradients is not None:
                add_gradients(gradients, self._points[start:stop])
            for chosen in group:
                block = self._block(chosen)
                block[0] = binding.weights[chosen].T
                block[1:] = gradients[chosen.start - start : chosen.stop - start].T
            progress(stop, count)

    @property
    def moves_splats(self) -> bool:
        """Whether the points are splats."""
        return self._oriented.splats is not None

    def move(self, chosen: slice, poses: Poses) -> tuple[Floats, list[Oriented], Counter[str]]:
        """Move the points of one of the `blocks` with the cages of poses.

        Without rotations, the offsets of weights that have them stay as at rest.

        Returns
        -------
        (k, 3, b) float64
            Places of the b points in the k frames.
        list of Oriented
            What turns with them, in each frame.
        Counter
            Of all frames, as `count_map_faults` counts.
        """
        cages, turns = poses.cages, None
        if self._has_offsets:
            still = np.broadcast_to(np.eye(3), (len(cages), 3, 3))
            turns = still if poses.rotations is None else poses.rotations
            cages = cages - self._rest @ turns
        middle = cages.mean(axis=1)
        rows = (cages - middle[:, None]).transpose(0, 2, 1).reshape(-1, self._cage_count)
        products = (rows @ self._block(chosen)).reshape(4, len(cages), 3, -1)
        places = products[0] + middle[:, :, None]
        if turns is not None:
            places += (self._points[chosen] @ turns).swapaxes(1, 2)
        rest, moved, faults = self._oriented[chosen], [], Counter[str]()
        for frame in range(len(cages)):
            maps = np.ascontiguousarray(products[1:, frame].swapaxes(0, 1))
            if turns is not None:
                maps += turns[frame].T[:, :, None]
            faults += count_map_faults(maps)
            moved.append(rest.move(maps))
        return places, moved, faults

    def _block(self, chosen: slice) -> Floats:
        """Return the weights and their gradients of a block, (4, n, b)."""
        size = 4 * self._cage_count
        held = self._stored[size * chosen.start : size * chosen.stop]
        return held.reshape(4, self._cage_count, -1)
