"""Clouds of points: meshes without faces."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cageik_cli.geometry.mesh import TriMesh, make_read_only, validate_positions
from cageik_cli.util.errors import FormatError


@dataclass(frozen=True, eq=False)
class PointCloud(TriMesh):
    """A mesh that has no faces: it can be bound, moved and posed, but has no surface.

    Make one of positions, (m, 3), with `PointCloud.from_points`.

    Examples
    --------
    >>> from cageik_cli import PointCloud, bind, load_mesh
    >>> cloud = PointCloud.from_points([[0.0, 1.0, 0.0], [0.1, 1.0, 0.0]])
    >>> cloud
    <PointCloud: 2 points>
    >>> binding = bind(cloud, load_mesh("data_fixtures/walker/cage.obj"))
    >>> binding.weights.shape
    (2, 80)
    """

    def __post_init__(self) -> None:
        vertices = make_read_only(validate_positions(self.vertices))
        if np.size(self.faces):
            raise FormatError("a cloud of points has no faces; make a mesh of them")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", make_read_only(np.empty((0, 3), np.int64)))

    def __repr__(self) -> str:
        return f"<PointCloud: {len(self.vertices)} points>"

    @staticmethod
    def from_points(positions: ArrayLike) -> "PointCloud":
        """Return the cloud of positions, (m, 3).

        Raises
        ------
        InputError
            As of `TriMesh`.
        """
        return PointCloud(np.asarray(positions), np.empty((0, 3), np.int64))

    def move(self, positions: ArrayLike) -> "PointCloud":
        """Return the points at other positions, (n, 3)."""
        return self.from_points(positions)

    @cached_property
    def is_used(self) -> NDArray[np.bool_]:
        """Whether each point is part of the model, (n,): all are."""
        return np.ones(len(self.vertices), bool)

    @property
    def is_closed(self) -> bool:
        """Whether it bounds a volume: never."""
        return False
