"""The rest cage of a model, edited in a page: sent, read back, checked, solved and written.

The cage of a result can also be extracted in again (`result_cage`). Checks, repairs and weights are
computed in a subprocess, which can be ended: a check that takes too long is, and a new process is
started with the next.
"""

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.check.enclosure import locate_vertices
from cageik_cli.cages.check.faults import Finding
from cageik_cli.cages.check.misfit import Misfit
from cageik_cli.cages.repair.repair import Repair, repair_cage
from cageik_cli.cages.surface_points import sample_surface
from cageik_cli.formats.base.mesh_data import FileMesh, LoadedMesh
from cageik_cli.formats.find_files import Source
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.geometry.mesh import MAX_COORDINATE, TriMesh
from cageik_cli.geometry.mirror import find_mirror
from cageik_cli.geometry.shape import bounds_volume
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.source import holds_caged_model, load_surface
from cageik_cli.inputs.weights import BUILT_CAGE
from cageik_cli.method.pose.constraints import MAX_ASYMMETRY
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.figures import describe_length, format_briefly
from cageik_cli.report.vocabulary import CAGE_VERDICT_WORDS
from cageik_cli.run.settings import ViewSettings
from cageik_cli.store.binding_file import is_binding
from cageik_cli.store.result import Result, read_animation
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import (
    BusyError,
    CageError,
    CageikError,
    FormatError,
    SettingError,
    SlowError,
    error_context,
    join_truncated,
)
from cageik_cli.util.json_files import JsonFormat, format_value
from cageik_cli.util.messages import Hint, Said, Spelling, spell, spell_keyword
from cageik_cli.util.outputs import check_no_overlap, check_writable
from cageik_cli.util.processes import Subprocess, SubprocessError
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import format_count, to_unicode
from cageik_cli.view.player.clip import PlayerClip, make_single_pose
from cageik_cli.view.player.section import (
    check_drawn_weights,
    choose_vertices,
    pack_weights,
    render_rest_cage_page,
)
from cageik_cli.view.result_cage import ExtractAgain, find_focus
from cageik_cli.view.saved_names import NewFiles
from cageik_cli.view.server import MAX_SUBMITTED_BYTES, Edit, Rows
from cageik_cli.view.session import PageSession, WatchedInput, check_new_name, parse_object

MAX_CHECK_SECONDS = 20.0
"""A check that takes longer is ended: one of a usual cage takes less than a second."""

MAX_WEIGHTS_SECONDS = 300.0
"""The same of weights."""

MAX_REPAIR_SECONDS = 120.0
"""The same of a repair."""

MAX_SHOWN_ELEMENTS = 10_000
"""Faulty elements of one finding that are sent to be drawn: all that a cage has of one kind, and
what anybody sees of a model. Its sentence counts all."""

REPAIR = ", or Repair"

PAGE_ADVICE = {
    "repeated-vertex": "choose the face and Delete" + REPAIR,
    "degenerate-face": "Turn the longest edge of the face, or Collapse a short one" + REPAIR,
    "duplicate-face": "choose the face and Delete" + REPAIR,
    "unreferenced-vertex": "choose it by number and Delete" + REPAIR,
    "non-manifold-edge": "choose a face too many there, Linked and Delete" + REPAIR,
    "open-edge": "Fill holes" + REPAIR,
    "orientation": "Face outward" + REPAIR,
    "pinched-vertex": "Separate there, then Linked and Delete the part too many" + REPAIR,
    "self-intersection": "drag the red faces apart" + REPAIR,
    "components": "choose a face of the part too many, Linked and Delete" + REPAIR,
    "inward": "Face outward" + REPAIR,
    "surface-crossing": "drag the faces there outward" + REPAIR,
}
"""What to do in the page about a fault, where it is."""

Answer = dict[str, Any]


BOX_CORNERS = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, 8).T


BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


