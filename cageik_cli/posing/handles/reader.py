"""A handles file, read and checked."""

from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.geometry.camera import Camera, Stand
from cageik_cli.posing.constraints import Mirror, Ties
from cageik_cli.posing.handles.json_document import read_document
from cageik_cli.posing.handles.model import (
    Handle,
    Handles,
    HandleSet,
    InPixel,
    Motion,
    MoveBy,
    MoveTo,
    NearTo,
    OnFace,
    OnVertex,
    Pin,
    Place,
    ScreenBy,
    ScreenTo,
    Track,
)
from cageik_cli.posing.handles.schema import refuse_faults
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, located


def place_on_surface(said: dict[str, Any], camera: Camera | None) -> Place:
    """What the fields of a handle say of where on the surface it is.

    Raises
    ------
    InputError
        When it is on the screen, and there is no camera.
    """
    if "vertex" in said:
        return OnVertex(int(said["vertex"]))
    if "face" in said:
        return OnFace(int(said["face"]), np.array(said["barycentric"], np.float64))
    if "position" in said:
        return NearTo(np.array(said["position"], np.float64))
    return InPixel(np.array(said["screen"]["source"], np.float64), _needed(camera))


def motion_of(said: dict[str, Any], camera: Camera | None) -> Motion:
    """What the fields of a handle say of where it is to go.

    Raises
    ------
    InputError
        Naming the field, when it is on the screen and there is no camera, or keyframes are not.
    """
    if "pin" in said:
        return Pin()
    if "target" in said:
        return MoveTo(_track(said, "target"))
    if "offset" in said:
        return MoveBy(_track(said, "offset"))
    with located("screen"):
        screen = said["screen"]
        if "target" in screen:
            return ScreenTo(_track(screen, "target"), _needed(camera))
        return ScreenBy(_track(screen, "offset"), _needed(camera))


def _needed(camera: Camera | None) -> Camera:
    if camera is None:
        raise InputError("screen: there is no camera to see it by; add a camera to the file")
    return camera


def _track(said: dict[str, Any], field: str) -> Track:
    value = said[field]
    if isinstance(value, list):
        return Track(np.array([value], np.float64))
    frames, values = value["frames"], value["values"]
    with located(field):
        if len(frames) != len(values):
            raise InputError(
                f"has {len(frames)} frames and {len(values)} values; give each frame a value"
            )
        for before, after in pairwise(frames):
            if after <= before:
                raise InputError(f"has frame {after} after {before}, expected increasing frames")
    return Track(np.array(values, np.float64), np.array(frames, np.int64))


def read_handles(path: Path) -> Handles:
    """Read a handles file.

    Raises
    ------
    InputError
        Naming the file, the handle and the field that is not what it should be.
    """
    with located(path):
        document = read_document(path)
        refuse_faults(document)
        ties, camera = _ties(document), _camera(document, None)
        if "sets" not in document:
            return Handles((_set(document, camera),), ties)
        sets = []
        for k, said in enumerate(document["sets"]):
            with located(f"sets[{k}]"):
                sets.append(_set(said, _camera(said, camera)))
        return Handles(tuple(sets), ties)


def _set(said: dict[str, Any], camera: Camera | None) -> HandleSet:
    frames = said.get("frames")
    if frames is not None and frames[1] < frames[0]:
        raise InputError(
            f"frames: the last, {frames[1]}, is before the first, {frames[0]}; swap them"
        )
    handles = tuple(_handle(one, camera) for one in said["handles"])
    _refuse_shared_names(handle.name for handle in handles)
    pick_frame = said.get("pick_frame")
    return HandleSet(
        handles,
        camera,
        None if frames is None else (int(frames[0]), int(frames[1])),
        int(said.get("falloff", 0)),
        None if pick_frame is None else int(pick_frame),
    )


def _refuse_shared_names(names: Iterable[str]) -> None:
    known: set[str] = set()
    for name in names:
        if name in known:
            raise InputError(f"two handles are called {name!r}; give each a name of its own")
        known.add(name)


def _handle(said: dict[str, Any], camera: Camera | None) -> Handle:
    name = said["name"]
    with located(f"handle {name!r}"):
        if not name.isprintable():
            raise InputError("name holds characters that cannot be shown; leave them out")
        place, motion = place_on_surface(said, camera), motion_of(said, camera)
    return Handle(name, place, motion, float(said.get("weight", 1)), said.get("hard", False))


def _camera(said: dict[str, Any], default: Camera | None) -> Camera | None:
    if "camera" not in said:
        return default
    values = said["camera"]
    width, height = float(values["width"]), float(values["height"])
    with located("camera"), np.errstate(over="ignore", invalid="ignore"):
        if "view" in values:
            view, projection = _array(values["view"]), _array(values["projection"])
            camera = Camera(view, projection, width, height)
        else:
            stand = Stand(*(_array(values[name]) for name in ("position", "look_at", "up")))
            camera = Camera.looking_at(stand, float(values["fov_degrees"]), width, height)
        if not np.isfinite(np.linalg.cond(camera.projection @ camera.view)):
            raise InputError("its numbers are too large or too small together; choose other units")
    return camera


def _ties(said: dict[str, Any]) -> Ties:
    locked = tuple(int(vertex) for vertex in said.get("locked", ()))
    if "mirror" not in said:
        return Ties(locked)
    values = said["mirror"]
    with located("mirror"):
        return Ties(locked, Mirror(_array(values["normal"]), _array(values["point"])))


def _array(values: list[Any]) -> Floats:
    return np.array(values, np.float64)
