"""Draw the walker before and after it greets, and a limb that is bent with and without rigidity.

Usage: ``python data_fixtures/make_pose_pictures.py [OUT_FOLDER]``; without a folder the pictures go
to ``pictures`` beside this file, as ``pose.png`` and ``limb.png``.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from handles import GREETING, Handle
from make_picture import write
from matplotlib.figure import Figure
from meshes import Points

from cageik_cli.cages.bind import bind
from cageik_cli.editing.summary import PoseSnapshot
from cageik_cli.formats.open import load_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.anchors import (
    Anchor,
    SurfacePoint,
    anchor_positions,
    point_at_vertex,
    point_on_face,
)
from cageik_cli.method.pose.poser import Poser
from cageik_cli.method.weights.binding import Binding
from cageik_cli.report.plots.model_plot import Panel, draw_pose
from cageik_cli.report.plots.style import use_fixed_style

HERE = Path(__file__).resolve().parent

RIGIDITY = 10
"""Of the walker's pose."""
ROUNDS = (0, 10, 50)
"""Of the limb's, a panel each."""
PIXELS, NARROW = 720, 440
"""Across a panel of the walker, and of the limb."""

LONG, THICK = 2.0, 0.16
"""The limb's length and radius."""
TIP = (1.2, -1.1, 0.0)
"""How far the limb's tip goes."""


@dataclass(frozen=True, eq=False)
class Task:
    """Anchors on a model, and where they are to go.

    Attributes
    ----------
    binding : Binding
    anchors : tuple of Anchor
    targets : (l, 3) float64
    pinned : (l,) bool
    """

    binding: Binding
    anchors: tuple[Anchor, ...]
    targets: Points
    pinned: np.ndarray

    @classmethod
    def of(cls, binding: Binding, handles: list[Handle]) -> Task:
        """Return what handles ask for."""
        rest = binding.rest
        anchors = tuple(Anchor(handle["name"], _point(rest, handle)) for handle in handles)
        starts = anchor_positions(anchors, rest.vertices)
        targets = [
            handle.get("target", start + handle.get("offset", 0.0))
            for handle, start in zip(handles, starts, strict=True)
        ]
        pinned = np.array([handle.get("pin", False) for handle in handles])
        return cls(binding, anchors, np.array(targets), pinned)

    @property
    def starts(self) -> Points:
        """Return where the anchors are at rest."""
        return anchor_positions(self.anchors, self.binding.rest.vertices)

    def before(self, title: str) -> Panel:
        """Return the rest pose, with arrows."""
        binding = self.binding
        return Panel(binding.rest.vertices, binding.cage.vertices, self.starts, True, title)

    def after(self, rigidity: int, title: str) -> Panel:
        """Return the pose with so many rounds of rigidity."""
        binding = self.binding
        cage = Poser(binding, self.anchors).solve_cage(self.targets - self.starts, rigidity)
        mesh = binding.rest.vertices + binding.weights @ (cage - binding.cage.vertices)
        return Panel(mesh, cage, anchor_positions(self.anchors, mesh), False, title)

    def view(self, before: Panel, after: Panel) -> PoseSnapshot:
        """Return two panels as one view."""
        return PoseSnapshot(
            frame="",
            faces=self.binding.rest.faces,
            cage_faces=self.binding.cage.faces,
            before=before.vertices,
            after=after.vertices,
            cage_before=before.cage,
            cage_after=after.cage,
            starts=self.starts,
            targets=self.targets,
            ends=after.anchors,
            names=tuple(anchor.name for anchor in self.anchors),
            pinned=self.pinned,
            up_axis="Y",
            rms_percent=0.0,
            max_residual_percent=0.0,
        )


def _point(mesh: TriMesh, handle: Handle) -> SurfacePoint:
    if "vertex" in handle:
        return point_at_vertex(mesh, handle["vertex"])
    return point_on_face(mesh, handle["face"], np.array(handle["barycentric"]))


def greeting() -> Figure:
    """Draw the walker at rest, and greeting."""
    rest = load_mesh(HERE / "walker" / "frames" / "walker_1.obj").mesh
    task = Task.of(bind(rest, load_mesh(HERE / "walker" / "cage.obj").mesh), GREETING)
    before, after = task.before("before"), task.after(RIGIDITY, f"after, rigidity {RIGIDITY}")
    return draw_pose(task.view(before, after), (before, after), PIXELS)


def limb() -> Figure:
    """Draw a limb at rest, and bent by the same anchors in several rounds of rigidity."""
    rest, cage = tube(81, 32, THICK, (0.0, LONG)), tube(9, 4, 0.34, (-0.1, LONG + 0.1))
    near = {
        "tip": (0, LONG, 0),
        "base": (0, 0, 0),
        "left": (-THICK, 0.3, 0),
        "right": (THICK, 0.3, 0),
    }
    handles: list[Handle] = [
        {"name": name, "vertex": int(np.linalg.norm(rest.vertices - place, axis=1).argmin())}
        for name, place in near.items()
    ]
    handles = [handles[0] | {"offset": TIP}, *(handle | {"pin": True} for handle in handles[1:])]
    task = Task.of(bind(rest, cage), handles)
    bent = [task.after(count, f"rigidity {count}" if count else "no rigidity") for count in ROUNDS]
    bent = [replace(panel, title=f"{panel.title}: {_volume(panel, rest)}") for panel in bent]
    panels = [task.before("rest pose"), *bent]
    return draw_pose(task.view(panels[0], panels[1]), panels, NARROW)


def _volume(panel: Panel, rest: TriMesh) -> str:
    share = 100 * TriMesh(panel.vertices, rest.faces).volume / rest.volume
    return f"{share:.0f} % of the volume"


def tube(rings: int, around: int, radius: float, ends: tuple[float, float]) -> TriMesh:
    """Return a closed tube along y, of so many rings of so many vertices."""
    angles = 2 * np.pi * (np.arange(around) + 0.5) / around
    heights = np.repeat(np.linspace(*ends, rings), around)
    x, z = (np.tile(radius * turned, rings) for turned in (np.cos(angles), np.sin(angles)))
    centres = [[0.0, end, 0.0] for end in ends]
    ring, one = np.arange(around), np.roll(np.arange(around), -1)
    first = around * np.arange(rings - 1)[:, None]
    a, b, c, d = (first + part for part in (ring, one, ring + around, one + around))
    walls = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, c, b), (b, c, d))]
    low, high, last = np.full(around, rings * around), rings * around + 1, (rings - 1) * around
    caps = [np.stack([low, ring, one], axis=1)]
    caps += [np.stack([np.full(around, high), one + last, ring + last], axis=1)]
    verts = np.concatenate([np.stack([x, heights, z], axis=1), centres])
    return TriMesh(verts, np.concatenate([*walls, *caps]))


def main(arguments: list[str]) -> int:
    """Run the command line; return its exit code."""
    if len(arguments) > 1 or any(argument.startswith("-") for argument in arguments):
        print(__doc__)
        return 2
    folder = Path(arguments[0]) if arguments else HERE / "pictures"
    with use_fixed_style():
        write(greeting(), folder / "pose.png")
        write(limb(), folder / "limb.png")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
