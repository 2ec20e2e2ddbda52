"""A page with the player alone: to look at a result, or to pose a model."""

from cageik_cli.report.html.player_section import build_player_values
from cageik_cli.report.html.templating import VIEW_SCRIPTS, render_template
from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.report.vocabulary import choose_vocabulary


def render_view_page(
    clip: PlayerClip, apply_url: str = "", handles: str = "", edited_from: str | None = None
) -> str:
    """Render a page that plays a clip and poses its model.

    Parameters
    ----------
    apply_url : str
        Where the page sends handles when they are applied, relative to its own address; "" if they
        are only saved, and the page sends nothing at all.
    handles : str
        The text of a handles file that the page begins with, which has to be JSON; "" for none.
    edited_from : str, optional
        The result that the clip was edited from, if it was.

    Returns
    -------
    str
        The same text for the same arguments.
    """
    return render_template(
        "view.html.j2",
        player_scripts=VIEW_SCRIPTS,
        words=choose_vocabulary(edited_from),
        player=build_player_values(clip, apply_url),
        title=clip.title,
        is_applied=bool(apply_url),
        # In JSON, "<" is only in strings; so written, it cannot end the element that holds it.
        handles=handles.replace("<", "\\u003c"),
    )
