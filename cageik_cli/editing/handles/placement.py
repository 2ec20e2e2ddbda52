"""Placement of handles on a surface, in the frames of a clip."""

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from cageik_cli.editing.handles.model import Handle, HandleSet, Motion, Place, PosedSurface
from cageik_cli.editing.handles.schedule import HandleSchedule, merge_coincident
from cageik_cli.formats.timeline import Timeline
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.pose.anchors import (
    COINCIDENT_TOL,
    SurfacePoint,
    closest_point,
    pick,
    point_at_vertex,
    point_on_face,
)
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import HandlesError, SettingError, error_context
from cageik_cli.util.messages import Hint, say


def place_handles(
    handle_set: HandleSet,
    surface: PosedSurface,
    *,
    snap: float | None = None,
    allow_conflicts: bool = False,
    hard: bool = False,
) -> HandleSchedule:
    """Place handles on a surface; with `hard`, as hard anchors.

    Parameters
    ----------
    surface : PosedSurface
        The pose of the pick frame is used for pixels and positions; where handles share a point,
        the poses of all frames that the edit may change are compared.
    snap : float, optional
        Use the closest point of the surface for a position in space that is at most this far from
        it, percent of the diagonal; None refuses all positions.
    allow_conflicts : bool
        Use the mean of different targets of one point, instead of refusing them.

    Raises
    ------
    HandlesError
        When a handle cannot be placed, two handles conflict, or the clip has no such frame; the
        message names them.
    """
    timeline = surface.timeline
    full_strength = find_full_strength(handle_set.frames, timeline)
    falloff = handle_set.falloff / (timeline.step if timeline else 1)
    beyond = max(math.ceil(falloff) - 1, 0)  # frames on each side with a strength above zero
    affected_frames = range(
        max(full_strength.start - beyond, 0),
        min(full_strength.stop + beyond, timeline.count if timeline else 1),
    )
    pick_frame = _choose_pick_frame(handle_set, full_strength, timeline)
    finder = _PointFinder(surface, pick_frame, snap)
    placed, notes = [], []
    for handle in handle_set.handles:
        with error_context(f"handle {handle.name!r}"):
            check_keyframes(handle.motion, timeline)
            point = finder.find_point(handle.place)
        if handle.place.kind == "position":
            notes.append(finder.describe_snap(handle, point))
        motion = handle.motion
        if motion.kind == "stay":
            place = point.position(surface.pose_at(full_strength.start))
            motion = replace(motion, values=place[None])
        placed.append((replace(handle, hard=handle.hard or hard, motion=motion), point))
    scheduled = merge_coincident(placed, surface, affected_frames, allow_conflicts)
    return HandleSchedule(
        scheduled=tuple(scheduled),
        full_strength=full_strength,
        affected_frames=affected_frames,
        falloff=falloff,
        timeline=timeline or Timeline(1, 0),
        notes=(*notes, *(one.note for one in scheduled if one.note)),
    )


