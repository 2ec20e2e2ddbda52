"""The page that edits a rest cage, and the weights that it is sent when they are solved."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import FormatError
from cageik_cli.view.player.clip import PlayerClip, make_single_pose
from cageik_cli.view.player.compression import Predictor, decimate, pack_arrays
from cageik_cli.view.player.scripts import PLAYER_SCRIPTS
from cageik_cli.view.player.section import (
    MAX_DRAWN_VERTICES,
    MAX_WEIGHTS,
    VIEW_TEMPLATES,
    build_player_values,
    pack_skin,
    render_player,
)

REST_SCRIPTS = ("apply", "cage_mesh", "rest_mode")
"""Scripts that are added for this page."""

POSE_SCRIPTS = (
    "response",
    "poser",
    "tracks",
    "document",
    "editor",
    "handles",
    "cage_edits",
    "cage_mode",
    "influence",
)
"""Scripts that it does not need."""

REST_MODES = {"look": "Look", "rest": "Rest cage"}
"""What pointers on its picture can do."""

REST_PANELS = ("rest", "look", "parts")
"""Groups of its side panel, from top to bottom."""


def render_rest_cage_page(clip: PlayerClip, apply_url: str, cage: str) -> str:
    """Render the page of a model whose rest cage is edited.

    Parameters
    ----------
    clip : PlayerClip
        The model, at rest.
    apply_url : str
        Where the page sends the cage that is to be written; "" if it cannot be.
    cage : str
        The JSON of the cage to begin with.
    """
    *scripts, start = (name for name in PLAYER_SCRIPTS if name not in POSE_SCRIPTS)
    values = build_player_values(clip, apply_url)
    values |= {"is_app": True, "title": clip.title, "mode": "rest"}
    values |= {"panels": REST_PANELS, "modes": REST_MODES}
    return VIEW_TEMPLATES.render_page(
        "view.html.j2",
        player=render_player(values, (*scripts, *REST_SCRIPTS, start)),
        title=clip.title,
        is_applied=True,  # checks and weights are asked for, too
        handles="",
        cage_edits="",
        # In JSON, "<" is only in strings; so written, it cannot end the element that holds it.
        rest_cage=cage.replace("<", "\\u003c"),
    )


def choose_drawn(rest: TriMesh) -> tuple[Integers, Integers]:
    """Choose the vertices that this page draws, and faces between them, whatever the cage is."""
    if len(rest.vertices) <= MAX_DRAWN_VERTICES:
        return np.arange(len(rest.vertices)), rest.faces
    return decimate(rest, MAX_DRAWN_VERTICES)


def check_drawn_weights(rest: TriMesh, cage: TriMesh) -> None:
    """Refuse a cage whose weights would be too many for the page."""
    most = 2 * MAX_WEIGHTS // min(len(rest.vertices), MAX_DRAWN_VERTICES)
    if len(cage.vertices) > most:
        raise FormatError(
            f"the weights of {len(cage.vertices)} cage vertices are too many for the page, at most "
            f"{most} for this model; save the cage, and use cageik view without editing it"
        )


def pack_weights(binding: Binding, origin: Floats) -> str:
    """Pack the weights of a cage for the page; `origin` is that of its positions."""
    chosen, faces = choose_drawn(binding.rest)
    header, arrays = pack_skin(make_single_pose(binding), chosen, faces, origin)
    predictor = Predictor(faces, len(chosen))
    arrays["weights"] = predictor.encode(arrays["weights"])
    return pack_arrays({**header, "predicted": ["weights"]}, arrays)
