"""A handle's place and motion out of the fields that say them; the schema has checked these."""

from itertools import pairwise
from typing import Any

import numpy as np

from cageik_cli.geometry.camera import Camera
from cageik_cli.handles.motions import Motion, MoveBy, MoveTo, Pin, ScreenBy, ScreenTo, Track
from cageik_cli.handles.records import InPixel, NearTo, OnFace, OnVertex, Place
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
