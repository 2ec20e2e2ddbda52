"""Draw the walker in its cage, two frames in their extracted cages, and what a cage misses.

Usage: ``python data_fixtures/make_picture.py [OUT.png]``; without a name the picture goes to
``pictures/walker.png`` beside this file. The cages are extracted anew from the fixtures, and the
numbers in the captions are that extraction's own.
"""

from __future__ import annotations

import math
import sys
import tempfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import h5py
import matplotlib.style
import numpy as np
from gait import X_AXIS, Y_AXIS, turn
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from meshes import Points
from numpy.typing import NDArray
from PIL import Image

from cageik_cli.formats.open import open_sequence
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.run.extraction import extract
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.result import Result
from cageik_cli.util.arrays import Integers

Flags = NDArray[np.bool_]

HERE = Path(__file__).resolve().parent
SHOWN = (17, 28)
"""The frames that are shown, from 1; the last one also rebuilt."""

SIZE, DPI = (1600, 750), 100
"""Pixels across and down, and to the inch."""
PIXELS = 262
"""Pixels to a unit of length."""
GROUND = 148
"""Pixels from the lower rim to the ground that the figures stand on."""
COLUMNS = (228, 626, 980, 1356)
"""Pixels from the left rim to the middle of each panel."""
HEADINGS = (
    (30, 426, "in: animation and one cage"),
    (456, 1150, "out: that cage, posed in every frame"),
    (1180, 1570, "check: the model rebuilt"),
)
"""Pixels from the left rim where a heading's line starts and ends, and the heading."""

CAMERA = turn(X_AXIS, 12) @ turn(Y_AXIS, -30)
"""Rows: right, up and towards the camera, which stands before the figure, to its left."""
LIGHT = np.array([-0.40, 0.68, 0.62])
"""Towards the light, in the camera's axes."""

CLAY = LinearSegmentedColormap.from_list("clay", ["#5a5149", "#bdb0a1", "#fbf5ec"])
DEVIATION = LinearSegmentedColormap.from_list(
    "deviation", ["#ece6da", "#f8d48c", "#ef8f4c", "#cb3a3c", "#6d1f58"]
)
BLUE, INK, MUTED, SHADOW = "#0f62c4", "#20242a", "#59626d", "#eeece9"

PIECES = 48
"""An edge is cut into so many pieces, each wholly before the model or behind it."""
CLEARANCE = 1e-3
"""What lies no deeper than this behind the model counts as before it, in units of length."""


@dataclass(frozen=True)
class Stroke:
    """How one kind of edge and vertex is drawn.

    Attributes
    ----------
    width, dot : float
        Of edges, and across vertices, in points.
    opacity : float
    order : int
        The model has 2; what has more is drawn over it.
    """

    width: float
    dot: float
    opacity: float
    order: int


NEAR = Stroke(1.5, 4.8, 1.0, 5)
FAR = Stroke(1.1, 3.4, 0.40, 3)
COVERED = Stroke(1.0, 2.6, 0.17, 4)


@dataclass(frozen=True, eq=False)
class Walk:
    """What the extraction gave.

    Attributes
    ----------
    result : Result
    cages : (f, n, 3) float64
    weights : (m, n) float64
    frames : dict of (m, 3) float64
        The input, by the numbers in `SHOWN`.
    """

    result: Result
    cages: Points
    weights: Points
    frames: dict[int, Points]

    def error(self, frame: int) -> float:
        """Return a frame's RMS deviation in percent of the rest pose's diagonal."""
        return float(100 * self.result.metrics.rms[frame - 1] / self.result.rest.diagonal)

    def rebuilt(self, frame: int) -> Points:
        """Return the model as a frame's cage carries it."""
        return self.weights @ self.cages[frame - 1]

    def deviations(self, frame: int) -> NDArray[np.float64]:
        """Return every vertex's deviation in percent of the rest pose's diagonal."""
        misses = np.linalg.norm(self.rebuilt(frame) - self.frames[frame], axis=1)
        return np.asarray(100 * misses / self.result.rest.diagonal)


def extracted() -> Walk:
    """Extract the walker's cages."""
    clip, cage = HERE / "walker" / "frames", HERE / "walker" / "cage.obj"
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "cages.h5"
        result = extract(ExtractSettings((str(clip),), cage, output))
        with h5py.File(output) as file:
            cages, weights = file["verts"][:], file["weights"][:]
    sequence = open_sequence([str(clip)])
    return Walk(result, cages, weights, {frame: sequence.read_frame(frame - 1) for frame in SHOWN})