class RestCageSession(PageSession):
    """A model, and the cage around it that a page edits."""

    def __init__(
        self,
        settings: ViewSettings,
        rest: LoadedMesh,
        cage: LoadedMesh,
        name: str,
        result: Result | None = None,
    ) -> None:
        check_size(cage.mesh)
        super().__init__(settings)
        self._rest, self._cage, self._name = rest.mesh, cage.mesh, name
        paths = (settings.target, settings.cage)
        self._watched = [
            WatchedInput(Source.parse(path).file) for path in paths if path is not None
        ]
        self._clip = _make_clip(rest.mesh, cage.mesh, name)
        self._again: ExtractAgain | None = None
        if result is not None:
            self._clip = show_errors(self._clip, result)
            chosen, _ = choose_vertices(rest.mesh, self._clip.binding.cage)
            self._again = ExtractAgain(result, settings, chosen)
            self.jobs["extract"] = self.parse_again
            self.answers["errors"] = self.compare
        origin, weights = self._clip.binding.cage.vertices.mean(axis=0), settings.weights
        kept = KeptModel(rest.mesh, origin, weights.bind, weights.jobs, rest.scene.metres_per_unit)
        self.subprocess = CageSubprocess(kept)
        self.answers |= {"check": self.check, "weights": self.solve, "repair": self.repair}
        self.offer_names([".obj", ".ply"])

    def render_page(self, spelling: Spelling = spell_keyword) -> str:
        """Render the page, with the cage to begin with."""
        mirror = find_mirror(self._cage.vertices, MAX_ASYMMETRY)
        cage = encode_cage(
            self._cage,
            name=self._name,
            most=MAX_EDITED_VERTICES,
            mirror=None if mirror is None else mirror.to_record(),
        )
        session = self.describe()
        if self._again is not None:
            session["again"] = self._again.describe(spelling)
        return render_rest_cage_page(
            self._clip, "apply" if self.can_apply else "", cage, session=session
        )

    def check(self, data: bytes, spelling: Spelling = spell_keyword) -> Answer:
        """Diagnose a cage that was sent, with what to do in the words of the reader."""
        return self.subprocess.check(parse_cage(data), spelling)

    def solve(self, data: bytes, _spelling: Spelling = spell_keyword) -> Answer:
        """Solve the weights of a cage that was sent."""
        cage = parse_cage(data)
        check_drawn_weights(self._rest, cage)
        return self.subprocess.solve(cage)

    def repair(self, data: bytes, _spelling: Spelling = spell_keyword) -> Answer:
        """Repair a cage that was sent, as far as that is possible."""
        return self.subprocess.repair(parse_cage(data))

    def compare(self, data: bytes, _spelling: Spelling = spell_keyword) -> Answer:
        """Return the errors of the result, and of the last extraction."""
        parse_object(data, [], CAGE_FORMAT)
        assert self._again is not None
        return self._again.compare()

    def parse(self, data: bytes, rigidity: int) -> Edit:
        """Return what writes a cage that was sent."""
        if rigidity:
            raise FormatError("a rest cage has no rounds of rotations; leave rigidity out")
        cage, output = parse_cage(data), self._get_output()
        return lambda progress: self._write(cage, output, progress)

    def parse_saved(self, data: bytes) -> Edit:
        """Return what writes a cage that was sent to a new file."""
        cage, output = parse_named_cage(data, self.new_files)
        return lambda progress: self._write(cage, output, progress)

    def parse_again(self, data: bytes) -> Edit:
        """Return what extracts the result again in a cage that was sent."""
        assert self._again is not None
        cage, output = parse_named_cage(data, self._again.new_files)
        return lambda progress: self._extract(cage, output, progress)

    def close(self) -> None:
        """End the process that checks."""
        self.subprocess.close()

    def _extract(self, cage: TriMesh, output: Path, progress: ProgressListener) -> Rows:
        """Extract the result again in a cage, and say what the errors were and are."""
        assert self._again is not None
        for watched in self._watched:
            watched.check()
        check_writable(output, overwrite=False)
        rows, self.written = self._again.run(cage, self._keep_surface(cage), output, progress)
        return rows

    def _keep_surface(self, cage: TriMesh) -> TriMesh:
        """Return a cage with what its file said of the surface, if vertices at most moved."""
        is_moved = has_polygons_of(cage, self._cage)
        return self._cage.move(cage.vertices) if is_moved else cage

    def _write(self, cage: TriMesh, output: Path, progress: ProgressListener) -> Rows:
        """Write a cage, and say how it is judged."""
        for watched in self._watched:
            watched.check()
        check_writable(output, self._own.may_replace(output))
        is_moved = has_polygons_of(cage, self._cage)
        with progress.stage("write"), self._own.guard():
            kept = self._keep_surface(cage)
            write_mesh(output, kept, cage.vertices, self._own.may_replace(output), is_exact=True)
            self._own.record(output)
        self.written = (output,)
        return [*self._describe(cage), *([] if is_moved else self._list_losses())]

    def _describe(self, cage: TriMesh) -> Rows:
        counts = format_count(len(cage.vertices), "vertex")
        size = f"{counts}, {format_count(len(cage.polygons.corner_counts), 'face')}"
        try:
            answer = self.subprocess.check(cage, None)
        except CageikError:
            return [("cage", size)]
        found = [(one["severity"], one["sentence"]) for one in answer["findings"]]
        return [("verdict", answer["verdict_word"]), ("cage", size), *found]

    def _list_losses(self) -> Rows:
        """Say what a cage whose faces were changed has lost."""
        attributes = self._cage.attributes
        if attributes is None:
            return []
        kept = type(attributes)(attributes.corner_counts, attributes.corners)
        if attributes.description == kept.description:
            return []
        lost = attributes.description.partition(" with ")[2]
        return [("note", f"faces were changed, so that {lost} are not written")]


