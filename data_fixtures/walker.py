"""The walker: a figure of our own making, its cage, and 48 frames of a walk."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from blocks import Blocks, Corners, Ring, Shares, catmull_clark
from gait import DROP, Bone, Matrix, along_arm, path, pose, skeleton
from meshes import Mesh, Points, face_lines, fixed, triangulated, write_lines
from numpy.typing import NDArray

FRAMES = 48
DECIMALS = 5
FLAT = 1e-9
"""A quad whose two halves differ by less volume than this counts as flat."""
HALF: Shares = {"pelvis": 0.5, "chest": 0.5}


@dataclass(frozen=True)
class Level:
    """A cross section of the torso: four columns by two in depth.

    Attributes
    ----------
    height : float
        Where it lies; the outer columns lie higher by `rise`.
    inner, outer : float
        How far the columns stand from the middle.
    front, back : float
        Its reach in z.
    rise : float
        See `height`.
    shares : Shares
        How much of every bone moves it.
    """

    height: float
    inner: float
    outer: float
    front: float
    back: float
    rise: float
    shares: Shares


@dataclass(frozen=True)
class Figure:
    """Everything that tells the walker from its cage: sizes, ring by ring.

    Attributes
    ----------
    levels : list of Level
        The torso from the hips up; arms grow out of its topmost storey.
    leg : list of (height, x, z, half width, half depth)
        Rings from the knee down to the sole; the last two make the foot.
    toe : (height, z, half width, half height)
        The ring the foot reaches forward to.
    arm : list of (distance, half depth, half thickness)
        Rings from the elbow to the finger tips.
    head : list of (height, half width, half depth, z)
        Rings above the shoulders.
    """

    levels: list[Level]
    leg: list[tuple[float, float, float, float, float]]
    toe: tuple[float, float, float, float]
    arm: list[tuple[float, float, float]]
    head: list[tuple[float, float, float, float]]


WALKER = Figure(
    levels=[
        Level(0.79, 0.055, 0.250, 0.135, -0.145, 0.02, {"pelvis": 1.0}),
        Level(0.99, 0.060, 0.175, 0.120, -0.110, 0.0, HALF),
        Level(1.17, 0.080, 0.215, 0.165, -0.140, 0.0, {"chest": 1.0}),
        Level(1.40, 0.065, 0.215, 0.085, -0.100, -0.02, {"chest": 1.0}),
    ],
    leg=[
        (0.46, 0.150, 0.01, 0.085, 0.090),
        (0.13, 0.155, -0.02, 0.066, 0.070),
        (-0.02, 0.155, -0.03, 0.095, 0.100),
    ],
    toe=(0.04, 0.270, 0.110, 0.070),
    arm=[(0.27, 0.070, 0.066), (0.50, 0.050, 0.042), (0.78, 0.145, 0.085)],
    head=[(1.45, 0.070, 0.08, 0.0), (1.52, 0.205, 0.205, 0.01), (1.875, 0.19, 0.19, 0.0)],
)

CAGE = Figure(
    levels=[
        Level(0.75, 0.020, 0.275, 0.165, -0.185, 0.03, {}),
        Level(1.115, 0.10, 0.260, 0.190, -0.175, 0.0, {}),
        Level(1.45, 0.10, 0.25, 0.125, -0.135, -0.03, {}),
    ],
    leg=[
        (0.46, 0.155, 0.01, 0.118, 0.125),
        (0.180, 0.157, -0.015, 0.108, 0.130),
        (-0.045, 0.157, -0.03, 0.122, 0.120),
    ],
    toe=(0.045, 0.285, 0.130, 0.090),
    arm=[(0.27, 0.09, 0.09), (0.795, 0.125, 0.11)],
    head=[(1.475, 0.20, 0.20, 0.01), (1.88, 0.20, 0.20, 0.01)],
)


def add_torso(blocks: Blocks, levels: list[Level]) -> list[list[list[int]]]:
    """Add the torso's cells; return vertex numbers by level, column and depth."""
    rows = []
    for level in levels:
        outer, inner = level.outer, level.inner
        columns = ((-outer, level.rise), (-inner, 0.0), (inner, 0.0), (outer, level.rise))
        depths = (level.back, level.front)
        rows.append(
            [
                [blocks.vertex((x, level.height + rise, z), level.shares) for z in depths]
                for x, rise in columns
            ]
        )
    for low, high in pairwise(rows):
        for left in range(3):
            blocks.cell(_flat(low, left), _flat(high, left))
    return rows


def _flat(row: list[list[int]], left: int) -> Corners:
    """Return the level face between two neighbouring columns."""
    return (row[left][0], row[left + 1][0], row[left + 1][1], row[left][1])


def add_leg(blocks: Blocks, figure: Figure, start: Corners, name: str) -> None:
    """Add a leg below the hips, with its foot."""
    mirror = 1.0 if name == "left" else -1.0
    thigh, shin, foot = (f"{name} {bone}" for bone in ("thigh", "shin", "foot"))
    shares: list[Shares] = [{thigh: 0.5, shin: 0.5}, {shin: 0.5, foot: 0.5}, {foot: 1.0}]
    rings = [
        Ring((x, y, z), (wide, 0, 0), (0, 0, deep), share)
        for (y, x, z, wide, deep), share in zip(figure.leg, shares, strict=True)
    ]
    corners = blocks.chain(start, rings, mirror)
    height, z, wide, high = figure.toe
    ankle, sole = corners[-2], corners[-1]
    front = (sole[3], sole[2], ankle[2], ankle[3])
    toe = Ring((figure.leg[-1][1], height, z), (wide, 0, 0), (0, high, 0), {foot: 1.0})
    blocks.chain(front, [toe], mirror)


