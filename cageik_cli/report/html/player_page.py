"""The player on a page: the part that plays a clip and poses its model, and a page of it alone."""

from typing import Any

from cageik_cli.report.html.templating import PLAYER_SCRIPTS, render_template
from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.report.player.payload import build_payload, choose_vertices
from cageik_cli.report.vocabulary import choose_vocabulary
from cageik_cli.util.text import format_count


def build_player_values(clip: PlayerClip, apply_url: str = "") -> dict[str, Any]:
    """Collect the values of the section; `apply_url` is as in `build_payload`."""
    count, drawn = len(clip.binding.rest.vertices), len(choose_vertices(clip.binding)[0])
    notes = []
    if drawn < count:
        notes.append(
            f"The player draws {drawn} of {format_count(count, 'vertex')}, so that the page stays "
            "small; figures and pictures are of all."
        )
    if clip.left_out:
        notes.append(
            f"The player shows the first {format_count(len(clip.frames), 'frame')}; the last "
            f"{clip.left_out} are left out, so that the page stays small."
        )
    return {
        "title": "Player" if clip.frames else "Pose",
        "payload": build_payload(clip, apply_url),
        "is_open": not clip.frames,
        "notes": notes,
    }


def render_view_page(
    clip: PlayerClip, apply_url: str = "", handles: str = "", edited_from: str | None = None
) -> str:
    """Render a page that plays a clip and poses its model; the same text for the same arguments.

    Parameters
    ----------
    apply_url : str
        Where the page sends handles when they are applied, relative to its own address; "" if they
        are only saved, and the page sends nothing at all.
    handles : str
        The text of a handles file that the page begins with, which has to be JSON; "" for none.
    edited_from : str, optional
        The result that the clip was edited from, if it was.
    """
    *scripts, start = PLAYER_SCRIPTS
    return render_template(
        "view.html.j2",
        player_scripts=(*scripts, "apply", start),
        words=choose_vocabulary(edited_from),
        player=build_player_values(clip, apply_url),
        title=clip.title,
        is_applied=bool(apply_url),
        # In JSON, "<" is only in strings; so written, it cannot end the element that holds it.
        handles=handles.replace("<", "\\u003c"),
    )
