"""A small renderer of Gaussian splats: parallel rays, sorted by depth, blended front to back."""

from dataclasses import dataclass

import numpy as np

from cageik_cli.method.points.oriented import evaluate_band
from tests.splats import covariances

C0 = 0.28209479177387814
SIGMAS = 3.0
MIN_SPREAD = 0.3
"""Added to the variance in pixels, as the first renderer of splats does."""


@dataclass(frozen=True)
class Camera:
    """Parallel rays.

    Attributes
    ----------
    axes : (3, 3)
        Rows: to the right, up, and backward.
    centre : (3,)
    width : float
        Of the picture, in units of the scene.
    """

    axes: np.ndarray
    centre: np.ndarray
    width: float

    def turn(self, rotation: np.ndarray, about: np.ndarray) -> "Camera":
        """The camera turned with the scene."""
        return Camera(self.axes @ rotation.T, rotation @ (self.centre - about) + about, self.width)


def compute_colours(rows: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The colours, (m, 3), seen along a direction."""
    count = sum(name.startswith("f_rest_") for name in rows.dtype.names) // 3
    colours = np.stack([0.5 + C0 * rows[f"f_dc_{k}"] for k in range(3)], axis=1)
    harmonics = [h for degree in (1, 2, 3) for h in evaluate_band(degree, direction)]
    for k in range(3):
        for i in range(count):
            colours[:, k] += harmonics[i] * rows[f"f_rest_{k * count + i}"]
    return np.clip(colours, 0, 1)


def render(rows: np.ndarray, camera: Camera, pixels: int = 200) -> np.ndarray:
    """A picture, (pixels, pixels, 3), on white."""
    places = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
    seen = (places - camera.centre) @ camera.axes.T
    scale = pixels / camera.width
    centre = seen[:, :2] * [scale, -scale] + (pixels - 1) / 2
    flat = camera.axes[:2] * [[scale], [-scale]]
    spread = flat @ covariances(rows) @ flat.T + MIN_SPREAD * np.eye(2)
    inverse = np.linalg.inv(spread)
    radius = SIGMAS * np.sqrt(spread[:, [0, 1], [0, 1]])
    colours = compute_colours(rows, -camera.axes[2])
    opacity = 1 / (1 + np.exp(-rows["opacity"].astype(np.float64)))
    picture, open_share = np.zeros((pixels, pixels, 3)), np.ones((pixels, pixels))
    low = np.clip(np.ceil(centre - radius), 0, pixels).astype(int)
    high = np.clip(np.floor(centre + radius) + 1, 0, pixels).astype(int)
    for splat in np.argsort(-seen[:, 2], kind="stable"):
        (left, top), (right, bottom) = low[splat], high[splat]
        if left >= right or top >= bottom:
            continue
        x = np.arange(left, right) - centre[splat, 0]
        y = (np.arange(top, bottom) - centre[splat, 1])[:, None]
        (a, b), (_, d) = inverse[splat]
        alpha = opacity[splat] * np.exp(-0.5 * (a * x * x + d * y * y) - b * x * y)
        window = open_share[top:bottom, left:right]
        picture[top:bottom, left:right] += (window * alpha)[:, :, None] * colours[splat]
        window *= 1 - alpha
    return picture + open_share[:, :, None]