def add_arm(blocks: Blocks, figure: Figure, start: Corners, name: str) -> None:
    """Add an arm beside the shoulder."""
    arm, forearm = f"{name} arm", f"{name} forearm"
    up = np.array([math.sin(DROP), math.cos(DROP), 0.0])
    rings = []
    for number, (distance, deep, thick) in enumerate(figure.arm):
        shares = {arm: 0.5, forearm: 0.5} if number == 0 else {forearm: 1.0}
        x, y, z = (float(value) for value in thick * up)
        rings.append(Ring(along_arm(distance), (0, 0, deep), (x, y, z), shares))
    blocks.chain(start, rings, 1.0 if name == "left" else -1.0)


def add_head(blocks: Blocks, figure: Figure, start: Corners) -> None:
    """Add neck and head above the shoulders."""
    rings = []
    for number, (height, wide, deep, z) in enumerate(figure.head):
        shares = {"chest": 0.4, "head": 0.6} if number == 0 else {"head": 1.0}
        rings.append(Ring((0.0, height, z), (wide, 0, 0), (0, 0, deep), shares))
    blocks.chain(start, rings)


def build(figure: Figure) -> Blocks:
    """Put a figure together: torso, legs, arms, head."""
    blocks = Blocks()
    rows = add_torso(blocks, figure.levels)
    low, below, top = rows[0], rows[-2], rows[-1]
    for name, outer, inner in (("left", 3, 2), ("right", 0, 1)):
        hip = (low[inner][0], low[outer][0], low[outer][1], low[inner][1])
        side = (below[outer][0], below[outer][1], top[outer][1], top[outer][0])
        for number in hip:
            blocks.shares[number] = {"pelvis": 0.6, f"{name} thigh": 0.4}
        for number in side:
            blocks.shares[number] = {"chest": 0.6, f"{name} arm": 0.4}
        add_leg(blocks, figure, hip, name)
        add_arm(blocks, figure, side, name)
    add_head(blocks, figure, _flat(top, 1))
    return blocks


def sharpened(weights: NDArray[np.float64], power: int) -> NDArray[np.float64]:
    """Make every vertex follow its strongest bone more closely; rows still sum to 1."""
    raised = weights**power
    shares: NDArray[np.float64] = raised / raised.sum(axis=1, keepdims=True)
    return shares


def walker(bones: list[str]) -> tuple[Mesh, NDArray[np.float64]]:
    """Return the walker in its rest pose and its (m, b) skinning weights."""
    blocks = build(WALKER)
    skin = blocks.skin()
    values, quads = np.concatenate([skin.verts, blocks.weights(bones)], axis=1), skin.faces
    for _ in range(2):
        values, quads = catmull_clark(values, quads)
    mesh = triangulated(Mesh(values[:, :3], quads))
    return mesh, sharpened(values[:, 3:], 3)


def convex_split(mesh: Mesh) -> Mesh:
    """Cut every quad along the diagonal that leaves more room inside."""
    a, b, c, d = mesh.verts[mesh.faces].transpose(1, 0, 2)
    inward = (np.cross(b - a, c - a) * (d - a)).sum(axis=1) > FLAT
    first = mesh.faces[:, [[0, 1, 2], [0, 2, 3]]]
    second = mesh.faces[:, [[0, 1, 3], [1, 2, 3]]]
    return mesh.with_faces(np.where(inward[:, None, None], second, first).reshape(-1, 3))


def cage() -> Mesh:
    """Return the walker's cage."""
    return convex_split(build(CAGE).skin())


def posed(mesh: Mesh, weights: NDArray[np.float64], bones: dict[str, Bone], frame: int) -> Points:
    """Return the vertices in a frame: linear blend skinning, feet on the ground.

    Parameters
    ----------
    mesh : Mesh
        The rest pose.
    weights : (m, b) float64
        Skinning weights, one column per bone.
    bones : dict of Bone
        The skeleton, parents first.
    frame : int
        The frame number, from 1.

    Returns
    -------
    (m, 3) float64
    """
    turns = pose(frame)
    spots: dict[str, tuple[Matrix, Points]] = {}
    blend = np.zeros_like(mesh.verts)
    for column, (name, bone) in enumerate(bones.items()):
        joint = np.array(bone.joint)
        rotation, shift = spots[bone.parent] if bone.parent else (np.eye(3), np.zeros(3))
        here = rotation @ turns[name]
        spots[name] = (here, shift + rotation @ joint - here @ joint)
        blend += weights[:, column, None] * (mesh.verts @ here.T + spots[name][1])
    heading, place = path(frame)
    blend[:, 1] -= blend[:, 1].min()
    return blend @ heading.T + place


def write_walker(folder: Path) -> None:
    """Write the walker's frames and its cage."""
    bones = skeleton()
    mesh, weights = walker(list(bones))
    ground = np.array([0.0, mesh.verts[:, 1].min(), 0.0])
    faces = face_lines(mesh.faces)
    for frame in range(1, FRAMES + 1):
        verts = mesh.verts - ground if frame == 1 else posed(mesh, weights, bones, frame)
        lines = [*fixed(verts, DECIMALS), *faces]
        write_lines(folder / "frames" / f"walker_{frame}.obj", lines)
    box = cage()
    lines = [*fixed(box.verts - ground, DECIMALS), *face_lines(box.faces)]
    write_lines(folder / "cage.obj", lines)
