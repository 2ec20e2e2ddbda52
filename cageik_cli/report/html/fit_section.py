"""The part of the page that shows fitted weights beside those before the fit."""

from typing import Any

from cageik_cli.report.figures import format_percent
from cageik_cli.report.fit_figures import UnfittedRecord
from cageik_cli.report.html.templating import format_ticks, make_png_url
from cageik_cli.report.record import Report
from cageik_cli.report.render.fit_views import MOVE_SHARE, ComparedPictures, FitPictures
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.text import format_count


def build_fit_values(
    report: Report, pictures: FitPictures | None, words: Vocabulary
) -> dict[str, Any] | None:
    """Collect the values of the section; None if the result holds nothing to compare."""
    unfitted = report.unfitted
    if unfitted is None or pictures is None:
        return None
    names = (unfitted.coordinates, "fitted")
    top, reach = pictures.max_deviation_percent, pictures.max_move_percent
    titles = {"worst": f"{words.worst} frame".capitalize(), "median": "Median frame"}
    return {
        "summary": _describe_errors(unfitted, len(report.frames)),
        "names": names,
        "poses": [
            (titles[one.label], one.name, _list_pose_views(one, titles[one.label], names))
            for one in pictures.poses
        ],
        "vertex": pictures.vertex,
        "move": f"{100 * MOVE_SHARE:g} %",
        "ranges": [
            (name, _format_move(low), _format_move(high))
            for name, (low, high) in zip(
                names, (pictures.unfitted_range, pictures.fitted_range), strict=True
            )
        ],
        "moved": [
            (f"{name} weights".capitalize(), _list_moved_views(pictures, name, side))
            for side, name in enumerate(names)
        ],
        "colours": pictures.colours,
        "signed_colours": pictures.signed_colours,
        "ticks": format_ticks(top),
        "signed_ticks": format_ticks(reach, -reach),
    }


def _describe_errors(unfitted: UnfittedRecord, frames: int) -> str:
    measured = len(unfitted.frames)
    where = "all frames" if measured == frames else f"{measured} of {format_count(frames, 'frame')}"
    return (
        f"RMS over {where}: {format_percent(unfitted.mean_rms_percent)} % with "
        f"{unfitted.coordinates} weights, {format_percent(unfitted.fitted_rms_percent)} % with "
        "fitted ones"
    )


def _format_move(percent: float) -> str:
    """Format a displacement, without the sign of what rounds to zero."""
    return format_percent(round(percent, 4) + 0.0)


def _list_pose_views(
    one: ComparedPictures, title: str, names: tuple[str, str]
) -> list[tuple[str, str, str]]:
    """List the caption, the picture and the description of each view of a frame."""
    assert one.original is not None
    views = [("Input", make_png_url(one.original), f"{title}: the input")]
    for name, picture in zip(names, (one.unfitted, one.fitted), strict=True):
        text = f"{title} with {name} weights, coloured by deviation"
        views.append((name.capitalize(), make_png_url(picture), text))
    return views


def _list_moved_views(pictures: FitPictures, name: str, side: int) -> list[tuple[str, str, str]]:
    """List the caption, the picture and the description of each view of the moved vertex.

    `side` is 0 for the weights before the fit and 1 for fitted ones.
    """
    return [
        (
            one.name.capitalize(),
            make_png_url((one.unfitted, one.fitted)[side]),
            f"The rest pose with one cage vertex moved, {name} weights, {one.name}, coloured by "
            "displacement",
        )
        for one in pictures.moved
    ]
