"""The walker's skeleton and its walk: how every bone is turned in every frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from meshes import Points
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
CYCLE = 20
"""Frames in one cycle of two steps."""
STRIDE = 0.115
"""How far one frame of the full walk goes."""
DROP = math.radians(38)
"""How far below the horizontal the arms point in the rest pose."""


@dataclass(frozen=True)
class Bone:
    """A bone: the bone it hangs on (None for the first) and the joint it turns about."""

    parent: str | None
    joint: tuple[float, float, float]


def along_arm(distance: float, side: float = 1.0) -> tuple[float, float, float]:
    """Return the point at a distance from the shoulder down the (left) arm's axis."""
    x, y = 0.2 + distance * math.cos(DROP), 1.315 - distance * math.sin(DROP)
    return (side * x, y, 0.0)


def skeleton() -> dict[str, Bone]:
    """Return the bones by name, parents first."""
    bones = {
        "pelvis": Bone(None, (0.0, 0.9, 0.0)),
        "chest": Bone("pelvis", (0.0, 1.02, 0.0)),
        "head": Bone("chest", (0.0, 1.43, 0.0)),
    }
    for name, side in (("left", 1.0), ("right", -1.0)):
        bones[f"{name} arm"] = Bone("chest", along_arm(0.0, side))
        bones[f"{name} forearm"] = Bone(f"{name} arm", along_arm(0.27, side))
        bones[f"{name} thigh"] = Bone("pelvis", (side * 0.135, 0.84, 0.0))
        bones[f"{name} shin"] = Bone(f"{name} thigh", (side * 0.15, 0.46, 0.0))
        bones[f"{name} foot"] = Bone(f"{name} shin", (side * 0.155, 0.1, -0.01))
    return bones


def turn(axis: tuple[float, float, float], degrees: float) -> Matrix:
    """Return the (3, 3) rotation about a unit axis."""
    angle = math.radians(degrees)
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return cosine * np.eye(3) + sine * cross + (1 - cosine) * np.outer(axis, axis)


def ramp(frame: int, first: int, last: int) -> float:
    """Return 0 before `first`, 1 after `last`, and a smooth step between them."""
    t = min(max((frame - first) / (last - first), 0.0), 1.0)
    return t * t * (3 - 2 * t)


def leg_pose(side: str, phase: float, amount: float) -> dict[str, Matrix]:
    """Return the turns of thigh, shin and foot; the leg comes forward while phase is near 0."""
    lift = ((1 + math.cos(phase + 0.55)) / 2) ** 2
    thigh = -4 - 31 * math.sin(phase) - 9 * lift
    shin = 9 + 62 * lift
    foot = -0.55 * (thigh + shin) + 10 * lift
    parts = {"thigh": thigh, "shin": shin, "foot": foot}
    return {f"{side} {part}": turn(X_AXIS, amount * angle) for part, angle in parts.items()}


def arm_pose(side: str, phase: float, amount: float) -> dict[str, Matrix]:
    """Return the turns of arm and forearm; the arm comes forward while phase is near 0."""
    mirror = 1.0 if side == "left" else -1.0
    hang = turn(Z_AXIS, -30 * mirror * amount)
    swing = turn(X_AXIS, amount * (4 - 34 * math.sin(phase)))
    hinge = (-math.sin(DROP), -mirror * math.cos(DROP), 0.0)
    bend = amount * (36 + 24 * math.sin(phase))
    return {f"{side} arm": swing @ hang, f"{side} forearm": turn(hinge, bend)}


def body_pose(frame: int, phase: float, amount: float) -> dict[str, Matrix]:
    """Return the turns of pelvis, chest and head, with one slow bend and one nod."""
    bend = 16 * ramp(frame, 14, 24) - 30 * ramp(frame, 28, 40)
    nod = 30 * ramp(frame, 24, 30) * (1 - ramp(frame, 32, 39))
    sway = math.sin(phase)
    chest = turn(Y_AXIS, -22 * amount * sway) @ turn(Z_AXIS, amount * bend)
    return {
        "pelvis": turn(Y_AXIS, 9 * amount * sway) @ turn(X_AXIS, 3 * amount),
        "chest": chest @ turn(X_AXIS, amount * 5),
        "head": turn(X_AXIS, nod - 6 * amount) @ turn(Y_AXIS, 12 * amount * sway),
    }


def pose(frame: int) -> dict[str, Matrix]:
    """Return the turn of every bone in a frame; frame 1 turns nothing."""
    phase = 2 * math.pi * (frame - 1) / CYCLE
    amount = ramp(frame, 1, 11)
    turns = body_pose(frame, phase, amount)
    for side, shift in (("left", 0.0), ("right", math.pi)):
        turns |= leg_pose(side, phase + shift, amount)
        turns |= arm_pose(side, phase + shift + math.pi, amount)
    return turns


def path(frame: int) -> tuple[Matrix, Points]:
    """Return where the walk has got to: the heading's (3, 3) rotation and the (3,) place."""
    place, heading = np.zeros(3), 0.0
    for step in range(2, frame + 1):
        heading = 28 * ramp(step, 8, 40)
        place = place + STRIDE * ramp(step, 1, 11) * turn(Y_AXIS, heading)[:, 2]
    return turn(Y_AXIS, heading), place