def open_rest_cage(settings: ViewSettings, progress: ProgressListener) -> RestCageSession:
    """Read a model and its cage, which need not be fit; without one, a cage is built."""
    check_no_overlap(settings.outputs(), settings.inputs())
    if settings.output is not None:
        check_mesh_output(settings.output, settings.overwrite)
    if holds_caged_model(settings.target):
        with progress.stage("open"):
            return _open_result(settings)
    with progress.stage("open"):
        rest = load_surface(settings.target, settings.exclude).mesh
        note_all(progress, rest.notes, rest.source["name"])
    cage, name = _open_cage(settings, rest, progress)
    with error_context(name):
        return RestCageSession(settings, rest, cage, name)


def _open_result(settings: ViewSettings) -> RestCageSession:
    """Open the cage of a result."""
    if is_binding(settings.target):
        raise SettingError(
            f"{settings.target}: is a binding, whose cage has weights; give its model and "
            + Hint("cage", settings.target)
        )
    result = read_animation(settings.target)
    if not isinstance(result, Result):
        raise SettingError(
            f"{settings.target}: is an edit, which was not extracted from frames; give the result "
            f"that it was made from, {result.edited_from}"
        )
    scene, cage = result.scene.space, result.sources.get("cage", {"name": BUILT_CAGE})
    rest = LoadedMesh(result.rest, {"name": result.path.name}, scene=scene)
    loaded = LoadedMesh(result.cage, {"name": str(cage["name"])}, scene=scene)
    return RestCageSession(settings, rest, loaded, to_unicode(result.path.name), result)


def show_errors(clip: PlayerClip, result: Result) -> PlayerClip:
    """Return the clip of a rest pose with the errors of a result."""
    percents = 100 * result.vertex_rms / (result.rest.diagonal or 1.0)
    return replace(
        clip, vertex_rms=percents, focus=find_focus(result), up_axis=result.scene.up_axis
    )


def _open_cage(
    settings: ViewSettings, rest: LoadedMesh, progress: ProgressListener
) -> tuple[LoadedMesh, str]:
    if settings.cage is None:
        from cageik_cli.inputs.source import LoadedModel

        caged = CagedModel(settings.target, LoadedModel(rest), None)
        built = caged.build_cage(settings.build, settings.weights.cache, progress).cage
        assert built is not None
        return built, BUILT_CAGE
    common = CommonScene(rest.scene, settings.given_in)
    cage = common.open_cage(settings.cage)
    note_all(progress, cage.notes, cage.source["name"])
    return cage, Source.parse(settings.cage).name


def _make_clip(rest: TriMesh, cage: TriMesh, name: str) -> PlayerClip:
    """Make the clip of a model in a box, which has weights whatever the cage is.

    Those of a point in a box are products of its shares along the axes.
    """
    points = np.concatenate([rest.vertices, cage.vertices])
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    size = np.maximum(size, 1e-3 * (float(np.linalg.norm(size)) or 1.0))
    shares: Floats = (rest.vertices - low) / size
    weights = np.prod(np.where(BOX_CORNERS, shares[:, None], 1 - shares[:, None]), axis=2)
    box = TriMesh(low + size * BOX_CORNERS, BOX_FACES)
    clip = make_single_pose(Binding(rest, box, weights))
    return replace(clip, title=name)


