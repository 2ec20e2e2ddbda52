"""Draw how programs light a skinned walker: the input, morph targets, and joints of both kinds.

python data_fixtures/make_rig_pictures.py [OUT_FOLDER]

Without a folder the picture goes to `pictures` beside this file. All panels show one frame, lit
from the side. Skins have four influences; a skin is lit by the normals of the rest pose, as its
joints turn them. The angles between these and the normals of the input are printed.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from cageik_cli import load_clip, read_result
from cageik_cli.geometry.shape import compute_vertex_normals
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.report.render.model_views import project_surface, view_axes
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import (
    MESH_COLOURS,
    SAMPLES_PER_PIXEL,
    downsample,
    parse_colour,
)
from cageik_cli.rigs.joints import turn_normals
from cageik_cli.run.rig import make_rig
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.progress import ProgressListener

FIXTURES = Path(__file__).resolve().parent
FRAMES, CAGE = FIXTURES / "walker" / "frames", FIXTURES / "walker" / "cage.obj"

FRAME = 30
"""The frame that is drawn, from 0: both legs are bent."""

TURN = 50.0
"""Degrees by which the figure is turned about the vertical."""

LIGHT = np.array([0.93, 0.25, 0.27])
"""Towards the light: right, up, towards the viewer."""

HEIGHT, WIDTH = 420, 250
"""Pixels of a panel."""

Panel = tuple[Floats, Floats]
"""Positions and normals of the vertices, (m, 3) each."""


def make_panels() -> tuple[list[Panel], Integers]:
    """Extract the walker, make its skins, and return what each panel shows, and the faces."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "walker.h5"
        words = ["extract", str(FRAMES), "--cage", str(CAGE), "--fit", "-o", str(output), "-q"]
        subprocess.run([sys.executable, "-m", "cageik_cli", *words], check=True)
        result = read_result(output)
        target = CagedModel.of_result(result).read_reconstruction("a skeleton")
        rigs = [
            make_rig(result, target, ProgressListener(), influences=4, name=name, joints=name)
            for name in ("translate", "turn")
        ]
        rest = result.rest
        original = load_clip(str(FRAMES)).read_frame(FRAME)
        shapes = [original, target.read_frame(FRAME)]
        panels = [(shape, compute_vertex_normals(rest.polygons, shape)) for shape in shapes]
        normals = compute_vertex_normals(rest.polygons, rest.vertices)
        for rig in rigs:
            blocks = list(rig.blocks())
            meshes = np.concatenate([block.meshes for block in blocks])
            weights = rig.skin.weights.to_dense(len(result.cage.vertices))
            every = [b.rotations[:, None] if b.turns is None else b.turns for b in blocks]
            turns = np.broadcast_to(np.concatenate(every)[FRAME, None], (1, weights.shape[1], 3, 3))
            panels.append((meshes[FRAME], turn_normals(normals, weights, turns)[0]))
    for name, (_, found) in zip(("input", "morphs", "translate", "turn"), panels, strict=True):
        angles = np.degrees(np.arccos((found * panels[0][1]).sum(axis=1).clip(-1, 1)))
        print(f"{name}: normals {np.sqrt(np.mean(np.square(angles))):.1f} degrees off")
    return panels, result.rest.faces


def draw(panels: list[Panel], faces: Integers) -> Image.Image:
    """Draw the panels from left to right."""
    axes = view_axes("Y", TURN)
    positions = np.vstack([panel[0] for panel in panels])
    camera = ParallelCamera.fit(axes, positions, SAMPLES_PER_PIXEL * HEIGHT)
    cut = slice((HEIGHT - WIDTH) // 2, (HEIGHT + WIDTH) // 2)
    drawn = [draw_panel(camera, *panel, faces)[:, cut] for panel in panels]
    return Image.fromarray(np.concatenate(drawn, axis=1))


def draw_panel(
    camera: ParallelCamera, positions: Floats, normals: Floats, faces: Integers
) -> np.ndarray:
    """Draw a mesh that is lit by the given normals, before white, (h, h, 3) uint8."""
    surface = project_surface(camera, positions, faces)
    seen = (normals @ camera.axes.T).T
    lit = np.stack([surface.interpolate(along) for along in seen])
    lit /= np.maximum(np.linalg.norm(lit, axis=0), 1e-12)
    bright = 0.12 + 0.88 * np.maximum(LIGHT @ lit, 0)
    size = len(surface.depth)
    picture = np.zeros((4, size * size), np.float32)
    colour = parse_colour(MESH_COLOURS["input"])
    picture[:3, surface.pixels] = colour[:, None] * bright
    picture[3, surface.pixels] = 1
    *planes, opacity = downsample(picture.reshape(4, size, size))
    shown = np.stack(planes, axis=-1) * opacity[..., None] + 1 - opacity[..., None]
    return np.round(255 * np.clip(shown, 0, 1)).astype(np.uint8)


def main(arguments: list[str]) -> int:
    """Run the command line; return its exit code."""
    if len(arguments) > 1 or any(argument.startswith("-") for argument in arguments):
        print(__doc__)
        return 2
    folder = Path(arguments[0]) if arguments else FIXTURES / "pictures"
    folder.mkdir(parents=True, exist_ok=True)
    draw(*make_panels()).save(folder / "rig_shading.webp", "WEBP", quality=80, method=6)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
