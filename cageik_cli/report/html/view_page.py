"""A page with the player alone: to look at a result, or to pose a model."""

from cageik_cli.report.html.player_section import build_player_values
from cageik_cli.report.html.templating import render_template
from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.report.vocabulary import choose_vocabulary


def render_view_page(clip: PlayerClip, apply_url: str = "", is_served: bool = False) -> str:
    """Render a page that plays a clip and poses its model.

    Parameters
    ----------
    clip : PlayerClip
    apply_url : str
        Where the page sends handles when they are applied, relative to its own address; "" if they
        are only saved.
    is_served : bool
        Whether the page may send requests to where it comes from.

    Returns
    -------
    str
        The same text for the same arguments.
    """
    return render_template(
        "view.html.j2",
        has_player=True,
        words=choose_vocabulary(None),
        player=build_player_values(clip, apply_url),
        target=clip.target,
        is_served=is_served,
    )
