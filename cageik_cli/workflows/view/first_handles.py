"""The handles that a page begins with: a file is refused if the page cannot show it."""

import json
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.posing.handles.json_document import HANDLES_FORMAT
from cageik_cli.posing.handles.model import (
    AtPixel,
    Handle,
    Handles,
    NearPosition,
    PlacementSettings,
    PosedSurface,
    ScreenBy,
    ScreenTo,
)
from cageik_cli.posing.handles.placement import place_handles
from cageik_cli.posing.handles.reader import parse_handles
from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.util.errors import HandlesError, error_context
from cageik_cli.util.json_files import read_json


@dataclass(frozen=True, slots=True, eq=False)
class FirstHandles:
    """The handles that a page begins with.

    Attributes
    ----------
    text : str
        JSON in ASCII.
    """

    path: Path
    text: str
    handles: Handles

    def check_places(self, clip: PlayerClip) -> None:
        """Refuse handles that are at no vertex or face of a model, or at no frame of its clip.

        Raises
        ------
        HandlesError
            Naming the file and the handle.
        """
        rest = clip.binding.rest
        surface = PosedSurface(rest, lambda _: rest.vertices, len(clip.frames) or None)
        for handle_set in self.handles.sets:
            with error_context(self.path):
                place_handles(handle_set, surface, PlacementSettings(allow_conflicts=True))


def read_first_handles(path: Path) -> FirstHandles:
    """Read handles that a page can show, if they fit its model.

    Raises
    ------
    InputError
        Naming the file, and the handle that the page cannot show.
    """
    with error_context(path):
        text = json.dumps(read_json(path, HANDLES_FORMAT))
        handles = parse_handles(text.encode())
        for handle_set in handles.sets:
            for handle in handle_set.handles:
                _check_shown(handle)
    return FirstHandles(path, text, handles)


def _check_shown(handle: Handle) -> None:
    """Refuse what the page has no means to show."""
    is_on_screen = isinstance(handle.motion, ScreenTo | ScreenBy)
    if is_on_screen or isinstance(handle.place, NearPosition | AtPixel):
        raise HandlesError(
            f"handle {handle.name!r}: has a position or a screen, which the page does not show; "
            "pose it with cageik pose, or give a vertex or a face, and an offset or a target"
        )
    if handle.radius is not None:
        raise HandlesError(
            f"handle {handle.name!r}: has a radius, which the page does not show; pose it with "
            "cageik pose, or remove the radius"
        )
