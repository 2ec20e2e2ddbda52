"""Reading of a handles file: its JSON is checked against the schema, and becomes records.

Messages for violations, also of files of cage edits, name the place. The titles of the schema are
the words for what is expected.
"""

import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import files
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cageik_cli.editing.handles.model import Handle, Handles, HandleSet, Motion, Place
from cageik_cli.geometry.mirror import Mirror
from cageik_cli.method.pose.camera import Camera
from cageik_cli.method.pose.constraints import CageConstraints
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import HandlesError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.json_files import (
    MAX_VALUE_LENGTH,
    JsonFormat,
    Steps,
    format_step,
    format_value,
    parse_json,
)

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError

MAX_HANDLES_BYTES = 2_000_000
"""Largest file that is read: many thousands of handles."""


def describe_location(document: Any, steps: Steps) -> str:
    """Return the place of a value in words: its set, its handle by name, the field within it.

    In a file of cage edits: its edit by name, its move, the field within it.
    """
    words: list[str] = []
    field, value = "", document
    before: str | int = ""
    for step in steps:
        value = value[step]
        if before in ("sets", "handles", "edits", "moves") and isinstance(step, int):
            kind = {"handles": "handle", "edits": "edit"}.get(str(before))
            name = value.get("name") if isinstance(value, dict) and kind else None
            word = f"{field}[{step}]"
            if isinstance(name, str) and name:
                word = f"{kind} {name[:MAX_VALUE_LENGTH]!r}"
            words.append(word)
            field = ""
        else:
            field = (field + format_step(step)).removeprefix(".")
        before = step
    return ": ".join([*words, field] if field else words)


HANDLES_FORMAT = JsonFormat("a handles file", MAX_HANDLES_BYTES, describe_location)
"""What the JSON of a handles file should be."""


def read_schema(name: str = "handles") -> str:
    """Return the JSON schema, draft 2020-12, of "handles" or "cage_edits" as text.

    That of cage edits refers to definitions of that of handles, and is returned with them.
    """
    folder = files("cageik_cli.editing.handles")
    text = folder.joinpath("schema.json").read_text(encoding="utf-8")
    if name == "handles":
        return text
    schema = json.loads(folder.joinpath(f"{name}.json").read_text(encoding="utf-8"))
    shared, waiting = json.loads(text)["$defs"], [schema]
    while waiting:
        for named in re.findall(r'"#/\$defs/(\w+)"', json.dumps(waiting.pop())):
            if named not in schema["$defs"]:
                schema["$defs"][named] = shared[named]
                waiting.append(shared[named])
    return json.dumps(schema, indent=2) + "\n"


def check_schema(document: Any, name: str = "handles") -> None:
    """Check a document against the schema of "handles" or "cage_edits".

    Raises
    ------
    HandlesError
        For the first fault in the file, among the first 1000 found: handle, field, what was found
        and what is expected.
    """
    from jsonschema import Draft202012Validator

    validator = Draft202012Validator(json.loads(read_schema(name)))
    faults = islice(validator.iter_errors(document), 1000)
    first = min(faults, key=lambda fault: _file_order(document, fault), default=None)
    if first is not None:
        place = describe_location(document, list(first.absolute_path))
        fault = f"is {format_value(first.instance)}, expected {first.schema['title']}"
        if first.validator in _OBJECT_FAULTS:
            fault = _OBJECT_FAULTS[first.validator](first)
        raise HandlesError(f"{place}: {fault}" if place else fault)


def _file_order(document: Any, fault: "ValidationError") -> tuple[int, ...]:
    """Return a key that sorts faults by place in the file; missing fields are at the end."""
    numbers, value = [], document
    for step in fault.absolute_path:
        numbers.append(step if isinstance(step, int) else list(value).index(step))
        value = value[step]
    if fault.validator == "additionalProperties":
        numbers.append(list(value).index(next(_unknown_fields(fault))))
    elif fault.validator in _OBJECT_FAULTS:
        numbers.append(len(value) if isinstance(value, dict) else 0)
    return tuple(numbers)


