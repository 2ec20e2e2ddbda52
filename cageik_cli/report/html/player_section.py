"""The part of a page that plays a clip and poses its model."""

from typing import Any

from cageik_cli.report.player.clip import PlayerClip
from cageik_cli.report.player.payload import build_payload, choose_vertices
from cageik_cli.util.text import format_count


def build_player_values(clip: PlayerClip, apply_url: str = "") -> dict[str, Any]:
    """Collect the values of the section; `apply_url` is as in `build_payload`."""
    count, drawn = len(clip.binding.rest.vertices), len(choose_vertices(clip.binding).vertices)
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
