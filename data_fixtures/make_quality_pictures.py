"""Draw what errors of 0.1, 0.5 and 2 % look like: the walker beside its reconstruction.

python data_fixtures/make_quality_pictures.py [OUT_FOLDER]

Without a folder the pictures go to `pictures` beside this file. Each shows the frame with the
largest deviation: the input, the reconstruction, the same coloured by deviation, and a close-up of
the worst place in both. The errors are printed.
"""

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from cageik_cli import load_clip, read_cages, read_result
from cageik_cli.report.notes import MAX_FAIR_DEVIATION
from cageik_cli.report.render.model_views import choose_turn, project_surface, view_axes
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import (
    MESH_COLOURS,
    SAMPLES_PER_PIXEL,
    colour_pixels,
    downsample,
    parse_colour,
    render,
)
from cageik_cli.store.result import read_binding
from cageik_cli.util.arrays import Floats, Integers

FIXTURES = Path(__file__).resolve().parent
FRAMES = FIXTURES / "walker" / "frames"

CASES = {
    "quality_0.1.png": ("--cage-vertices", "60", "--fit"),
    "quality_0.5.png": ("--cage-vertices", "100", "--no-fit"),
    "quality_2.png": ("--cage-vertices", "20", "--no-fit"),
}
"""Pictures, and how the cages and the weights are made that have about these errors."""

HEIGHT, WIDTH = 300, 230
"""Pixels of a picture of the whole figure; a close-up is as wide as high."""

CLOSE_UP = 0.14
"""Half the width of a close-up, as a share of the diagonal."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The frame of a clip with the largest deviation.

    Attributes
    ----------
    original, reconstruction : (m, 3) float64
    deviation : (m,) float64
        Percent of the diagonal.
    faces : (t, 3) int64
    diagonal : float
    """

    original: Floats
    reconstruction: Floats
    deviation: Floats
    faces: Integers
    diagonal: float


def extract_worst_frame(options: tuple[str, ...]) -> Comparison:
    """Extract the walker, print its errors, and compare the frame of the largest deviation."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "walker.h5"
        words = ["extract", str(FRAMES), *options, "-o", str(output), "-q"]
        subprocess.run([sys.executable, "-m", "cageik_cli", *words], check=True)
        result = read_result(output)
        worst = int(np.argmax(result.metrics.max_deviation))
        reconstruction = read_binding(result).weights @ read_cages(result)[worst]
    original = load_clip(str(FRAMES)).read_frame(worst)
    diagonal = result.rest.diagonal
    deviation = 100 * np.linalg.norm(reconstruction - original, axis=1) / diagonal
    rms = 100 * np.sqrt(np.mean(np.square(result.metrics.rms))) / diagonal
    print(f"{' '.join(options)}: rms {rms:.3f} %, frame {worst + 1}: {deviation.max():.2f} %")
    return Comparison(original, reconstruction, deviation, result.rest.faces, diagonal)


def draw(shown: Comparison) -> Image.Image:
    """Draw the five panels, from left to right."""
    worst = int(np.argmax(shown.deviation))
    near = np.linalg.norm(shown.original - shown.original[worst], axis=1) < 0.03 * shown.diagonal
    axes = view_axes("Y", choose_turn(shown.original, shown.faces, near, "Y"))
    size = SAMPLES_PER_PIXEL * HEIGHT
    whole = ParallelCamera.fit(axes, np.vstack([shown.original, shown.reconstruction]), size)
    close = ParallelCamera(axes, shown.original[worst], CLOSE_UP * shown.diagonal, size)
    cut = slice((HEIGHT - WIDTH) // 2, (HEIGHT + WIDTH) // 2)
    panels = [
        draw_panel(shown, whole, shown.original)[:, cut],
        draw_panel(shown, whole, shown.reconstruction)[:, cut],
        draw_panel(shown, whole, shown.reconstruction, is_coloured=True)[:, cut],
        draw_panel(shown, close, shown.original),
        draw_panel(shown, close, shown.reconstruction),
    ]
    return Image.fromarray(np.concatenate(panels, axis=1))


def draw_panel(
    shown: Comparison, camera: ParallelCamera, vertices: Floats, *, is_coloured: bool = False
) -> np.ndarray:
    """Draw one mesh before white, (h, h, 3) uint8; colours go to `MAX_FAIR_DEVIATION`."""
    surface = project_surface(camera, vertices, shown.faces)
    colours = (
        colour_pixels(surface, shown.deviation, MAX_FAIR_DEVIATION)
        if is_coloured
        else np.tile(parse_colour(MESH_COLOURS["input"]), (len(surface.pixels), 1))
    )
    *planes, opacity = downsample(render(surface, colours))
    picture = np.stack(planes, axis=-1) * opacity[..., None] + 1 - opacity[..., None]
    return np.round(255 * np.clip(picture, 0, 1)).astype(np.uint8)


def main(arguments: list[str]) -> int:
    """Run the command line; return its exit code."""
    if len(arguments) > 1 or any(argument.startswith("-") for argument in arguments):
        print(__doc__)
        return 2
    folder = Path(arguments[0]) if arguments else FIXTURES / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    for name, options in CASES.items():
        image = draw(extract_worst_frame(options))
        few = image.quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
        few.save(folder / name, "PNG", optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
