"""The cage of a result, edited in a page: where the clip is followed worst, and a new extraction.

The new result, and the cage that it is of, are new files beside the one that is viewed.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.write import write_mesh
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.solve.regions import Cause
from cageik_cli.report.figures import ClipRecord, format_briefly, format_scene_length
from cageik_cli.report.record import Report, build_report
from cageik_cli.report.regions import CAUSES
from cageik_cli.report.render.model_views import VIEW_TURN
from cageik_cli.run.repeat import extract_again, find_clip
from cageik_cli.run.settings import ViewSettings
from cageik_cli.store.result import Result, checkpoint_path, read_result
from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import CageikError
from cageik_cli.util.messages import Spelling, spell
from cageik_cli.util.progress import ProgressListener
from cageik_cli.view.saved_names import NewFiles
from cageik_cli.view.server import Rows

MIN_PLACE_SIZE = 0.15
"""Half the width of what is shown of a bad place, at least, in diagonals."""

DIVIDE, APPROACH = "Subdivide the chosen faces", "drag the chosen faces closer to the model"

PLACE_ADVICE = {
    Cause.COARSE_FACES: DIVIDE,
    Cause.WEAK_INFLUENCE: DIVIDE,
    Cause.UNKNOWN: DIVIDE,
    Cause.FAR_CAGE: APPROACH,
    Cause.LOOSE_CAGE: APPROACH,
    Cause.THIN_FACES: "drag the corners of the chosen faces apart",
    Cause.SHARED_LOOP: "give each limb faces of its own",
}
"""What to do in the page about a bad place; a cage does not mend what smoothing takes away."""


class ExtractAgain:
    """Extracts a result again in cages that are sent, and compares the errors.

    Parameters
    ----------
    chosen : (k,) int64
        The vertices that the page draws.
    """

    def __init__(self, result: Result, settings: ViewSettings, chosen: Integers) -> None:
        self._settings, self._chosen = settings, chosen
        self.result = result
        self._after: Result | None = None
        self.new_files = NewFiles(
            result.path, [".h5"], lambda path: (find_cage_path(path), checkpoint_path(path))
        )

    def describe(self, spelling: Spelling) -> dict[str, Any]:
        """Return what the page begins with: a free name, bad places, and what is in the way."""
        try:
            find_clip(self.result, self._settings.clip)
            problem = ""
        except CageikError as error:
            problem = spell(error.text, spelling)
        return {
            "name": self.new_files.propose(),
            "problem": problem,
            "places": list_places(self.result),
            "before": describe_errors(build_report(self.result)),
        }

    def run(
        self, cage: TriMesh, kept: TriMesh, output: Path, progress: ProgressListener
    ) -> tuple[Rows, tuple[Path, ...]]:
        """Write a cage, and extract the clip in it; return the errors, and what was written.

        Parameters
        ----------
        cage : TriMesh
        kept : TriMesh
            The same, with all that its file said of the surface.
        """
        path = find_cage_path(output)
        write_mesh(path, kept, cage.vertices, False, is_exact=True)
        try:
            extract_again(
                self.result,
                path,
                output,
                progress,
                clip=self._settings.clip,
                cache=self._settings.weights.cache,
                jobs=self._settings.weights.jobs,
            )
        except BaseException:
            # Frames that are solved already can be continued, with this cage.
            if not checkpoint_path(output).exists():
                path.unlink(missing_ok=True)
            raise
        self._after = read_result(output)
        reports = [build_report(result) for result in (self.result, self._after)]
        rows = [
            (label, describe_errors(report)["text"])
            for label, report in zip(("before", "after"), reports, strict=True)
        ]
        return rows, (output, path)

    def compare(self) -> dict[str, Any]:
        """Return the errors before, and after the last extraction, with those of the vertices."""
        answer: dict[str, Any] = {}
        for name, result in (("before", self.result), ("after", self._after)):
            answer[name] = None
            if result is not None:
                percents = 100 * result.vertex_rms[self._chosen] / result.rest.diagonal
                rms = [None if np.isnan(x) else float(f"{x:.5g}") for x in percents.tolist()]
                answer[name] = {
                    **describe_errors(build_report(result)),
                    "rms": rms,
                    "places": list_places(result),
                }
        return answer


def find_cage_path(output: Path) -> Path:
    """Return where the cage of a new result is written."""
    return output.with_name(f"{output.stem}.cage.obj")


def describe_errors(report: Report) -> dict[str, Any]:
    """Return the errors of a result in words, and in percent of the diagonal."""
    summary, clip = report.summary, report.clip
    rms, largest = summary.rms_percent, summary.max_deviation_percent
    text = (
        f"{report.verdict}: {_format_both(clip, rms)} on average, at most "
        f"{_format_both(clip, largest)}"
    )
    return {"name": report.result, "text": text, "average": rms, "largest": largest}


def _format_both(clip: ClipRecord, percent: float) -> str:
    return f"{format_briefly(percent)} % ({format_scene_length(clip, percent)})"


def list_places(result: Result) -> list[dict[str, Any]]:
    """List where the clip is followed worst: the worst regions, else the largest deviation.

    Each has its sentence, a point of the rest pose, how much around it is shown, in diagonals, and
    how many faces of the cage are near.
    """
    report = build_report(result)
    if not report.regions:
        summary = report.summary
        vertex = summary.max_deviation_vertex
        where = f"vertex {vertex}, in {summary.max_deviation_frame}"
        text = f"at most {_format_both(report.clip, summary.max_deviation_percent)} at {where}"
        return [_make_place(f"{text}; {DIVIDE}", result.rest.vertices[vertex].tolist(), 0.0, 1)]
    places = []
    for region in report.regions:
        cause, _ = CAUSES[region.cause]
        deviation = _format_both(report.clip, region.max_deviation_percent)
        part = f" of {region.part}" if region.part else ""
        text = f"{deviation} at vertex {region.worst_vertex}{part}, in {region.frame}: {cause}"
        if region.cause in PLACE_ADVICE:
            text += f"; {PLACE_ADVICE[region.cause]}"
        size = region.size_percent / 100
        places.append(_make_place(text, region.centre, size, len(region.cage_faces)))
    return places


def _make_place(text: str, point: Sequence[float], size: float, faces: int) -> dict[str, Any]:
    return {
        "sentence": text,
        "point": list(point),
        "size": max(size, MIN_PLACE_SIZE),
        "faces": faces,
    }


def find_focus(result: Result) -> dict[str, Any]:
    """Return the place that the key W shows; see `PlayerClip.focus`."""
    first = next(iter(result.regions or ()), None)
    if first is None:
        vertex = int(result.metrics.worst_vertex[int(np.nanargmax(result.metrics.max_deviation))])
        size = 0.0
    else:
        vertex, size = first.worst_vertex, first.size / (result.rest.diagonal or 1.0)
    extent = max(size, MIN_PLACE_SIZE)
    return {"frame": 0, "vertex": vertex, "extent": extent, "turn": VIEW_TURN}
