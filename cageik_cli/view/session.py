"""The model or the result of a page, and the edits that it begins with, sends and applies.

What others do meanwhile to the files that the page reads and writes is noticed.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cageik_cli.editing.cage_edits import CageEditLayer, CageEdits, EditFiles, parse_cage_edits
from cageik_cli.editing.handles.model import Handles, PosedSurface
from cageik_cli.editing.handles.placement import place_handles
from cageik_cli.editing.handles.reader import MAX_HANDLES_BYTES, describe_location, parse_handles
from cageik_cli.editing.summary import PoseResult
from cageik_cli.formats.base.files import hash_file
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.find_files import Source
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.inputs.caged_model import CagedModel
from cageik_cli.inputs.source import load_surface
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.weights.binding import Binding
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.report.views.pose_text import format_pose_rows
from cageik_cli.report.vocabulary import EXTRACTION_VOCABULARY, VOCABULARIES, Vocabulary
from cageik_cli.run.edit import check_target_kind, edit, pose_model
from cageik_cli.run.settings import EditSettings, ViewSettings
from cageik_cli.store.result import StoredAnimation
from cageik_cli.util.errors import (
    FileAccessError,
    FormatError,
    HandlesError,
    OutputError,
    SettingError,
    add_remark,
    error_context,
    join_truncated,
)
from cageik_cli.util.files import Mark, mark_file
from cageik_cli.util.json_files import JsonFormat, Steps, format_value, parse_json
from cageik_cli.util.messages import Spelling, spell_keyword
from cageik_cli.util.outputs import check_no_overlap, check_writable, replace_only, write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import to_unicode
from cageik_cli.view.before import MAX_ASKED_BYTES, BeforeFrames, list_before
from cageik_cli.view.player.clip import (
    UNNAMED_CAGE,
    PlayerClip,
    make_single_pose,
    require_player_clip,
)
from cageik_cli.view.player.section import render_view_page
from cageik_cli.view.saved_names import NewFiles
from cageik_cli.view.server import MAX_RIGIDITY, MAX_SUBMITTED_BYTES, Edit, Rows, Stream


class PageSession(ABC):
    """What a page shows, and what is done with what it sends.

    Attributes
    ----------
    answers : dict of str to callable
        What else than an edit the page may send, and the answer to it; see `Site`.
    streams : dict of str to (int, callable)
        What else it may ask for; see `Site`.
    jobs : dict of str to callable
        What else the page may send that writes files; see `Site`.
    key : str
        A digest of the files that are viewed, by which the page knows them again.
    written : tuple of Path
        What the last edit wrote.
    """

    def __init__(self, settings: ViewSettings) -> None:
        self.settings = settings
        self.answers: dict[str, Callable[[bytes, Spelling], Any]] = {}
        self.streams: dict[str, tuple[int, Callable[[bytes], Stream]]] = {}
        self.jobs: dict[str, Callable[[bytes], Edit]] = {}
        self.key = _hash_inputs(settings)
        self.new_files: NewFiles | None = None
        self.written: tuple[Path, ...] = ()
        self._own = OwnOutputs(settings.overwrite)

    @property
    def can_apply(self) -> bool:
        """Whether an edit can be applied: there is a file to write."""
        return self.settings.output is not None

    @property
    def viewed(self) -> Path:
        """The file that is viewed."""
        return Source.parse(self.settings.target).file

    def offer_names(self, suffixes: Sequence[str]) -> None:
        """Let the page save to new files, unless an output was given."""
        if not self.can_apply:
            self.new_files = NewFiles(self.viewed, suffixes)
            self.jobs["save"] = self.parse_saved

    def describe(self) -> dict[str, Any]:
        """Return what the page has to know of the session: its key, and what it saves where."""
        saved, own = self.new_files, self.settings
        return {
            "key": self.key,
            "beside": to_unicode(self.viewed.name),
            "save": None if saved is None else saved.propose(),
            "keepsHandles": own.handles_output is not None,
            "keepsCageEdits": own.cage_edits_output is not None,
        }

    @abstractmethod
    def render_page(self, spelling: Spelling = spell_keyword) -> str:
        """Render the page; settings that texts name are written as `spelling` does."""

    @abstractmethod
    def parse(self, data: bytes, rigidity: int) -> Edit:
        """Return the edit that was sent, with rounds of rigid rotations."""

    @abstractmethod
    def parse_saved(self, data: bytes) -> Edit:
        """Return what writes an edit that was sent to a new file, whose name is sent with it."""

    def close(self) -> None:  # noqa: B027
        """End what runs beside the page."""

    def _get_output(self) -> Path:
        """Return the file that an edit writes."""
        if self.settings.output is None:
            raise SettingError("there is no file to write; start cageik view again with an output")
        return self.settings.output


def _hash_inputs(settings: ViewSettings) -> str:
    """Return a digest of the files that are viewed and of how: of their content, wherever they are.

    What is kept of a page that poses a model is not offered by one that edits its cage.
    """
    given = (settings.target, settings.cage, settings.binding)
    sources = [Source.parse(path) for path in given if path is not None]
    parts = [(hash_file(source.file).hex(), source.member) for source in sources]
    return hashlib.sha256(repr([parts, settings.edits_cage]).encode()).hexdigest()


class ViewSession(PageSession):
    """A model or a result that a page shows.

    Parameters
    ----------
    clip : PlayerClip
        What the page shows.
    words : Vocabulary
        Those for the kind of clip.

    Attributes
    ----------
    first_handles, first_cage_edits : str
        The JSON, in ASCII, of the handles and cage edits that the page begins with; "" for none.
    """

    def __init__(
        self, settings: ViewSettings, clip: PlayerClip, words: Vocabulary = EXTRACTION_VOCABULARY
    ) -> None:
        super().__init__(settings)
        self.clip, self.words = clip, words
        self.first_handles = self.first_cage_edits = ""

    def render_page(self, _spelling: Spelling = spell_keyword) -> str:
        """Render the page."""
        return render_view_page(
            self.clip,
            "apply" if self.can_apply else "",
            handles=self.first_handles,
            cage_edits=self.first_cage_edits,
            words=self.words,
            session=self.describe(),
        )

    def begin_with(self, files: EditFiles) -> None:
        """Let the page begin with handles or cage edits."""
        check_edit_fits(files, self.clip)
        if files.handles is not None:
            self.first_handles = json.dumps(json.loads(files.handles.data))
        if files.cage_edits is not None:
            self.first_cage_edits = json.dumps(json.loads(files.cage_edits.data))

    def parse(self, data: bytes, rigidity: int) -> Edit:
        """Return the edit that was sent, with rounds of rigid rotations.

        Parameters
        ----------
        data : bytes
            A JSON object of `handles` and `cageEdits`: each the content of such a file, or null.
        """
        own = self.settings
        files = parse_submitted(data, own.handles_output, own.cage_edits_output)
        self._get_output()
        return partial(self._apply, files, PosingSettings(rigidity=rigidity), own)

    def parse_saved(self, data: bytes) -> Edit:
        """Return what writes an edit that was sent to a new file.

        Parameters
        ----------
        data : bytes
            As of `parse`, with `name`, that of the file, and `rigidity`.
        """
        document = parse_object(data, [*SUBMITTED_FILES, "rigidity", "name"], SUBMITTED_FORMAT)
        rigidity, path = document.pop("rigidity"), check_new_name(self.new_files, document)
        if (
            not isinstance(rigidity, int)
            or isinstance(rigidity, bool)
            or not (0 <= rigidity <= MAX_RIGIDITY)
        ):
            raise FormatError(
                f"rigidity: is {format_value(rigidity)}, expected a whole number up to "
                f"{MAX_RIGIDITY}"
            )
        files = parse_files(split_files(document))
        outputs = ViewSettings(self.settings.target, output=path)
        return partial(self._apply, files, PosingSettings(rigidity=rigidity), outputs)

    def _apply(
        self,
        files: EditFiles,
        posing: PosingSettings,
        own: ViewSettings,
        progress: ProgressListener,
    ) -> Rows:
        """Apply an edit and write the outputs; the files of the edit are written last."""
        for path in own.outputs():
            check_writable(path, self._own.may_replace(path))
        with self._name_replaced(own.outputs()), self._own.guard():
            result = self._solve(files, posing, own, progress)
            written = [path for path in (own.output, own.cage_output) if path is not None]
            self._save(own.handles_output, files.handles, written)
            self._save(own.cage_edits_output, files.cage_edits, written)
        self.written = tuple(written)
        return format_pose_rows(result.summary)

    @contextmanager
    def _name_replaced(self, outputs: Sequence[Path]) -> Iterator[None]:
        """Let an error say which outputs are of this edit already, if others are not."""
        marks = {path: mark_file(path) for path in outputs}
        try:
            yield
        except BaseException as error:
            replaced = [path for path, mark in marks.items() if mark_file(path) != mark]
            others = [path for path in marks if path not in replaced]
            if replaced and others:
                done, left = (
                    f"{join_truncated(paths)} {'is' if len(paths) == 1 else 'are'}"
                    for paths in (replaced, others)
                )
                add_remark(error, f"{done} of this edit already, {left} not; apply it again")
            raise

    def _save(
        self, path: Path | None, file: Handles | CageEdits | None, written: list[Path]
    ) -> None:
        """Write a file of the edit; without one, what an earlier edit wrote there is removed."""
        if path is None:
            return
        if file is None:
            self._own.withdraw(path)
            return
        write_bytes(path, file.data, self._own.may_replace(path))
        self._own.record(path)
        written.append(path)

    @abstractmethod
    def _solve(
        self,
        files: EditFiles,
        posing: PosingSettings,
        own: ViewSettings,
        progress: ProgressListener,
    ) -> PoseResult:
        """Solve, and write the outputs of some settings, all but the files of the edit."""


SUBMITTED_FILES = {"handles": "handles", "cageEdits": "cage edits"}
"""The fields of a body, and what messages call them."""


def _describe_place(document: Any, steps: Steps) -> str:
    """Return the place of a value in words, within its file."""
    if not steps or not isinstance(document, dict) or steps[0] not in SUBMITTED_FILES:
        return describe_location(document, steps)
    name = str(steps[0])
    inner = describe_location(document[name], steps[1:])
    return f"{SUBMITTED_FILES[name]}: {inner}" if inner else SUBMITTED_FILES[name]


SUBMITTED_FORMAT = JsonFormat("handles and cage edits", MAX_SUBMITTED_BYTES, _describe_place)
"""What the JSON of a body should be."""


def check_edit_fits(files: EditFiles, clip: PlayerClip) -> None:
    """Refuse what is at no vertex or face of a model or its cage, or at no frame of its clip."""
    rest = clip.binding.rest
    surface = PosedSurface(rest, lambda _: rest.vertices, clip.timeline)
    if files.handles is not None:
        with error_context(files.handles.path):
            for handle_set in files.handles.sets:
                place_handles(handle_set, surface, allow_conflicts=True)
    if files.cage_edits is not None:
        with error_context(files.cage_edits.path):
            for edit in files.cage_edits.edits:
                CageEditLayer(edit, clip.binding.cage, clip.timeline)


def parse_submitted(data: bytes, handles: Path | None, cage_edits: Path | None) -> EditFiles:
    """Return the edit of a body; the paths are where its files will be saved, if anywhere.

    Raises
    ------
    FormatError, HandlesError
        When it is no JSON object of handles and cage edits; the message says where.
    """
    return parse_files(split_submitted(data), handles, cage_edits)


def parse_files(
    sent: dict[str, bytes | None], handles: Path | None = None, cage_edits: Path | None = None
) -> EditFiles:
    """Return the edit of the files that were sent; raises as `parse_submitted`."""
    found_handles = found_edits = None
    if (text := sent["handles"]) is not None:
        found_handles = parse_handles(handles or Path("handles of the page"), text)
    if (text := sent["cageEdits"]) is not None:
        found_edits = parse_cage_edits(cage_edits or Path("cage edits of the page"), text)
    return EditFiles(found_handles, found_edits)


def split_submitted(data: bytes) -> dict[str, bytes | None]:
    """Return the bytes of each file of a body, as a page saves it; None if there is none.

    Raises
    ------
    FormatError
        When it is not a JSON object of these fields, one of which is not null, or a file is larger
        than what is read.
    """
    return split_files(parse_object(data, list(SUBMITTED_FILES), SUBMITTED_FORMAT))


def parse_object(data: bytes, fields: Sequence[str], expected: JsonFormat) -> dict[str, Any]:
    """Return the object of a body that has these fields alone.

    Raises
    ------
    FormatError
    """
    document = parse_json(data, expected)
    if not isinstance(document, dict) or document.keys() != set(fields):
        listed = " and ".join(filter(None, [", ".join(fields[:-1]), *fields[-1:]])) or "nothing"
        raise FormatError(
            f"is {format_value(document)}, expected an object of {listed}; load the page again"
        )
    return document


def check_new_name(new_files: NewFiles | None, document: dict[str, Any]) -> Path:
    """Take the name out of what was sent, and return its file; raises as `NewFiles.check`."""
    assert new_files is not None
    return new_files.check(document.pop("name"))


def split_files(document: dict[str, Any]) -> dict[str, bytes | None]:
    """Return the bytes of each file that was sent; raises as `split_submitted`."""
    if all(content is None for content in document.values()):
        raise FormatError("has neither handles nor cage edits; add some")
    files = {}
    for name, content in document.items():
        files[name] = None if content is None else _write_file(content)
        if len(files[name] or b"") > MAX_HANDLES_BYTES:
            raise FormatError(
                f"{SUBMITTED_FILES[name]}: have more than {MAX_HANDLES_BYTES} bytes; keep fewer of "
                "them"
            )
    return files


def _write_file(content: Any) -> bytes:
    """Return the bytes of a file: indented, or as short as it was sent if it then is too large."""
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    data = text.encode(errors="surrogatepass")
    if len(data) > MAX_HANDLES_BYTES:
        text = json.dumps(content, separators=(",", ":"), ensure_ascii=False) + "\n"
        data = text.encode(errors="surrogatepass")
    return data


class WatchedInput:
    """An input that has to stay as it was when it was read."""

    def __init__(self, path: Path) -> None:
        self._path, self._mark = path, mark_file(path)

    def check(self) -> None:
        """Refuse the file if it has changed.

        Raises
        ------
        FileAccessError
        """
        if mark_file(self._path) != self._mark:
            raise FileAccessError(
                f"{self._path}: has changed since the page was opened; start cageik view again"
            )


class OwnOutputs:
    """Outputs that are written again and again: only what this run wrote is replaced.

    Parameters
    ----------
    may_replace : bool
        Whether other files may be replaced, too.
    """

    def __init__(self, may_replace: bool) -> None:
        self._may_replace = may_replace
        self._marks: dict[Path, Mark | None] = {}

    def may_replace(self, path: Path) -> bool:
        """Whether the file at `path` may be replaced: it is as this run wrote it, or any may."""
        return self._may_replace or (
            path in self._marks and mark_file(path) == self._marks[path] is not None
        )

    def guard(self) -> AbstractContextManager[None]:
        """Refuse, while the block runs, to replace what others write to these outputs meanwhile.

        What `may_replace` says is of the moment; an edit takes seconds before it writes.
        """
        return replace_only({} if self._may_replace else self._marks)

    def record(self, path: Path) -> None:
        """Take a file as one that this run has just written."""
        self._marks[path] = mark_file(path)

    def withdraw(self, path: Path) -> None:
        """Remove a file if it is as this run wrote it."""
        mark = self._marks.pop(path, None)
        if mark is not None and mark_file(path) == mark:
            path.unlink()


class _ResultSession(ViewSession):
    """The animation of a result or an edit; edits of it are written as edits."""

    def __init__(
        self, settings: ViewSettings, result: StoredAnimation, watched: WatchedInput
    ) -> None:
        clip = replace(require_player_clip(result, "a page"), before=list_before(result))
        super().__init__(settings, clip, VOCABULARIES[result.FORMAT])
        self.streams = {"before": (MAX_ASKED_BYTES, BeforeFrames(result, clip).answer)}
        self._watched = watched
        self.offer_names([".h5"])

    def _solve(
        self,
        files: EditFiles,
        posing: PosingSettings,
        own: ViewSettings,
        progress: ProgressListener,
    ) -> PoseResult:
        self._watched.check()
        assert own.output is not None
        output, may_replace = own.output, self._own.may_replace(own.output)
        settings = EditSettings(self.settings.target, None, output, posing, may_replace)
        result = edit(settings, progress, files)
        self._own.record(output)
        return result


class _ModelSession(ViewSession):
    """A model in its cage; edits are poses of it."""

    def __init__(self, settings: ViewSettings, clip: PlayerClip, binding: Binding) -> None:
        super().__init__(settings, clip)
        self._binding = binding
        self.offer_names([".obj", ".ply"])

    def _solve(
        self,
        files: EditFiles,
        posing: PosingSettings,
        own: ViewSettings,
        progress: ProgressListener,
    ) -> PoseResult:
        assert own.output is not None
        output = own.output
        with progress.stage("pose"):
            posed = pose_model(self._binding, files, posing, progress)
        with progress.stage("write"):
            rest, cage = self._binding.rest, self._binding.cage
            write_mesh(output, rest, posed.snapshot.after, self._own.may_replace(output))
            self._own.record(output)
            path = own.cage_output
            if path is not None:
                write_mesh(path, cage, posed.snapshot.cage_after, self._own.may_replace(path))
                self._own.record(path)
        return posed


def open_session(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    """Read what is viewed; the edit and the outputs are checked before any work."""
    check_no_overlap(settings.outputs(), settings.inputs())
    files = read_first_edit(settings.handles, settings.cage_edits)
    session = _open_target(settings, progress)
    session.begin_with(files)
    return session


def _open_target(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    """Open a result, a binding, or a model with a cage that is given or built."""
    check_target_kind(settings.target, "to view an animation")
    watched = WatchedInput(Source.parse(settings.target).file)
    with progress.stage("open"):
        target = CagedModel.open(
            settings.target,
            settings.cage,
            settings.binding,
            given_in=settings.given_in,
            load=partial(load_surface, exclude=settings.exclude),
        )
    _check_outputs(settings, is_result=target.result is not None)
    if target.result is not None:
        return _ResultSession(settings, target.result, watched)
    if target.cage is None and target.stored is None:
        target = target.build_cage(settings.build, settings.weights.cache, progress)
    binding = target.bind(settings.weights, progress).binding
    clip = make_single_pose(binding, _list_target_words(settings, target))
    return _ModelSession(settings, clip, binding)


def _check_outputs(settings: ViewSettings, *, is_result: bool) -> None:
    """Refuse outputs that cannot be written, or not hold what is edited."""
    if is_result and settings.output is not None:
        check_writable(settings.output, settings.overwrite)
        check_hdf5_suffix(settings.output)
    for path in () if is_result else (settings.output, settings.cage_output):
        if path is not None:
            check_mesh_output(path, settings.overwrite)
    for path, things in (
        (settings.handles_output, "handles"),
        (settings.cage_edits_output, "cage edits"),
    ):
        if path is None:
            continue
        if path.suffix.lower() != ".json":
            raise OutputError(f"{path}: {things} are written as .json; name a .json file")
        check_writable(path, settings.overwrite)


def _list_target_words(settings: ViewSettings, target: CagedModel) -> list[str]:
    """List what `cageik pose` is given to pose: a model in its cage, or a binding file."""
    if target.stored is not None:
        return [(settings.binding or settings.target).name]
    cage = UNNAMED_CAGE if settings.cage is None else Source.parse(settings.cage).name
    words = [Source.parse(settings.target).name, "--cage", cage]
    usual = BindSettings()
    for name in ("coordinates", "accuracy", "outside"):
        if (value := getattr(settings.weights.bind, name)) != getattr(usual, name):
            words += [f"--{name}", value]
    return words


def read_first_edit(handles: Path | None, cage_edits: Path | None) -> EditFiles:
    """Read handles and cage edits that a page can show, if they fit its model."""
    files = EditFiles.read(handles, cage_edits)
    for handle_set in files.handles.sets if files.handles else ():
        with error_context(handles or ""):
            for handle in handle_set.handles:
                is_on_screen = handle.motion.camera is not None
                if is_on_screen or handle.place.kind in ("position", "screen.source"):
                    raise HandlesError(
                        f"handle {handle.name!r}: has a position or a screen, which the page does "
                        "not show; pose it with cageik pose, or give a vertex or a face, and an "
                        "offset or a target"
                    )
    return files