@dataclass(frozen=True, eq=False)
class View:
    """A panel's camera: where a point in space lies on the picture.

    Attributes
    ----------
    place : (3,) float64
        The point of the ground that is shown in the middle of the panel.
    column : float
        Pixels from the picture's left rim to that middle.
    """

    place: Points
    column: float

    @classmethod
    def of(cls, verts: Points, column: float) -> View:
        """Return the view that has a figure in the middle of a panel."""
        across = (verts @ CAMERA.T)[:, 0]
        middle = (across.min() + across.max()) / 2 - verts.mean(axis=0) @ CAMERA[0]
        place = verts.mean(axis=0) + middle * CAMERA[0]
        return cls(place * [1, 0, 1], column)

    def __call__(self, points: Points) -> Points:
        """Return (..., 3): pixels from the left, pixels from below, pixels towards the camera."""
        return PIXELS * (points - self.place) @ CAMERA.T + [self.column, GROUND, 0]


def facing(triangles: Points) -> Flags:
    """Return which projected triangles, (t, 3, 3), show their outside."""
    a, b, c = triangles[:, :, :2].transpose(1, 0, 2)
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return np.asarray(ux * vy - uy * vx > 0)


def vertex_normals(verts: Points, faces: Integers) -> Points:
    """Return the (m, 3) unit normals of a smooth surface, faces counted by area."""
    a, b, c = verts[faces].transpose(1, 0, 2)
    normals = np.zeros_like(verts)
    np.add.at(normals, faces, np.cross(b - a, c - a)[:, None])
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def brightness(verts: Points, faces: Integers) -> NDArray[np.float64]:
    """Return how bright every vertex is by Lambert's law, with some light from everywhere."""
    light = LIGHT / np.linalg.norm(LIGHT)
    falling = vertex_normals(verts, faces) @ CAMERA.T @ light
    return np.asarray(0.5 + 0.5 * falling) ** 1.4


