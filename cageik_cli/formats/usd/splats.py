"""USD: Gaussian splats as a ParticleField3DGaussianSplat, which is in USD from 26.03 on."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.ply_points import COLOURS, SCALES, TURNS, PointFile, rest_names
from cageik_cli.formats.usd.library import capture_diagnostics, require_usd
from cageik_cli.formats.usd.writer import UsdWriter, compute_extent
from cageik_cli.method.points.oriented import REST_COUNTS
from cageik_cli.util.errors import MissingLibraryError, OutputError

SCHEMA = "ParticleField3DGaussianSplat"


class UsdSplatWriter(UsdWriter):
    """Writes rows of splats at the time code of each frame, of the prim `/NAME/NAME`.

    Standard deviations and opacities are written as themselves, not as logarithms and logits, and
    the constant coefficients of a colour before the others.
    """

    def __init__(self, target: Path, animation: Animation, points: PointFile) -> None:
        require_usd("writing USD")
        from pxr import UsdVol

        if not hasattr(UsdVol, SCHEMA):
            raise MissingLibraryError(
                "writing splats as USD needs usd-core 26.3 or newer: pip install -U usd-core"
            )
        self._rest = rest_names(points)
        self._splat_count = len(points.rows)
        coefficients = 1 + len(self._rest) // 3
        moving = 12 + 16 + 12 + (12 * coefficients if self._rest else 0)
        self.open_stage(target, animation, moving * self._splat_count)
        from pxr import UsdGeom, UsdVol

        with capture_diagnostics(OSError):
            stage, root = self.stage, self.root
            UsdGeom.Xform.Define(stage, root)
            prim = getattr(UsdVol, SCHEMA).Define(stage, f"{root}/{animation.name}").GetPrim()
            self._attributes = {name: prim.GetAttribute(name) for name in prim.GetPropertyNames()}
            degree = REST_COUNTS[coefficients - 1]
            self._attributes["radiance:sphericalHarmonicsDegree"].Set(degree)
            self._set("opacities", _compute_opacities(points.rows))
            if not self._rest:
                self._set_colours(points.rows)

    def append(self, frames: NDArray[Any]) -> None:
        """Write the next frames, rows (k, m)."""
        for rows in frames:
            time = self.begin_frame()
            positions = _stack(rows, ("x", "y", "z"))
            with np.errstate(over="ignore"):
                scales = np.exp(_stack(rows, SCALES))
            if not (np.isfinite(positions).all() and np.isfinite(scales).all()):
                raise OutputError(
                    "a coordinate is too large for the single precision of this format; scale "
                    "the animation, or write .ply"
                )
            with capture_diagnostics(OSError):
                self._set("positions", positions, time)
                self._set("scales", scales, time)
                self._set("orientations", _stack(rows, TURNS), time)
                # Each splat is taken to three of its largest standard deviation.
                radii = 3.0 * scales.max(axis=1, keepdims=True)
                self._attributes["extent"].Set(
                    compute_extent(np.concatenate([positions - radii, positions + radii])), time
                )
                if self._rest:
                    self._set_colours(rows, time)

    def _set_colours(self, rows: NDArray[Any], time: float | None = None) -> None:
        """Write all coefficients of each splat together: the constant ones, then the bands."""
        colours = _stack(rows, self._rest).reshape(self._splat_count, 3, -1)
        constant = _stack(rows, COLOURS)[:, :, None]
        grouped = np.concatenate([constant, colours], axis=2).transpose(0, 2, 1)
        self._set("radiance:sphericalHarmonicsCoefficients", grouped.reshape(-1, 3), time)

    def _set(self, name: str, values: NDArray[np.float32], time: float | None = None) -> None:
        from pxr import Usd, Vt

        kinds = {1: Vt.FloatArray, 3: Vt.Vec3fArray, 4: Vt.QuatfArray}
        kind = kinds[1 if values.ndim == 1 else values.shape[1]]
        if kind is Vt.QuatfArray:
            values = np.roll(values, -1, axis=1)  # arrays of USD have the real part last
        array = kind.FromNumpy(np.ascontiguousarray(values))
        self._attributes[name].Set(array, Usd.TimeCode.Default() if time is None else time)


def _stack(rows: NDArray[Any], names: tuple[str, ...]) -> NDArray[np.float32]:
    """Return some properties as float32, (m, count)."""
    found = np.empty((len(rows), len(names)), np.float32)
    with np.errstate(over="ignore"):  # positions are checked, the others are never as large
        for k, name in enumerate(names):
            found[:, k] = rows[name]
    return found


def _compute_opacities(rows: NDArray[Any]) -> NDArray[np.float32]:
    """Return the opacities, (m,), whose logits the rows have."""
    with np.errstate(over="ignore"):
        return (1 / (1 + np.exp(-rows["opacity"].astype(np.float64)))).astype(np.float32)
