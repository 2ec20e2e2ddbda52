"""A small picture of a clip for lists: its worst frame, coloured by deviation.

The colours have one scale for all clips, so that clips can be compared at a glance.
"""

import numpy as np

from cageik_cli.report.render.model_views import (
    FRAME_LABELS,
    VIEW_TURN,
    encode_png,
    project_surface,
    view_axes,
)
from cageik_cli.report.render.raster import ParallelCamera
from cageik_cli.report.render.shading import (
    SAMPLES_PER_PIXEL,
    colour_pixels,
    render,
)
from cageik_cli.report.verdict import MAX_FAIR_DEVIATION
from cageik_cli.store.result import Result, read_binding, read_key_frames

THUMBNAIL_PIXELS = 96
"""Width and height of the picture."""

THUMBNAIL_COLOURS = 48
"""Colours of the picture, transparent ones among them: they keep it at a few kilobytes."""


def draw_thumbnail(result: Result) -> bytes | None:
    """Draw the worst frame of a result, as a PNG file; None if it was written without weights.

    The colours go from 0 to `MAX_FAIR_DEVIATION` percent of the diagonal; larger values are
    clamped.
    """
    binding = read_binding(result)
    if binding is None:
        return None
    key_frames, faces = read_key_frames(result, binding), result.rest.faces
    worst = FRAME_LABELS.index("worst")
    vertices = key_frames.reconstructed[worst]
    deviation = 100 * np.linalg.norm(key_frames.errors[worst], axis=1)
    deviation = np.where(np.isfinite(result.vertex_rms), deviation, np.nan)
    axes = view_axes(result.scene.up_axis, VIEW_TURN)
    size = SAMPLES_PER_PIXEL * THUMBNAIL_PIXELS
    camera = ParallelCamera.fit(axes, vertices[np.unique(faces)], size)
    surface = project_surface(camera, vertices, faces)
    picture = render(surface, colour_pixels(surface, deviation, MAX_FAIR_DEVIATION))
    return encode_png(picture, THUMBNAIL_COLOURS)
