"""The edits of a page: what it may begin with, and what is read of one that it sends."""

import json
from pathlib import Path
from typing import Any

from cageik_cli.editing.cage_edits import CageEditLayer, EditFiles, parse_cage_edits
from cageik_cli.editing.handles.model import Handle, PosedSurface
from cageik_cli.editing.handles.placement import place_handles
from cageik_cli.editing.handles.reader import parse_handles
from cageik_cli.editing.handles.schema import MAX_HANDLES_BYTES, describe_location
from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.util.errors import FormatError, HandlesError, error_context
from cageik_cli.util.json_files import JsonFormat, Steps, format_value, parse_json

MAX_SENT_BYTES = 2 * MAX_HANDLES_BYTES
"""Largest body that is read: a handles file and a cage edits file."""

SENT_FILES = {"handles": "handles", "cageEdits": "cage edits"}
"""The fields of a body, and what messages call them."""


def _describe_place(document: Any, steps: Steps) -> str:
    """Return the place of a value in words, within its file."""
    if not steps or not isinstance(document, dict) or steps[0] not in SENT_FILES:
        return describe_location(document, steps)
    name = str(steps[0])
    inner = describe_location(document[name], steps[1:])
    return f"{SENT_FILES[name]}: {inner}" if inner else SENT_FILES[name]


SENT_FORMAT = JsonFormat("handles and cage edits", MAX_SENT_BYTES, _describe_place)
"""What the JSON of a body should be."""


def read_first_edit(handles: Path | None, cage_edits: Path | None) -> EditFiles:
    """Read handles and cage edits that a page can show, if they fit its model."""
    files = EditFiles.read(handles, cage_edits)
    for handle_set in files.handles.sets if files.handles else ():
        with error_context(handles or ""):
            for handle in handle_set.handles:
                _check_shown(handle)
    return files


def check_edit_fits(files: EditFiles, clip: PlayerClip) -> None:
    """Refuse what is at no vertex or face of a model or its cage, or at no frame of its clip."""
    rest = clip.binding.rest
    surface = PosedSurface(rest, lambda _: rest.vertices, clip.timeline)
    if files.handles is not None:
        with error_context(files.handles.path):
            for handle_set in files.handles.sets:
                place_handles(handle_set, surface, allow_conflicts=True)
    if files.cage_edits is not None:
        with error_context(files.cage_edits.path):
            for edit in files.cage_edits.edits:
                CageEditLayer(edit, len(clip.binding.cage.vertices), clip.timeline)


def _check_shown(handle: Handle) -> None:
    """Refuse what the page has no means to show."""
    is_on_screen = handle.motion.camera is not None
    if is_on_screen or handle.place.kind in ("position", "screen.source"):
        raise HandlesError(
            f"handle {handle.name!r}: has a position or a screen, which the page does not show; "
            "pose it with cageik pose, or give a vertex or a face, and an offset or a target"
        )
    if handle.radius is not None:
        raise HandlesError(
            f"handle {handle.name!r}: has a radius, which the page does not show; pose it with "
            "cageik pose, or remove the radius"
        )


def parse_sent(data: bytes, handles: Path | None, cage_edits: Path | None) -> EditFiles:
    """Return the edit of a body; the paths are where its files will be saved, if anywhere.

    Raises
    ------
    FormatError, HandlesError
        When it is no JSON object of handles and cage edits; the message says where.
    """
    sent = split_sent(data)
    found_handles = found_edits = None
    if (text := sent["handles"]) is not None:
        found_handles = parse_handles(handles or Path("handles of the page"), text)
    if (text := sent["cageEdits"]) is not None:
        found_edits = parse_cage_edits(cage_edits or Path("cage edits of the page"), text)
    return EditFiles(found_handles, found_edits)


def split_sent(data: bytes) -> dict[str, bytes | None]:
    """Return the bytes of each file of a body, as a page saves it; None if there is none.

    Raises
    ------
    FormatError
        When it is not a JSON object of these fields, one of which is not null, or a file is larger
        than what is read.
    """
    document = parse_json(data, SENT_FORMAT)
    if not isinstance(document, dict) or set(document) != set(SENT_FILES):
        raise FormatError(
            f"is {format_value(document)}, expected an object of handles and cageEdits; load the "
            "page again"
        )
    if all(content is None for content in document.values()):
        raise FormatError("has neither handles nor cage edits; add some")
    files = {}
    for name, content in document.items():
        text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
        files[name] = None if content is None else text.encode(errors="surrogatepass")
        if len(files[name] or b"") > MAX_HANDLES_BYTES:
            raise FormatError(
                f"{SENT_FILES[name]}: have more than {MAX_HANDLES_BYTES} bytes; keep fewer of them"
            )
    return files
