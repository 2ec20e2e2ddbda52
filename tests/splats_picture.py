"""Draw the walker as Gaussian splats: at rest, moved, and moved without their shapes.

Usage: ``python -m tests.splats_picture OUT.png [SPLATS]``
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from cageik_cli import bind, extract, load_clip, load_mesh
from cageik_cli.formats.ply_points import parse_points, read_splats
from cageik_cli.geometry.points import PointCloud
from cageik_cli.inputs.reconstruction import PointReconstruction
from cageik_cli.method.points.motion import PointMotion
from cageik_cli.method.points.oriented import Oriented
from cageik_cli.method.weights.binding import Binding, Poses
from cageik_cli.util.arrays import Floats
from tests.splat_renderer import Camera, render
from tests.splats import encode_rows, make_splat_rows

WALKER = Path(__file__).parent.parent / "data_fixtures" / "walker"
PIXELS = 480


def stretch_cage(cage: Floats) -> Floats:
    """A cage whose upper half is bent sideways and stretched."""
    low, high = cage.min(axis=0), cage.max(axis=0)
    up = int((high - low).argmax())
    share = np.clip((cage[:, up] - low[up]) / (high - low)[up] - 0.4, 0, 1)
    moved = cage.copy()
    moved[:, up] += 0.9 * share * (high - low)[up]
    moved[:, (up + 2) % 3] += 0.6 * share**2 * (high - low)[up]
    return moved


def main(arguments: list[str]) -> int:
    """Write the picture."""
    target, count = Path(arguments[0]), int((arguments[1:] or ["12000"])[0])
    rest, cage = load_mesh(WALKER / "frames/walker_1.obj"), load_mesh(WALKER / "cage.obj")
    points = parse_points(encode_rows(make_splat_rows(rest, count, 3)))
    cloud = PointCloud.from_points(points.positions)
    binding: Binding = bind(cloud, cage)
    motion = PointMotion(binding, Oriented(splats=read_splats(points)), 1 << 30, 2)
    clip = load_clip(WALKER / "frames")
    walk = extract(clip, bind(clip.first, cage)).cages[20]
    panels = [points.rows]
    for pose in (walk, stretch_cage(cage.vertices)):
        rows = points.rows.copy()
        PointReconstruction(motion, 2).fill_rows(rows[None], Poses(pose[None]))
        panels.append(rows)
    kept = panels[2].copy()
    for name in kept.dtype.names:
        if name.startswith(("scale_", "rot_", "f_rest_")):
            kept[name] = points.rows[name]
    panels.append(kept)
    pictures = [render(rows, _look_at(rows), PIXELS) for rows in panels]
    image = Image.fromarray((np.clip(np.hstack(pictures), 0, 1) * 255).astype(np.uint8))
    draw = ImageDraw.Draw(image)
    labels = ("at rest", "frame 21 of the walk", "stretched", "stretched, places alone")
    for k, label in enumerate(labels):
        draw.text((PIXELS * k + 12, PIXELS - 22), label, fill=(60, 60, 60))
    image.quantize(256).save(target, "PNG", optimize=True)
    return 0


def _look_at(rows: np.ndarray) -> Camera:
    places = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
    low, high = places.min(axis=0), places.max(axis=0)
    angle = np.radians(30)
    axes = np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    return Camera(axes, (low + high) / 2, 1.1 * float(np.ptp(places @ axes.T, axis=0)[:2].max()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