def _describe_unknown_field(fault: "ValidationError") -> str:
    known, unknown = list(fault.schema["properties"]), next(_unknown_fields(fault))
    near = get_close_matches(unknown, known, n=1, cutoff=0.7)  # `name` and `frames` have 0.6
    near = near or [name for name in known if unknown and name.startswith(unknown)]
    hint = f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}"
    return f"{format_value(unknown)} is not a field of {fault.schema['title']}; {hint}"


def _describe_missing_field(fault: "ValidationError") -> str:
    missing = next(name for name in fault.validator_value if name not in fault.instance)
    return f"has no {missing}, which {fault.schema['title']} needs; add it"


def _describe_lone_field(fault: "ValidationError") -> str:
    """Describe a field that needs another one."""
    alone, missing = next(
        (name, other)
        for name, others in fault.validator_value.items()
        for other in others
        if name in fault.instance and other not in fault.instance
    )
    return f"has {alone} without {missing}; add it, or remove {alone}"


def _describe_choice(fault: "ValidationError") -> str:
    """Describe an object that should have exactly one of several fields."""
    title, names = fault.schema["title"], [one["required"][0] for one in fault.validator_value]
    found = [name for name in names if name in fault.instance]
    if not found:
        return f"has no {title}; expected exactly one of {', '.join(names)}"
    return f"has {len(found)} {title}s, {' and '.join(found)}; keep one of them"


def _unknown_fields(fault: "ValidationError") -> Iterator[str]:
    return (name for name in fault.instance if name not in fault.schema["properties"])


_OBJECT_FAULTS = {
    "additionalProperties": _describe_unknown_field,
    "required": _describe_missing_field,
    "dependentRequired": _describe_lone_field,
    "oneOf": _describe_choice,
}
"""Messages on the fields of objects, by the keyword of the schema."""


def read_handles(path: Path) -> Handles:
    """Read a handles file.

    Raises
    ------
    FileAccessError, FormatError
        When the file cannot be read as JSON.
    HandlesError
        When its content is wrong; the message names the file, the handle and the field.
    """
    with error_context(path):
        data = read_input(path, HANDLES_FORMAT.max_bytes, HANDLES_FORMAT.name, is_json=True)
        return parse_handles(path, data)


def parse_handles(path: Path, data: bytes) -> Handles:
    """Return the handles of a file that was read; messages do not name the file."""
    document = parse_json(data, HANDLES_FORMAT)
    check_schema(document)
    mirror = None
    if "mirror" in document:
        with error_context("mirror"):
            plane = document["mirror"]
            mirror = Mirror(_to_array(plane["normal"]), _to_array(plane["point"]))
    constraints = CageConstraints(tuple(map(int, document.get("locked", ()))), mirror)
    camera = _parse_camera(document, None)
    if "sets" not in document:
        return Handles(path, data, (_parse_set(document, camera),), constraints)
    sets = []
    for k, raw in enumerate(document["sets"]):
        with error_context(f"sets[{k}]"):
            sets.append(_parse_set(raw, _parse_camera(raw, camera)))
    return Handles(path, data, tuple(sets), constraints)


def _parse_set(raw: dict[str, Any], camera: Camera | None) -> HandleSet:
    frames = parse_frames(raw)
    handles = tuple(_parse_handle(one, camera) for one in raw["handles"])
    check_unique_names("handles", (handle.name for handle in handles))
    hold = raw.get("hold", True)
    _check_radii(handles, hold)
    pick_frame = raw.get("pick_frame")
    return HandleSet(
        handles,
        frames,
        int(raw.get("falloff", 0)),
        None if pick_frame is None else float(pick_frame),
        hold,
    )


def parse_frames(raw: dict[str, Any]) -> tuple[float, float] | None:
    """Return the numbers of the first and the last frame of full strength, if they are given."""
    if "frames" not in raw:
        return None
    first, last = raw["frames"]
    if last < first:
        raise HandlesError(f"frames: the last, {last}, is before the first, {first}; exchange them")
    return float(first), float(last)