def quartered(corners: Points) -> Points:
    """Split triangles, (t, 3, d), into four each at the middles of their sides: (4t, 3, d)."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, a.shape[1])


def draw_shadow(axes: Axes, view: View, verts: Points, faces: Integers) -> None:
    """Draw the shadow on the ground of a light from above."""
    flat = view(verts * [1, 0, 1])[faces][:, :, :2]
    axes.add_collection(PolyCollection(flat, facecolors=SHADOW, edgecolors=SHADOW, zorder=1))


def draw_surface(axes: Axes, view: View, verts: Points, faces: Integers, colors: Points) -> None:
    """Draw a closed surface, far triangles first, each in 16 parts that blend its corners' colours.

    Parameters
    ----------
    axes : Axes
    view : PanelView
    verts : (m, 3) float64
    faces : (t, 3) int64
    colors : (m, 3) float64
        Red, green and blue of every vertex.
    """
    points = view(verts)
    seen = faces[facing(points[faces])]
    seen = seen[np.argsort(points[seen][:, :, 2].mean(axis=1), kind="stable")]
    corners, shades = points[seen][:, :, :2], colors[seen]
    for _ in range(2):
        corners, shades = quartered(corners), quartered(shades)
    paint = shades.mean(axis=1)
    axes.add_collection(
        PolyCollection(corners, facecolors=paint, edgecolors=paint, linewidths=0.35, zorder=2)
    )


def covered(points: Points, triangles: Points) -> Flags:
    """Return which projected points, (k, 3), lie behind any projected triangle, (t, 3, 3)."""
    a, b, c = triangles.transpose(1, 0, 2)
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    hidden = np.zeros(len(points), bool)
    for k, point in enumerate(points):
        w = point - a
        s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
        t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
        inside = (s >= 0) & (t >= 0) & (s + t <= 1)
        deeper = w[:, 2] < s * u[:, 2] + t * v[:, 2] - PIXELS * CLEARANCE
        hidden[k] = (inside & deeper).any()
    return hidden


def draw_cage(axes: Axes, view: View, cage: TriMesh, model: TriMesh) -> None:
    """Draw a cage around its model: faint where the model covers it, pale on its far side."""
    points, triangles = view(cage.vertices), view(model.vertices)[model.faces]
    triangles = triangles[facing(triangles)]
    front = facing(points[cage.faces])
    ends, sides = cage.edges.ends, cage.edges.side_edges
    near_edge, near_vertex = np.zeros(len(ends), bool), np.zeros(len(points), bool)
    near_edge[sides[front]], near_vertex[cage.faces[front]] = True, True
    lines: dict[Stroke, list[Points]] = {NEAR: [], FAR: [], COVERED: []}
    steps = np.linspace(0, 1, PIECES + 1)[:, None]
    for (start, stop), near in zip(points[ends], near_edge, strict=True):
        stations = start + steps * (stop - start)
        hidden = covered((stations[1:] + stations[:-1]) / 2, triangles)
        changes = np.flatnonzero(np.diff(hidden)) + 1
        for first, last in pairwise([0, *changes, PIECES]):
            stroke = COVERED if hidden[first] else NEAR if near else FAR
            lines[stroke].append(stations[[first, last], :2])
    hidden = covered(points, triangles)
    dots = {NEAR: near_vertex & ~hidden, FAR: ~near_vertex & ~hidden, COVERED: hidden}
    for stroke, some in lines.items():
        look = {"color": BLUE, "alpha": stroke.opacity, "zorder": stroke.order}
        axes.add_collection(LineCollection(some, linewidths=stroke.width, **look))
        x, y, _ = points[dots[stroke]].T
        axes.scatter(x, y, s=stroke.dot**2, linewidths=0, **look)


def caption(axes: Axes, column: float, title: str, detail: str) -> None:
    """Write two lines below a panel."""
    axes.text(column, 60, title, ha="center", size=17, color=INK, weight="bold")
    axes.text(column, 24, detail, ha="center", size=16, color=MUTED)


def heading(axes: Axes, left: float, right: float, text: str) -> None:
    """Write what panels have in common above them, over a line as wide as they are."""
    axes.text((left + right) / 2, SIZE[1] - 38, text, ha="center", size=17, color=BLUE)
    axes.plot([left, right], [SIZE[1] - 52] * 2, color=BLUE, linewidth=1.2)


def draw_caged(axes: Axes, column: float, model: TriMesh, cage: TriMesh) -> None:
    """Draw a model in its cage."""
    view = View.of(cage.vertices, column)
    draw_shadow(axes, view, model.vertices, model.faces)
    colors = CLAY(brightness(model.vertices, model.faces))[:, :3]
    draw_surface(axes, view, model.vertices, model.faces, colors)
    draw_cage(axes, view, cage, model)


def draw_rebuilt(axes: Axes, column: float, walk: Walk, frame: int) -> None:
    """Draw a model as its cage carries it, coloured by deviation, with the colours' scale."""
    verts, faces = walk.rebuilt(frame), walk.result.rest.faces
    view = View.of(walk.cages[frame - 1], column)
    draw_shadow(axes, view, verts, faces)
    deviations = walk.deviations(frame)
    scale = Normalize(0, math.ceil(10 * deviations.max()) / 10)
    light = 0.6 + 0.45 * brightness(verts, faces)[:, None]
    draw_surface(
        axes, view, verts, faces, np.clip(DEVIATION(scale(deviations))[:, :3] * light, 0, 1)
    )
    place = axes.inset_axes((SIZE[0] - 68, 250, 16, 300), transform=axes.transData)
    bar = axes.figure.colorbar(ScalarMappable(scale, DEVIATION), cax=place)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=15, length=0, labelcolor=MUTED)


def picture(walk: Walk) -> Figure:
    """Draw all panels."""
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI)
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, SIZE[0]), ylim=(0, SIZE[1]))
    axes.set_axis_off()
    rest, cage = walk.result.rest, walk.result.cage
    size = f"{len(rest.vertices)} vertices, cage of {len(cage.vertices)}"
    draw_caged(axes, COLUMNS[0], rest, cage)
    caption(axes, COLUMNS[0], "rest pose in its cage", size)
    for column, frame in zip(COLUMNS[1:-1], SHOWN, strict=True):
        posed = TriMesh(walk.cages[frame - 1], cage.faces)
        error = f"error {walk.error(frame):.2f} % of the diagonal"
        draw_caged(axes, column, TriMesh(walk.frames[frame], rest.faces), posed)
        caption(axes, column, f"frame {frame}, extracted cage", error)
    last = f"frame {SHOWN[-1]}, from its cage"
    draw_rebuilt(axes, COLUMNS[-1], walk, SHOWN[-1])
    caption(axes, COLUMNS[-1], last, "deviation, % of the diagonal")
    for left, right, text in HEADINGS:
        heading(axes, left, right, text)
    return figure


def write(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG of 256 colours, with neither time nor version in it."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    path.parent.mkdir(parents=True, exist_ok=True)
    few = image.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(path, "PNG", optimize=True)


def main(arguments: list[str]) -> int:
    """Run the command line; return its exit code."""
    if len(arguments) > 1 or any(argument.startswith("-") for argument in arguments):
        print(__doc__)
        return 2
    path = Path(arguments[0]) if arguments else HERE / "pictures" / "walker.png"
    with matplotlib.style.context("default"):
        write(picture(extracted()), path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