class _PointFinder:
    """Finds the points of handles; positions and pixels are searched in the pose of one frame."""

    def __init__(self, surface: PosedSurface, frame: int, snap: float | None) -> None:
        self._surface, self._frame, self._max_snap_percent = surface, frame, snap

    def find_point(self, place: Place) -> SurfacePoint:
        """Return the point of a place."""
        mesh = self._surface.mesh
        if not len(mesh.faces) and place.kind != "vertex":
            raise HandlesError(
                "the model is a cloud of points and has no surface; name one of its points by "
                "`vertex`"
            )
        with error_context(place.kind):
            if place.kind == "vertex":
                return point_at_vertex(mesh, place.number)
            assert place.values is not None
            if place.kind == "face":
                return point_on_face(mesh, place.number, place.values)
            if place.camera is None:
                return self._snap_to_surface(place.values)
            with np.errstate(all="ignore"):
                return pick(self._posed_mesh, place.camera, place.values)

    def describe_snap(self, handle: Handle, point: SurfacePoint) -> str:
        """Return a note on the point that is taken for the position of a handle."""
        assert handle.place.values is not None
        away, percent = self._measure_snap(handle.place.values, point)
        return (
            f"handle {handle.name!r}: position snapped to {self._format_place(point)}, "
            f"{away:.3g} away ({percent:.3g} % of the diagonal)"
        )

    @cached_property
    def _posed_mesh(self) -> TriMesh:
        return TriMesh(self._surface.pose_at(self._frame), self._surface.mesh.faces)

    def _snap_to_surface(self, position: Floats) -> SurfacePoint:
        if self._max_snap_percent is None:
            raise HandlesError(
                say(
                    "a position needs `snap=`, which takes the closest point of the "
                    "surface; or give a vertex or a face"
                )
            )
        point = closest_point(self._posed_mesh, position)
        away, percent = self._measure_snap(position, point)
        if percent > self._max_snap_percent:
            step = 10.0 ** (math.floor(math.log10(percent)) - 1)
            enough = math.ceil(percent / step) * step  # the next larger one of two digits
            raise HandlesError(
                f"is {away:.3g} away from the surface ({percent:.3g} % of the diagonal, at "
                f"most {self._max_snap_percent:g} %); the closest point is at "
                f"{self._format_place(point)}; correct the position, or allow it with "
                + Hint("snap", f"{enough:g}%")
            )
        return point

    def _measure_snap(self, position: Floats, point: SurfacePoint) -> tuple[float, float]:
        """Return how far a point is from a position: in file units, and percent of the diagonal."""
        away = float(np.linalg.norm(point.position(self._posed_mesh.vertices) - position))
        return away, 100 * away / (self._surface.mesh.diagonal or 1.0)

    def _format_place(self, point: SurfacePoint) -> str:
        """Return where a point is, in the words and numbers of a handles file."""
        place = describe_place(self._surface.mesh, point)
        if place.values is None:
            return f"vertex {place.number}"
        shares = ", ".join(f"{share:.4g}" for share in place.values)
        return f"face {place.number} (barycentric {shares})"


def describe_place(mesh: TriMesh, point: SurfacePoint) -> Place:
    """Return the place on a mesh that gives a point: a vertex if it is at one, else a face.

    Of a vertex the point may be as far away as coincident points are from each other.
    """
    largest = int(point.barycentric.argmax())
    if 1 - point.barycentric[largest] <= COINCIDENT_TOL:
        return Place("vertex", int(point.corners[largest]))
    face = int((mesh.faces == point.corners).all(axis=1).argmax())
    return Place("face", face, point.barycentric)


def find_full_strength(frames: tuple[float, float] | None, timeline: Timeline | None) -> range:
    """Return the indices of the frames of full strength, of the first and last of these numbers."""
    if timeline is None:
        if frames is not None:
            raise HandlesError(f"frames: {_explain_one_pose()}")
        return range(1)
    if frames is None:
        return range(timeline.count)
    first, last = (_find_frame(number, timeline, "frames") for number in frames)
    if last < first:
        numbers = timeline.number_frame(last), timeline.number_frame(first)
        raise HandlesError(
            "frames: the last, {}, is before the first, {}; exchange them".format(*numbers)
        )
    return range(first, last + 1)


def _choose_pick_frame(
    handle_set: HandleSet, full_strength: range, timeline: Timeline | None
) -> int:
    if handle_set.pick_frame is None:
        return full_strength.start
    if timeline is None:
        raise HandlesError(f"pick_frame: {_explain_one_pose()}")
    return _find_frame(handle_set.pick_frame, timeline, "pick_frame")


def check_keyframes(motion: Motion, timeline: Timeline | None) -> None:
    """Check that the clip has the frames of all keyframes."""
    if motion.frames is None:
        return
    if timeline is None:
        raise HandlesError(f"{motion.kind}: keyframes: {_explain_one_pose()}")
    for number in motion.frames.tolist():
        _find_frame(number, timeline, motion.kind)


def _find_frame(number: float, timeline: Timeline, field: str) -> int:
    """Return the index of the frame that a field names by its number."""
    try:
        return timeline.find_index(number)
    except SettingError as error:
        raise HandlesError(f"{field}: {error}") from error


def _explain_one_pose() -> str:
    return (
        "not possible for a single pose, which has no frames; remove it, or edit the result of an "
        "animation"
    )