def check_unique_names(things: str, names: Iterable[str]) -> None:
    """Refuse a name that two handles, or two other `things`, have."""
    known: set[str] = set()
    for name in names:
        if name in known:
            raise HandlesError(f"two {things} are named {name!r}; give them different names")
        known.add(name)


def _check_radii(handles: Iterable[Handle], hold: bool) -> None:
    """Refuse a radius where the rest is not held, which would do nothing."""
    for handle in handles:
        if handle.radius is not None and not hold:
            raise HandlesError(
                f"handle {handle.name!r}: radius: needs `hold`, which is false; remove one of them"
            )


def check_printable(name: str) -> None:
    """Refuse a name that messages cannot show."""
    if not name.isprintable():
        raise HandlesError("name has characters that cannot be displayed; remove them")


def _parse_handle(raw: dict[str, Any], camera: Camera | None) -> Handle:
    name = raw["name"]
    with error_context(f"handle {name!r}"):
        check_printable(name)
        place, motion = _parse_place(raw, camera), _parse_motion(raw, camera)
    radius = float(raw["radius"]) if "radius" in raw else None
    return Handle(name, place, motion, float(raw.get("weight", 1)), raw.get("hard", False), radius)


def _parse_place(raw: dict[str, Any], camera: Camera | None) -> Place:
    """Return the place on the surface that the fields of a handle give."""
    if "vertex" in raw:
        return Place("vertex", int(raw["vertex"]))
    if "face" in raw:
        return Place("face", int(raw["face"]), _to_array(raw["barycentric"]))
    if "position" in raw:
        return Place("position", values=_to_array(raw["position"]))
    pixel = _to_array(raw["screen"]["source"])
    return Place("screen.source", values=pixel, camera=_require_camera(camera))


def _parse_motion(raw: dict[str, Any], camera: Camera | None) -> Motion:
    """Return the motion that the fields of a handle give."""
    for kind in ("pin", "stay"):
        if kind in raw:
            return Motion(kind)
    if "screen" not in raw:
        kind = "target" if "target" in raw else "offset"
        return replace(parse_motion(kind, raw[kind]), turns=raw.get("axes") == "surface")
    with error_context("screen"):
        kind = "target" if "target" in raw["screen"] else "offset"
        moving = parse_motion(kind, raw["screen"][kind])
        return replace(moving, kind=f"screen.{kind}", camera=_require_camera(camera))


def _require_camera(camera: Camera | None) -> Camera:
    if camera is None:
        raise HandlesError("screen: there is no camera; add one to the file")
    return camera


def parse_motion(kind: str, value: Any) -> Motion:
    """Return the motion of a target or an offset, which is a value or has keyframes."""
    if isinstance(value, list):
        return Motion(kind, _to_array([value]))
    frames, values = value["frames"], value["values"]
    with error_context(kind):
        if len(frames) != len(values):
            raise HandlesError(
                f"has {len(frames)} frames and {len(values)} values; give one value per frame"
            )
        for before, after in pairwise(frames):
            if after <= before:
                raise HandlesError(
                    f"has frame {after} after frame {before}, expected increasing frames"
                )
    ease = value.get("ease", "smooth")
    return Motion(kind, _to_array(values), _to_array(frames), ease=ease)


def _parse_camera(raw: dict[str, Any], default: Camera | None) -> Camera | None:
    if "camera" not in raw:
        return default
    values = raw["camera"]
    width, height = float(values["width"]), float(values["height"])
    with error_context("camera"), np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        if "view" in values:
            view, projection = _to_array(values["view"]), _to_array(values["projection"])
            camera = Camera(view, projection, width, height)
        else:
            camera = Camera.from_look_at(
                _to_array(values["position"]),
                _to_array(values["look_at"]),
                up=_to_array(values["up"]),
                fov_degrees=float(values["fov_degrees"]),
                width=width,
                height=height,
            )
        if not np.isfinite(np.linalg.cond(camera.projection @ camera.view)):
            raise HandlesError(
                "view times projection is singular or not finite; check the numbers or the units"
            )
    return camera


def _to_array(values: list[Any]) -> Floats:
    return np.array(values, np.float64)
