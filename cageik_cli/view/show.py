"""A result or a binding, shown in a notebook."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape

from cageik_cli.method.weights.binding import Binding
from cageik_cli.report.vocabulary import VOCABULARIES
from cageik_cli.store.result import Edit, Result
from cageik_cli.util.calls import check_call
from cageik_cli.view.player.clip import make_single_pose, require_player_clip
from cageik_cli.view.player.section import render_view_page

DEFAULT_HEIGHT = 720
"""Pixels: the whole player is seen in a usual notebook."""


@dataclass(frozen=True, slots=True)
class ShownPage:
    """A page that a notebook shows in a frame; elsewhere `html` can be written to a file.

    Attributes
    ----------
    html : str
        The page: it needs no other files and no network.
    height : int
        Of the frame, in pixels.

    Examples
    --------
    >>> from cageik_cli import bind, load_mesh, show
    >>> rest = load_mesh("data_fixtures/walker/frames/walker_1.obj")
    >>> page = show(bind(rest, load_mesh("data_fixtures/walker/cage.obj")), height=500)
    >>> from pathlib import Path
    >>> Path("pose.html").write_text(page.html) > 100_000
    True
    """

    html: str = field(repr=False)
    height: int = DEFAULT_HEIGHT

    def _repr_html_(self) -> str:
        """Return a frame with the page, in which it cannot reach the notebook."""
        return (
            f'<iframe srcdoc="{escape(self.html)}" sandbox="allow-scripts allow-downloads" '
            f'title="cageik" style="width: 100%; height: {self.height}px; border: 0"></iframe>'
        )


@check_call
def show(shown: Result | Edit | Binding, *, height: int = DEFAULT_HEIGHT) -> ShownPage:
    """Show a result, an edit or a model in a notebook, to play the clip or to pose the model.

    The page is kept in the notebook. It takes about 2 bytes per weight, and 12 bytes per cage
    vertex and frame, before they are packed.

    Parameters
    ----------
    height : int
        Of the frame, in pixels.

    Raises
    ------
    CageikError
        When a result was written without weights, or its file is damaged.

    Examples
    --------
    >>> from cageik_cli import extract_to_file, show
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> page = show(result)  # as the last line of a cell, it is shown
    >>> page
    ShownPage(height=720)
    >>> page.html.startswith("<!doctype html>")
    True
    """
    if isinstance(shown, Binding):
        return ShownPage(render_view_page(make_single_pose(shown)), height)
    clip = require_player_clip(shown, "a page")
    return ShownPage(render_view_page(clip, words=VOCABULARIES[shown.FORMAT]), height)
