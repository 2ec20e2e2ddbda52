"""Handles files for tests, and a surface that they are put on."""

import json
from pathlib import Path

import numpy as np

from cageik_cli.editing.handles.model import Handles, HandleSet, PosedSurface
from cageik_cli.editing.handles.placement import place_handles
from cageik_cli.editing.handles.reader import read_handles
from cageik_cli.editing.handles.schedule import HandleSchedule
from cageik_cli.formats.timeline import Timeline
from tests.shapes import box

FRAMES = 12
CAMERA = {
    "position": [1, 2, 9],
    "look_at": [0, 0, 0],
    "up": [0, 1, 0],
    "fov_degrees": 40,
    "width": 640,
    "height": 480,
}
HAND = {"name": "hand", "vertex": 7, "target": [1, 2, 3]}
KEYS = {"frames": [2, 5, 9], "values": [[1, 2, 3], [2, 0, 3], [2.5, 1, 3]]}


def step(k: int) -> np.ndarray:
    """Where the box is moved in frame k."""
    return np.array([0.1 * k, -0.05 * k, 0.02 * k * k])


MESH = box()
CLIP = PosedSurface(MESH, lambda k: MESH.vertices + step(k), Timeline(FRAMES, 0))
STILL = PosedSurface(MESH, lambda k: MESH.vertices)


def read(folder: Path, document: object) -> Handles:
    """What a file of this document says."""
    path = folder / "drag.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return read_handles(path)


def read_set(folder: Path, *handles: dict, **fields: object) -> HandleSet:
    """The one set of a file of these handles, with a camera."""
    (found,) = read(folder, {"handles": handles, "camera": CAMERA} | fields).sets
    return found


def drag(handle_set: HandleSet, surface: PosedSurface = CLIP, **settings: object) -> HandleSchedule:
    """The handles put on a surface."""
    return place_handles(handle_set, surface, **settings)