MAX_EDITED_VERTICES = 2500
"""Vertices of a cage that is edited: a closed one then has as many faces as can be bound."""

MAX_EDITED_CORNERS = 20_000
"""Corners of all its polygons, and so the triangles that they are cut into."""

CAGE_FORMAT = JsonFormat("a cage of the page", MAX_SUBMITTED_BYTES)


def check_size(cage: TriMesh) -> None:
    """Refuse a cage that is too large to be edited."""
    for count, most, noun in (
        (len(cage.vertices), MAX_EDITED_VERTICES, "vertex"),
        (len(cage.polygons.corners), MAX_EDITED_CORNERS, "corner"),
    ):
        if count > most:
            raise FormatError(
                f"the cage has {format_count(count, noun)}, at most {most} can be edited; "
                "use a coarser cage"
            )


def encode_cage(cage: TriMesh, **values: Any) -> str:
    """Return the JSON of a cage, and of further values, with all digits of its coordinates."""
    document = {"vertices": cage.vertices.tolist(), "polygons": list_polygons(cage), **values}
    return json.dumps(document, separators=(",", ":"))


def list_polygons(mesh: TriMesh) -> list[list[int]]:
    """Return the vertices of each polygon."""
    starts = mesh.polygons.starts.tolist()
    return [part.tolist() for part in np.split(mesh.polygons.corners, starts[1:])]


def parse_cage(data: bytes) -> TriMesh:
    """Return the cage of a body that was sent; its vertices have the numbers of the text.

    Raises
    ------
    FormatError
        When it is not {"vertices": [[x, y, z], …], "polygons": [[…], …]}, or too large.
    """
    return make_cage(parse_object(data, ["vertices", "polygons"], CAGE_FORMAT))


def parse_named_cage(data: bytes, new_files: NewFiles | None) -> tuple[TriMesh, Path]:
    """Return the cage of a body, and the file of the name that was sent with it.

    Raises
    ------
    FormatError, OutputError
        As of `parse_cage` and `NewFiles.check`.
    """
    document = parse_object(data, ["vertices", "polygons", "name"], CAGE_FORMAT)
    path = check_new_name(new_files, document)
    return make_cage(document), path


