"""The handles file: which points of a surface go where, in which frames of a clip."""

from cageik_cli.handles.drag import Drag
from cageik_cli.handles.placing import placed
from cageik_cli.handles.reading import read_handles
from cageik_cli.handles.records import Handle, Handles, HandleSet, PlaceSettings, Surface
from cageik_cli.handles.schema import schema_text

__all__ = [
    "Drag",
    "Handle",
    "HandleSet",
    "Handles",
    "PlaceSettings",
    "Surface",
    "placed",
    "read_handles",
    "schema_text",
]
