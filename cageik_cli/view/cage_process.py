"""Checks and weights of a cage that is edited, in a subprocess of the server.

A process can be ended: a check that takes too long is, and a new one is started with the next.
"""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from cageik_cli.cages.bind import bind
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.check.faults import Finding, join_remedy
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.vocabulary import CAGE_VERDICT_WORDS
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import BusyError, CageikError, SlowError
from cageik_cli.util.processes import Subprocess, SubprocessError
from cageik_cli.util.text import format_count
from cageik_cli.view.player.rest_cage import pack_weights
from cageik_cli.view.site import Wording

MAX_CHECK_SECONDS = 20.0
"""A check that takes longer is ended: one of a usual cage takes less than a second."""

MAX_WEIGHTS_SECONDS = 300.0
"""The same of weights."""

MAX_SHOWN_ELEMENTS = 200
"""Faulty elements of one finding that are sent to be drawn; its sentence counts all."""

Answer = dict[str, Any]


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

    def check(self, cage: TriMesh, word: Wording = str) -> Answer:
        """Diagnose a cage as `cageik check` does: the verdict, and the findings with their places.

        `word` puts parameters that remedies name into the words of the reader.

        Raises
        ------
        BusyError, SlowError
        """
        answer = self._run(_diagnose_cage, cage, "the check", MAX_CHECK_SECONDS)
        for found in answer["findings"]:
            found["sentence"] = join_remedy(found.pop("message"), word(found.pop("remedy")))
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
        return {"error": str(error)}
