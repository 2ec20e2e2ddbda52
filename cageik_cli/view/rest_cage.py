"""The rest cage of a model, edited in a page: sent, read back, checked, solved and written.

Checks and weights are computed in a subprocess, which can be ended: a check that takes too long is,
and a new process is started with the next.
"""

import json
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.check.faults import Finding
from cageik_cli.formats.base.mesh_data import FileMesh, LoadedMesh
from cageik_cli.formats.find_files import Source
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.geometry.mesh import MAX_COORDINATE, TriMesh
from cageik_cli.geometry.mirror import find_mirror
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.inputs.source import holds_caged_model, load_surface
from cageik_cli.inputs.weights import BUILT_CAGE
from cageik_cli.method.pose.constraints import MAX_ASYMMETRY
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.vocabulary import CAGE_VERDICT_WORDS
from cageik_cli.run.settings import ViewSettings
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import (
    BusyError,
    CageikError,
    FormatError,
    SettingError,
    SlowError,
    error_context,
)
from cageik_cli.util.json_files import JsonFormat, format_value, parse_json
from cageik_cli.util.messages import Hint, Said, Spelling, spell, spell_keyword
from cageik_cli.util.outputs import check_no_overlap, check_writable
from cageik_cli.util.processes import Subprocess, SubprocessError
from cageik_cli.util.progress import ProgressListener, note_all
from cageik_cli.util.text import format_count
from cageik_cli.view.player.clip import PlayerClip, make_single_pose
from cageik_cli.view.player.section import (
    check_drawn_weights,
    pack_weights,
    render_rest_cage_page,
)
from cageik_cli.view.server import MAX_SUBMITTED_BYTES, Edit, Rows
from cageik_cli.view.session import PageSession, WatchedInput

MAX_CHECK_SECONDS = 20.0
"""A check that takes longer is ended: one of a usual cage takes less than a second."""

MAX_WEIGHTS_SECONDS = 300.0
"""The same of weights."""

MAX_SHOWN_ELEMENTS = 200
"""Faulty elements of one finding that are sent to be drawn; its sentence counts all."""

Answer = dict[str, Any]


BOX_CORNERS = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, 8).T


BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


class RestCageSession(PageSession):
    """A model, and the cage around it that a page edits."""

    def __init__(
        self, settings: ViewSettings, rest: LoadedMesh, cage: LoadedMesh, name: str
    ) -> None:
        check_size(cage.mesh)
        super().__init__(settings)
        self._rest, self._cage, self._name = rest.mesh, cage.mesh, name
        paths = (settings.target, settings.cage)
        self._watched = [
            WatchedInput(Source.parse(path).file) for path in paths if path is not None
        ]
        self._clip = _make_clip(rest.mesh, cage.mesh, name)
        origin, weights = self._clip.binding.cage.vertices.mean(axis=0), settings.weights
        self.subprocess = CageSubprocess(rest.mesh, origin, weights.bind, weights.jobs)
        self.answers = {"check": self.check, "weights": self.solve}

    def render_page(self) -> str:
        """Render the page, with the cage to begin with."""
        mirror = find_mirror(self._cage.vertices, MAX_ASYMMETRY)
        cage = encode_cage(
            self._cage,
            name=self._name,
            most=MAX_EDITED_VERTICES,
            mirror=None if mirror is None else mirror.to_record(),
        )
        return render_rest_cage_page(self._clip, "apply" if self.can_apply else "", cage)

    def check(self, data: bytes, spelling: Spelling = spell_keyword) -> Answer:
        """Diagnose a cage that was sent, with what to do in the words of the reader."""
        return self.subprocess.check(parse_cage(data), spelling)

    def solve(self, data: bytes, _spelling: Spelling = spell_keyword) -> Answer:
        """Solve the weights of a cage that was sent."""
        cage = parse_cage(data)
        check_drawn_weights(self._rest, cage)
        return self.subprocess.solve(cage)

    def parse(self, data: bytes, rigidity: int) -> Edit:
        """Return what writes a cage that was sent."""
        if rigidity:
            raise FormatError("a rest cage has no rounds of rotations; leave rigidity out")
        cage = parse_cage(data)
        return lambda progress: self._write(cage, progress)

    def close(self) -> None:
        """End the process that checks."""
        self.subprocess.close()

    def _write(self, cage: TriMesh, progress: ProgressListener) -> Rows:
        """Write a cage, and say how it is judged."""
        output = self._get_output()
        for watched in self._watched:
            watched.check()
        check_writable(output, self._own.may_replace(output))
        is_moved = has_polygons_of(cage, self._cage)
        with progress.stage("write"), self._own.guard():
            kept = self._cage.move(cage.vertices) if is_moved else cage
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
    if holds_caged_model(settings.target):
        raise SettingError(
            f"{settings.target}: is a result or a binding, whose cage has weights; give its "
            "model and " + Hint("cage", settings.target)
        )
    if settings.output is not None:
        check_mesh_output(settings.output, settings.overwrite)
    with progress.stage("open"):
        rest = load_surface(settings.target, settings.exclude).mesh
        note_all(progress, rest.notes, rest.source["name"])
    cage, name = _open_cage(settings, rest, progress)
    with error_context(name):
        return RestCageSession(settings, rest, cage, name)


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
    document = parse_json(data, CAGE_FORMAT)
    if not isinstance(document, dict) or document.keys() != {"vertices", "polygons"}:
        raise FormatError(
            f"is {format_value(document)}, expected an object with `vertices` and `polygons` alone"
        )
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


