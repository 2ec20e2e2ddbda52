"""Handles put on a surface, in frames of a clip."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.posing.anchors import SurfacePoint, at_vertex, nearest_to, on_face, picked
from cageik_cli.posing.handles.conflicts import Held, merged
from cageik_cli.posing.handles.model import (
    Handle,
    HandleSet,
    InPixel,
    NearTo,
    OnFace,
    OnVertex,
    PlaceSettings,
    Surface,
)
from cageik_cli.posing.handles.schedule import Drag
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, located


def placed(handle_set: HandleSet, surface: Surface, settings: PlaceSettings) -> Drag:
    """Put the handles on a surface.

    Parameters
    ----------
    handle_set : HandleSet
    surface : Surface
        Its poses are asked for where pixels and positions are looked for; and where handles share
        a point, one after another in all frames that the edit may change.
    settings : PlaceSettings

    Raises
    ------
    InputError
        Naming the handle that has no place on it, or two that pull one point apart, or the frame
        that the clip does not have.
    """
    hold = _hold(handle_set, surface.count)
    span = _span(hold, handle_set.falloff, surface.count)
    search = _Search(surface, _pick_frame(handle_set, hold, surface.count), settings.snap)
    held, notes = [], []
    for handle in handle_set.handles:
        with located(f"handle {handle.name!r}"):
            _refuse_keys(handle, surface.count)
            point = search.point_of(handle)
        if isinstance(handle.place, NearTo):
            notes.append(search.snap_note(handle, handle.place.position, point))
        held.append(Held(replace(handle, hard=handle.hard or settings.hard), point))
    pulls = merged(held, surface, span, settings.allow_conflicts)
    notes += [pull.note for pull in pulls if pull.note]
    anchors, movers = tuple(p.anchor for p in pulls), tuple(p.mover for p in pulls)
    return Drag(anchors, movers, hold, span, handle_set.falloff, tuple(notes))


class _Search:
    """Points of a surface; those in space and on a screen, in the pose of one frame."""

    def __init__(self, surface: Surface, frame: int, may_snap: bool) -> None:
        self._surface, self._frame, self._may_snap = surface, frame, may_snap

    def point_of(self, handle: Handle) -> SurfacePoint:
        match handle.place:
            case OnVertex(vertex):
                with located("vertex"):
                    return at_vertex(self._surface.mesh, vertex)
            case OnFace(face, barycentric):
                with located("face"):
                    return on_face(self._surface.mesh, face, barycentric)
            case NearTo(position):
                with located("position"):
                    return self._nearest(position)
            case InPixel(pixel, camera):
                with located("screen.source"), np.errstate(all="ignore"):
                    return picked(self._posed, camera, pixel)

    def snap_note(self, handle: Handle, position: Floats, point: SurfacePoint) -> str:
        """How far the point is from the position that was asked for."""
        away = float(np.linalg.norm(point.position(self._posed.vertices) - position))
        return (
            f"handle {handle.name!r}: its position is {away:.3g} off the surface "
            f"({away / self._posed.diagonal:.2%} of the diagonal), the nearest point is taken"
        )

    @cached_property
    def _posed(self) -> TriMesh:
        return TriMesh(self._surface.pose(self._frame), self._surface.mesh.faces)

    def _nearest(self, position: Floats) -> SurfacePoint:
        if not self._may_snap:
            raise InputError(
                "a position is on no point of the surface by itself; take the nearest with "
                "--snap, or name a vertex or a face"
            )
        return nearest_to(self._posed, position)


def _hold(handle_set: HandleSet, count: int | None) -> range:
    """The frames of full strength."""
    if count is None:
        for field in ("frames", "pick_frame"):
            if getattr(handle_set, field) is not None:
                raise InputError(f"{field}: {_ONE_POSE}")
        return range(1)
    first, last = handle_set.frames or (0, count - 1)
    for frame in (first, last):
        with located("frames"):
            _refuse_outside(frame, count)
    if last < first:
        raise InputError(f"frames: the last, {last}, is before the first, {first}; swap them")
    return range(first, last + 1)


def _span(hold: range, falloff: int, count: int | None) -> range:
    """The frames of a strength above zero."""
    beyond = max(falloff - 1, 0)
    return range(max(hold.start - beyond, 0), min(hold.stop + beyond, count or 1))


def _pick_frame(handle_set: HandleSet, hold: range, count: int | None) -> int:
    if handle_set.pick_frame is None or count is None:
        return hold.start
    with located("pick_frame"):
        _refuse_outside(handle_set.pick_frame, count)
    return handle_set.pick_frame


def _refuse_keys(handle: Handle, count: int | None) -> None:
    """Refuse keyframes that the clip does not have."""
    track = handle.motion.track
    if track is None or track.frames is None:
        return
    with located(handle.motion.field):
        if count is None:
            raise InputError(f"keyframes: {_ONE_POSE}")
        for frame in track.frames.tolist():
            _refuse_outside(frame, count)


def _refuse_outside(frame: int, count: int) -> None:
    if not 0 <= frame < count:
        raise InputError(
            f"there is no frame {frame}; the clip has {count}, numbered from 0 to {count - 1}"
        )


_ONE_POSE = "there is one pose to edit, and no clip; leave it out, or edit an animation's result"
