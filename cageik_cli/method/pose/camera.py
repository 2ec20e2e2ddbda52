"""A camera: from points to pixels, and from pixels to rays and points.

Conventions are OpenGL's. Matrices act on columns: `view` takes the world to the eye, which looks
along −z with y up; `projection` takes the eye to clip space, where visible points have x, y and z
within ±1 after the division by w, and the near plane is at z = −1. Pixels are counted from the
upper left corner of the picture, x to the right and y downwards; the middle of the first is (½, ½).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import SettingError

MAX_CAMERA_CONDITION = 1e14
"""Matrices of a larger condition number count as singular."""

_TRANSPOSE_HINT = "act on columns, so transpose both if they act on rows"


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective or a parallel view of the world.

    Attributes
    ----------
    view, projection : (4, 4) float64
        World to eye, eye to clip space; they act on columns. Read-only.
    width, height : float
        Of the picture, pixels.

    Raises
    ------
    SettingError
        When a matrix has another shape, is not finite or is singular, the last row of `view` is
        not (0, 0, 0, 1), that of `projection` neither that nor (0, 0, -1, 0), or the picture has
        no size.

    Examples
    --------
    >>> import numpy as np
    >>> from cageik_cli import Camera
    >>> camera = Camera.from_look_at(
    ...     np.array([0.0, 1, 5]),
    ...     np.array([0.0, 1, 0]),
    ...     up=np.array([0.0, 1, 0]),
    ...     fov_degrees=40,
    ...     width=640,
    ...     height=480,
    ... )
    >>> camera.project(np.array([[0.0, 1, 0]]))[0, :2].round(6).tolist()
    [320.0, 240.0]
    """

    view: Floats
    projection: Floats
    width: float
    height: float

    def __post_init__(self) -> None:
        for name in ("view", "projection"):
            matrix = np.array(getattr(self, name), np.float64)
            if matrix.shape != (4, 4):
                raise SettingError(f"{name} has shape {matrix.shape}, expected (4, 4)")
            if not np.isfinite(matrix).all():
                raise SettingError(f"{name} holds numbers that are not finite")
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        if not _is_row(self.view[3], (0, 0, 0, 1)):
            raise SettingError(
                f"the last row of view is {_format_row(self.view[3])}, expected 0, 0, 0, 1; "
                f"matrices {_TRANSPOSE_HINT}"
            )
        for name, matrix in (("view", self.view[:3, :3]), ("projection", self.projection)):
            # Rows have length one, so that units and far planes do not make a matrix singular.
            sizes = np.linalg.norm(matrix, axis=1, keepdims=True)
            rows = np.divide(matrix, sizes, out=np.zeros_like(matrix), where=sizes > 0)
            if not np.linalg.cond(rows) < MAX_CAMERA_CONDITION:
                raise SettingError(f"{name} is singular; expected a matrix that can be inverted")
        last = self.projection[3]
        if not (_is_row(last, (0, 0, -1, 0)) or _is_row(last, (0, 0, 0, 1))):
            raise SettingError(
                f"the last row of projection is {_format_row(last)}, expected "
                "0, 0, -1, 0 of a perspective, or 0, 0, 0, 1 of a parallel view; matrices are "
                f"OpenGL's, and {_TRANSPOSE_HINT}"
            )
        for name in ("width", "height"):
            size = getattr(self, name)
            if not (np.isfinite(size) and size > 0):
                raise SettingError(f"{name} is {size:g}, expected a number of pixels above 0")

    @classmethod
    def from_look_at(
        cls,
        position: Floats,
        target: Floats,
        *,
        up: Floats,
        fov_degrees: float,
        width: float,
        height: float,
    ) -> Self:
        """Make a perspective camera without a far plane, which looks at a point.

        Parameters
        ----------
        position, target : (3,) float64
            Of the viewer, and the point in the middle of the picture.
        up : (3,) float64
            The direction that is up in the picture.
        fov_degrees : float
            Angle between the upper and the lower edge of the picture, above 0 and below 180.
        width, height : float
            Pixels.
        """
        away = position - target
        distance = float(np.linalg.norm(away))
        if not distance > 0:
            raise SettingError("position and look_at are the same point; move one of them")
        if not np.linalg.norm(np.cross(away, up)) > 1e-9 * distance * np.linalg.norm(up):
            raise SettingError("up is parallel to the viewing direction; choose another up")
        back = _normalize(away)
        right = _normalize(np.cross(up, back))
        axes = np.stack([right, np.cross(back, right), back])
        view = np.eye(4)
        view[:3, :3], view[:3, 3] = axes, -axes @ position
        if not 0 < fov_degrees < 180:
            raise SettingError(
                f"fov_degrees is {fov_degrees:g}, expected more than 0 and less than 180"
            )
        near = 1e-6 * distance
        scale = 1 / np.tan(np.radians(fov_degrees) / 2)
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = scale * height / width, scale
        projection[2, 2:], projection[3, 2] = (-1, -2 * near), -1
        return cls(view, projection, width, height)

    def project(self, points: Floats) -> Floats:
        """Project points, (…, 3), to x and y in pixels and a depth from −1 to 1, (…, 3).

        Raises
        ------
        SettingError
            When a point is behind the viewer, or as near as the eye.
        """
        homogeneous = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
        clip = homogeneous @ (self.projection @ self.view).T
        if not (clip[..., 3] > 0).all():
            raise SettingError("the point is behind the camera; choose another view or frame")
        x, y, depth = np.moveaxis(clip[..., :3] / clip[..., 3:], -1, 0)
        return np.stack([(1 + x) / 2 * self.width, (1 - y) / 2 * self.height, depth], axis=-1)

    def cast_rays(self, pixels: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the rays of pixels, (p, 2), from the near plane to the far plane.

        These are their origins, (p, 3), their directions of length one, away from the viewer,
        (p, 3), and their lengths, (p,), which are infinite without a far plane.
        """
        x, y = 2 * pixels[:, 0] / self.width - 1, 1 - 2 * pixels[:, 1] / self.height
        unproject, to_world = np.linalg.inv(self.projection), np.linalg.inv(self.view[:3, :3])
        near, far = (
            np.stack([x, y, np.full_like(x, depth), np.ones_like(x)], axis=1) @ unproject.T
            for depth in (-1.0, 1.0)
        )
        # This is the direction even to points at infinity, whose w is 0.
        ways = (far[:, :3] * near[:, 3:] - near[:, :3] * far[:, 3:]) @ to_world.T
        sizes = np.linalg.norm(ways, axis=1)
        with np.errstate(divide="ignore"):
            lengths = sizes / np.abs(near[:, 3] * far[:, 3])
        origins = (near[:, :3] / near[:, 3:] - self.view[:3, 3]) @ to_world.T
        return origins, ways / sizes[:, None], lengths

    def move_to_pixels(self, points: Floats, pixels: Floats) -> Floats:
        """Move points, (p, 3), at constant depth until they are seen in pixels, (p, 2).

        The ray of each pixel meets the plane through the point that is parallel to the screen
        (Savoye and Franco 2010, section 4.3).
        """
        self.project(points)
        origins, directions, _ = self.cast_rays(pixels)
        normal = self.view[2, :3]
        ahead = (points - origins) @ normal / (directions @ normal)
        return np.asarray(origins + ahead[:, None] * directions)


def _is_row(row: Floats, expected: tuple[int, ...]) -> bool:
    """Compare the last rows of matrices, which programs invert in single precision."""
    return np.allclose(row, expected, rtol=0, atol=1e-6)


def _format_row(row: Floats) -> str:
    return ", ".join(f"{value:g}" for value in row)


def _normalize(vector: Floats) -> Floats:
    return np.asarray(vector / np.linalg.norm(vector))