class CageSubprocess:
    """Checks cages around one model, and solves their weights, one at a time.

    Parameters
    ----------
    rest : TriMesh
        The model.
    origin : (3,) float64
        That of positions in the page, file units.
    jobs : int
        Threads.
    """

    def __init__(
        self, rest: TriMesh, origin: Floats, bind_settings: BindSettings, jobs: int
    ) -> None:
        self._kept = rest, origin, bind_settings, jobs
        self._lock = threading.Lock()
        self._process: Subprocess | None = None

    def check(self, cage: TriMesh, spelling: Spelling | None = spell_keyword) -> Answer:
        """Diagnose a cage as `cageik check` does: the verdict, and the findings with their places.

        Settings that remedies name are written as `spelling` does; without it, they are left to who
        shows the sentences.

        Raises
        ------
        BusyError, SlowError
        """
        answer = self._run(_diagnose_cage, cage, "the check", MAX_CHECK_SECONDS)
        for found in answer["findings"]:
            text: Said = f"{found.pop('message')}; " + found.pop("remedy")
            found["sentence"] = text if spelling is None else spell(text, spelling)
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
                self._process.call(_keep, *self._kept)
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


_kept: tuple[TriMesh, Floats, BindSettings, int]
"""Of the subprocess of the server: what all its calls need."""


def _keep(*kept: Any) -> None:
    global _kept
    _kept = kept


def _diagnose_cage(cage: TriMesh) -> Answer:
    rest, _, _, jobs = _kept
    diagnosis = diagnose(cage, rest, jobs)
    return {
        "verdict": diagnosis.verdict,
        "verdict_word": CAGE_VERDICT_WORDS[diagnosis.verdict],
        "cage": f"{format_count(len(cage.vertices), 'vertex')}, "
        f"{format_count(len(cage.polygons.corner_counts), 'face')}",
        "findings": [describe_finding(found, cage, rest) for found in diagnosis.findings],
    }


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
    return texts | places


def _solve_weights(cage: TriMesh) -> Answer:
    rest, origin, settings, jobs = _kept
    try:
        return {"payload": pack_weights(bind(rest, cage, settings, jobs), origin)}
    except CageikError as error:
        return {"error": error.text}
