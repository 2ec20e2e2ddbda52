"""A handles file, read and checked."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.geometry.camera import Camera, Stand
from cageik_cli.handles.document import read_document
from cageik_cli.handles.fields import motion_of, place_on_surface
from cageik_cli.handles.records import Handle, Handles, HandleSet
from cageik_cli.handles.schema import refuse_faults
from cageik_cli.ties import Mirror, Ties
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, located


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