def make_cage(document: dict[str, Any]) -> TriMesh:
    """Return the cage of vertices and polygons that were sent; raises as `parse_cage`."""
    vertices = _check_rows(document["vertices"], "vertices", MAX_EDITED_VERTICES)
    for k, vertex in enumerate(vertices):
        if len(vertex) != 3 or not all(map(_is_coordinate, vertex)):
            raise FormatError(
                f"vertices[{k}]: expected three numbers up to {MAX_COORDINATE:g}; send the cage "
                "again"
            )
    polygons = _check_rows(document["polygons"], "polygons", MAX_EDITED_CORNERS // 3)
    for k, polygon in enumerate(polygons):
        if len(polygon) < 3 or not all(
            isinstance(corner, int) and not isinstance(corner, bool) and 0 <= corner < len(vertices)
            for corner in polygon
        ):
            raise FormatError(
                f"polygons[{k}]: expected three or more vertices from 0 to {len(vertices) - 1}; "
                "send the cage again"
            )
    if (count := sum(map(len, polygons))) > MAX_EDITED_CORNERS:
        raise FormatError(
            f"polygons: have {count} corners, expected at most {MAX_EDITED_CORNERS}; use a "
            "coarser cage"
        )
    return FileMesh.from_polygons(np.array(vertices, float), polygons).make_mesh()


def _check_rows(value: Any, name: str, most: int) -> list[list[Any]]:
    """Return a list of lists that is not empty and not too long."""
    if not isinstance(value, list) or not 0 < len(value) <= most:
        raise FormatError(
            f"{name}: is {format_value(value)}, expected a list of 1 to {most}; use a coarser cage"
        )
    for k, row in enumerate(value):
        if not isinstance(row, list):
            raise FormatError(f"{name}[{k}]: is {format_value(row)}, expected a list")
    return value


def _is_coordinate(value: Any) -> bool:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return is_number and abs(value) <= MAX_COORDINATE


def has_polygons_of(cage: TriMesh, other: TriMesh) -> bool:
    """Whether two cages have the same polygons, and as many vertices: vertices at most moved."""
    return len(cage.vertices) == len(other.vertices) and all(
        np.array_equal(getattr(cage.polygons, name), getattr(other.polygons, name))
        for name in ("corner_counts", "corners")
    )


@dataclass(frozen=True, slots=True, eq=False)
class KeptModel:
    """What all calls of the subprocess need.

    Attributes
    ----------
    rest : TriMesh
        The model.
    origin : (3,) float64
        That of positions in the page, file units.
    jobs : int
        Threads.
    metres_per_unit : float, optional
        None if it is not known.
    """

    rest: TriMesh
    origin: Floats
    bind: BindSettings
    jobs: int
    metres_per_unit: float | None = None


class CageSubprocess:
    """Checks and repairs cages around one model, and solves their weights, one at a time."""

    def __init__(self, kept: KeptModel) -> None:
        self._kept = kept
        self._lock = threading.Lock()
        self._process: Subprocess | None = None

    def check(self, cage: TriMesh, spelling: Spelling | None = spell_keyword) -> Answer:
        """Diagnose a cage as `cageik check` does: the verdict, and the findings with their places.

        Settings that remedies name are written as `spelling` does, and what the page can do is
        advised; without it, the remedies are left to who shows the sentences.

        Raises
        ------
        BusyError, SlowError
        """
        answer = self._run(_diagnose_cage, cage, "the check", MAX_CHECK_SECONDS)
        for found in answer["findings"]:
            message, remedy, advice = (found.pop(name) for name in ("message", "remedy", "advice"))
            text: Said = f"{message}; " + (advice if advice and spelling else remedy)
            found["sentence"] = text if spelling is None else spell(text, spelling)
        return answer

    def repair(self, cage: TriMesh) -> Answer:
        """Repair a cage as `cageik cage --repair` does, also if faults are left.

        Raises
        ------
        BusyError, SlowError
        CageikError
            When nothing of it would be left, or too much.
        """
        answer = self._run(_repair_cage, cage, "the repair", MAX_REPAIR_SECONDS)
        if "error" in answer:
            raise CageikError(answer["error"])
        return answer

    def solve(self, cage: TriMesh) -> Answer:
        """Solve the weights of a cage, as the page unpacks them.

        Raises
        ------
        BusyError, SlowError
        CageikError
            When the cage is not fit.
        """
        answer = self._run(_solve_weights, cage, "the weights", MAX_WEIGHTS_SECONDS)
        if "error" in answer:
            raise CageikError(answer["error"])
        return answer

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            process.end()

    def _run(
        self, work: Callable[[TriMesh], Answer], cage: TriMesh, what: str, seconds: float
    ) -> Answer:
        if not self._lock.acquire(blocking=False):
            raise BusyError("another cage is being checked or solved; try again when it is done")
        try:
            if self._process is None:
                self._process = Subprocess()
                self._process.call(_keep, self._kept)
            return self._process.call(work, cage, seconds=seconds)
        except TimeoutError as error:
            self.close()
            raise SlowError(
                f"{what} took more than {seconds:g} seconds and was ended; use a coarser cage or "
                "a coarser model"
            ) from error
        except SubprocessError as error:
            self.close()
            raise SlowError(
                f"{what} ended the process that computed it; there may be too little memory: use "
                "a coarser cage or model"
            ) from error
        finally:
            self._lock.release()


_kept: KeptModel
"""Of the subprocess of the server."""


def _keep(kept: KeptModel) -> None:
    global _kept
    _kept = kept


def _diagnose_cage(cage: TriMesh) -> Answer:
    kept = _kept
    diagnosis = diagnose(cage, kept.rest, kept.jobs)
    findings = [describe_finding(found, cage, kept.rest) for found in diagnosis.findings]
    misfit = diagnosis.misfit
    if misfit is None and (hidden := find_hidden_misfit(cage, kept.rest)):
        found, misfit = hidden
        findings.append(describe_finding(found, cage, kept.rest))
    for one in findings:
        if one["kind"] == "outside" and misfit is not None:
            one |= advise_on_misfit(misfit, kept)
    return {
        "verdict": diagnosis.verdict,
        "verdict_word": CAGE_VERDICT_WORDS[diagnosis.verdict],
        "cage": f"{format_count(len(cage.vertices), 'vertex')}, "
        f"{format_count(len(cage.polygons.corner_counts), 'face')}",
        "findings": findings,
    }


def find_hidden_misfit(cage: TriMesh, rest: TriMesh) -> tuple[Finding, Misfit] | None:
    """Find what is outside a cage whose other faults hide it: holes, or faces that are turned.

    It is what is outside once these are mended; nothing is moved.
    """
    if bounds_volume(cage) or rest.diagonal <= 0:
        return None
    repair = Repair(cage.fan_triangulated, None)
    try:
        repair.tidy_faces(sample_surface(rest))
    except CageError:
        return None  # nothing of the cage is left
    closed = repair.mesh.triangles
    if not bounds_volume(closed):
        return None
    placement = locate_vertices(closed if closed.volume > 0 else closed.flip(), rest)
    if not len(placement.outside_indices):
        return None
    misfit, origins = placement.explain(), repair.origins
    dents = [replace(dent, vertex=int(origins[dent.vertex])) for dent in misfit.dents]
    known = tuple(dent for dent in dents if dent.vertex >= 0)
    found = placement.find_outside(misfit.remedy)
    message = f"when its faces are mended, {found.message}"
    return replace(found, message=message), replace(misfit, dents=known)


def advise_on_misfit(misfit: Misfit, kept: KeptModel) -> Answer:
    """Return what to do in the page about vertices outside, and which cage vertices to drag."""
    drag, diagonal = [dent.vertex for dent in misfit.dents], kept.rest.diagonal
    if misfit.dents:
        first = misfit.dents[0]
        length = f"{format_briefly(100 * first.depth / diagonal)} % of the diagonal"
        if kept.metres_per_unit is not None:
            length = describe_length(first.depth, kept.metres_per_unit)
        others = "" if len(drag) == 1 else f", and {join_truncated(drag[1:])} less"
        it = "it" if len(drag) == 1 else "them"
        advice = f"{first.describe(length)}{others}: drag {it} out{REPAIR}"
    elif misfit.inflation is not None:
        advice = f"the cage is too small all over: Inflate by {misfit.inflation:g} %{REPAIR}"
    elif misfit.is_repairable and misfit.transform is None:
        advice = f"drag the cage out where the model is outside{REPAIR}"
    else:
        return {}
    return {"advice": advice, "vertices": drag}


def describe_finding(found: Finding, cage: TriMesh, rest: TriMesh) -> Answer:
    """Return a finding with its places: elements of the cage by their vertices, and points."""
    numbers = found.numbers
    places: dict[str, Any] = {"vertices": [], "edges": [], "faces": [], "points": []}
    if found.place is not None:
        places["points"] = [list(found.place)]
    elif found.mesh == "rest":
        corners = rest.vertices[rest.faces] if found.elements.startswith("face") else rest.vertices
        points = corners[numbers.ravel()[:MAX_SHOWN_ELEMENTS]]
        places["points"] = points.reshape(-1, 3).tolist()
    elif found.elements.startswith("face"):
        of_cage = numbers[:, 1] if found.mesh == "both" else numbers
        faces = np.unique(of_cage)[:MAX_SHOWN_ELEMENTS]
        places["faces"] = cage.faces[faces].tolist()
    elif found.elements:
        places[found.elements] = numbers[:MAX_SHOWN_ELEMENTS].tolist()
    texts = {name: getattr(found, name) for name in ("kind", "severity", "message", "remedy")}
    return texts | places | {"advice": PAGE_ADVICE.get(found.kind, "")}


def _repair_cage(cage: TriMesh) -> Answer:
    counts = None if cage.attributes is None else cage.attributes.corner_counts
    try:
        repaired = repair_cage(cage.fan_triangulated, _kept.rest, counts)
        check_size(repaired.cage)
    except CageikError as error:
        return {"error": error.text}
    return {
        "vertices": repaired.mesh.vertices.tolist(),
        "polygons": [ring.tolist() for ring in repaired.mesh.rings],
        "steps": [step.message for step in repaired.steps],
        "is_fit": repaired.is_fit,
    }


def _solve_weights(cage: TriMesh) -> Answer:
    kept = _kept
    try:
        bound = bind(kept.rest, cage, kept.bind, kept.jobs)
        return {"payload": pack_weights(bound, kept.origin)}
    except CageikError as error:
        return {"error": error.text}
