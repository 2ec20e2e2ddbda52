"""Handles put on a surface."""

from cageik_cli.handles.drag import Drag
from cageik_cli.handles.records import HandleSet, PlaceSettings, Surface


def placed(handle_set: HandleSet, surface: Surface, settings: PlaceSettings) -> Drag:
    """Put the handles on a surface.

    Raises
    ------
    InputError
        Naming the handle that has no place on it, or the frame that the clip does not have.
    """
    raise NotImplementedError
