"""Meshes before: the input of a clip, and the result that an edit was made from, for a page.

A page asks for some frames of one of them, as it shows them:

    {"kind": "input" or "unedited", "first": k, "count": n}

The answer is, frame by frame, the positions of the vertices that the page draws, as float32 in its
units; those of a frame that is not there are nan. Files are looked for when they are first asked
for, by the names and digests that the result records: what the page sends names none.
"""

from collections.abc import Iterator
from itertools import islice

import numpy as np

from cageik_cli.inputs.input_frames import InputFrames, find_edited, find_input
from cageik_cli.inputs.reconstruction import CageFrames, Reconstruction
from cageik_cli.store.result import Edit, Result, StoredAnimation, read_binding
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, FormatError
from cageik_cli.util.files import mark_file
from cageik_cli.util.json_files import JsonFormat, format_value, parse_json
from cageik_cli.view.player.clip import PlayerClip
from cageik_cli.view.player.section import choose_vertices
from cageik_cli.view.server import Stream

MAX_ASKED_BYTES = 1024
"""Largest body of a request for frames."""

MAX_ASKED_FRAMES = 64
"""Frames of a request."""

MAX_STREAM_BYTES = 1 << 23
"""Bytes of an answer, which ends earlier if the next frame would be beyond; one is always sent."""

BEFORE_FORMAT = JsonFormat("a request for frames", MAX_ASKED_BYTES)


def list_before(shown: StoredAnimation) -> tuple[str, ...]:
    """List what a page can ask for of a result or an edit."""
    return ("unedited", "input") if isinstance(shown, Edit) else ("input",)


class BeforeFrames:
    """Reads the frames that a page asks for, one at a time.

    Parameters
    ----------
    shown : Result or Edit
        With weights.
    clip : PlayerClip
        What the page shows of it.
    """

    def __init__(self, shown: StoredAnimation, clip: PlayerClip) -> None:
        self._shown = shown
        rest, cage = clip.binding.rest, clip.binding.cage
        self._chosen = choose_vertices(rest, cage)[0]
        self._origin, self._diagonal = cage.vertices.mean(axis=0), rest.diagonal or 1.0
        self._count = len(clip.cages)
        self._opened: dict[str, _Meshes] = {}

    def answer(self, data: bytes) -> Stream:
        """Return the frames that a body asks for.

        Raises
        ------
        FormatError
            When it is not such a request.
        FileAccessError
            When the files are not there, or no longer what they were.
        """
        kind, frames = self._parse(data)
        if kind not in self._opened:
            self._opened[kind] = self._open(kind)
        meshes, size = self._opened[kind], 12 * len(self._chosen)
        fitting = frames[: max(1, MAX_STREAM_BYTES // size)]
        parts = (self._encode(meshes.read(frame)) for frame in fitting)
        # What is wrong with the files is said before anything is sent.
        first = next(parts)
        return Stream(size * len(fitting), _chain(first, parts))

    def _parse(self, data: bytes) -> tuple[str, range]:
        document = parse_json(data, BEFORE_FORMAT)
        if not isinstance(document, dict) or document.keys() != {"kind", "first", "count"}:
            raise FormatError(
                f"is {format_value(document)}, expected an object with `kind`, `first` and `count`"
            )
        kinds = list_before(self._shown)
        if document["kind"] not in kinds:
            raise FormatError(
                f"kind: is {format_value(document['kind'])}, expected {' or '.join(kinds)}"
            )
        most = {"first": (0, self._count - 1), "count": (1, MAX_ASKED_FRAMES)}
        for name, (low, high) in most.items():
            value = document[name]
            if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
                raise FormatError(
                    f"{name}: is {format_value(value)}, expected a whole number from {low} to "
                    f"{high}"
                )
        first = document["first"]
        return document["kind"], range(first, min(first + document["count"], self._count))

    def _open(self, kind: str) -> "_Meshes":
        shown = self._shown
        chain = [shown]
        while isinstance(chain[-1], Edit):
            if kind == "unedited" and len(chain) > 1:
                break
            edited = find_edited(chain[-1])
            if edited is None:
                raise FileAccessError(
                    f"{chain[-1].edited_from}, which {chain[-1].path.name} was made from, is not "
                    "beside it, or has changed; put it there"
                )
            chain.append(edited)
        source = chain[-1]
        binding = read_binding(source)
        if binding is None or len(binding.rest.vertices) != len(shown.rest.vertices):
            raise FileAccessError(f"{source.path.name}: has no weights; extract it again with them")
        reconstruction = Reconstruction(binding, CageFrames.from_result(source, binding))
        if kind == "unedited" or not isinstance(source, Result):
            return _Meshes(source, reconstruction, None)
        found = find_input(source, reconstruction)
        if found is None:
            name = (source.sources.get("frames") or {"name": "no file is named"})["name"]
            raise FileAccessError(
                f"the input ({name}) is not beside {source.path.name} nor one folder below, or has "
                "changed; put it there, or run cageik view in its folder"
            )
        return _Meshes(source, reconstruction, found)

    def _encode(self, mesh: Floats | None) -> bytes:
        if mesh is None:
            return np.full((len(self._chosen), 3), np.nan, "<f4").tobytes()
        placed = (mesh[self._chosen] - self._origin) / self._diagonal
        return np.ascontiguousarray(placed, "<f4").tobytes()


def _chain(first: bytes, others: Iterator[bytes]) -> Iterator[bytes]:
    yield first
    yield from islice(others, MAX_ASKED_FRAMES)


class _Meshes:
    """The meshes of a result, or of its input, by the numbers of frames.

    Vertices that are missing in an input are where the cage puts them.
    """

    def __init__(
        self, source: StoredAnimation, reconstruction: Reconstruction, inputs: InputFrames | None
    ) -> None:
        self._source, self._mark = source, mark_file(source.path)
        self._reconstruction, self._inputs = reconstruction, inputs
        known = reconstruction.cages.known.tolist()
        self._places = {frame: place for place, frame in enumerate(known)}
        skipped = set(source.skipped) if inputs is not None else set()
        self._places = {frame: k for frame, k in self._places.items() if frame not in skipped}

    def read(self, frame: int) -> Floats | None:
        """Return the mesh of a frame, (m, 3); None if it was skipped.

        Raises
        ------
        FileAccessError
            When a file has changed.
        """
        if mark_file(self._source.path) != self._mark:
            raise FileAccessError(
                f"{self._source.path}: has changed since the page was opened; start cageik view "
                "again"
            )
        place = self._places.get(frame)
        if place is None:
            return None
        if self._inputs is None:
            return self._reconstruction.read_frame(place)
        mesh = self._inputs.read_frame(place)
        if self._inputs.describe_sources() != [self._source.sources["frames"]]:
            raise FileAccessError(
                f"{self._source.sources['frames']['name']}: has changed since the page was opened; "
                "start cageik view again"
            )
        is_known = np.isfinite(mesh)
        if is_known.all():
            return mesh
        return np.where(is_known, mesh, self._reconstruction.read_frame(place))
