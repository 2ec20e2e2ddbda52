"""The model or the result of a page, and the edits that are applied to it."""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.hdf5 import HDF5_SUFFIXES, check_hdf5_suffix
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.posing.edits import PosingSettings
from cageik_cli.posing.handles.reader import parse_handles
from cageik_cli.posing.snapshot import PoseResult
from cageik_cli.report.player.clip import (
    UNNAMED_CAGE,
    PlayerClip,
    load_player_clip,
    make_single_pose,
)
from cageik_cli.store.binding_file import is_binding, read_binding
from cageik_cli.store.result import read_result
from cageik_cli.util.errors import OutputError, SettingError, error_context
from cageik_cli.util.outputs import check_no_overlap, check_writable, write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.bind import load_matching_binding
from cageik_cli.workflows.cached_cage import build_cached
from cageik_cli.workflows.edit import EditSettings, edit
from cageik_cli.workflows.pose import (
    NamedHandles,
    bind_model,
    check_target_kind,
    pose_model,
    report_layer_notes,
)
from cageik_cli.workflows.repair_hint import suggest_repair
from cageik_cli.workflows.view.first_handles import FirstHandles, read_first_handles
from cageik_cli.workflows.view.own_files import OwnOutputs, WatchedInput
from cageik_cli.workflows.view.settings import ViewSettings

HANDLES_NAME = Path("handles of the page")
"""What messages call handles that are not saved to a file."""


@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """Handles that are to be applied.

    Attributes
    ----------
    data : bytes
        The handles file, as it came.
    rigidity : int
        Rounds of rigid rotations.
    """

    data: bytes
    handles: NamedHandles
    rigidity: int


@dataclass(frozen=True, slots=True, eq=False)
class AppliedEdit:
    """The outcome of an edit.

    Attributes
    ----------
    written : tuple of Path
        The files that were written.
    """

    result: PoseResult
    written: tuple[Path, ...]


class ViewSession(ABC):
    """A model or a result that a page shows.

    Parameters
    ----------
    clip : PlayerClip
        What the page shows.
    edited_from : str, optional
        The result that the clip was edited from, if it was.

    Attributes
    ----------
    first_handles : str
        The JSON of the handles that the page begins with; "" for none.
    """

    def __init__(
        self, settings: ViewSettings, clip: PlayerClip, edited_from: str | None = None
    ) -> None:
        self.settings, self.clip, self.edited_from = settings, clip, edited_from
        self.first_handles = ""
        self._own = OwnOutputs(settings.overwrite)

    @property
    def can_apply(self) -> bool:
        """Whether handles can be applied: there is a file to write."""
        return self.settings.output is not None

    def begin_with(self, handles: FirstHandles) -> None:
        """Let the page begin with handles.

        Raises
        ------
        HandlesError
            When they do not fit the model or its clip.
        """
        handles.check_places(self.clip)
        self.first_handles = handles.text

    def parse(self, data: bytes, rigidity: int) -> Edit:
        """Return the edit of a handles file that was sent.

        Raises
        ------
        FormatError, HandlesError
            When it is not a handles file.
        """
        path = self.settings.handles_output or HANDLES_NAME
        digest = hashlib.sha256(data).hexdigest()
        return Edit(data, NamedHandles(path, parse_handles(data), digest), rigidity)

    def apply(self, edit: Edit, progress: ProgressListener) -> AppliedEdit:
        """Apply handles and write the outputs; the handles are written last.

        Raises
        ------
        InputError
            When the handles do not fit, or a file cannot be written or is someone else's.
        NumericalError
            When hard handles cannot all be met.
        """
        if self.settings.output is None:
            raise SettingError("there is no file to write; name one with -o")
        for path in self.settings.outputs():
            check_writable(path, self._own.may_replace(path))
        result = self._apply(edit, self.settings.output, progress)
        if self.settings.handles_output is not None:
            path = self.settings.handles_output
            write_bytes(path, edit.data, self._own.may_replace(path))
            self._own.record(path)
        return AppliedEdit(result, tuple(self.settings.outputs()))

    @abstractmethod
    def _apply(self, edit: Edit, output: Path, progress: ProgressListener) -> PoseResult:
        """Solve, and write all but the handles."""

    def _make_posing(self, edit: Edit) -> PosingSettings:
        return PosingSettings(rigidity=edit.rigidity)


class _ResultSession(ViewSession):
    """The animation of a result; edits are results."""

    def __init__(
        self,
        settings: ViewSettings,
        clip: PlayerClip,
        edited_from: str | None,
        watched: WatchedInput,
    ) -> None:
        super().__init__(settings, clip, edited_from)
        self._watched = watched

    def _apply(self, edit_: Edit, output: Path, progress: ProgressListener) -> PoseResult:
        self._watched.check()
        settings = EditSettings(
            self.settings.target,
            edit_.handles.path,
            output,
            self._make_posing(edit_),
            self._own.may_replace(output),
        )
        result = edit(settings, progress, edit_.handles)
        self._own.record(output)
        return result


class _ModelSession(ViewSession):
    """A model in its cage; edits are poses of it."""

    def __init__(self, settings: ViewSettings, clip: PlayerClip, binding: Binding) -> None:
        super().__init__(settings, clip)
        self._binding = binding

    def _apply(self, edit_: Edit, output: Path, progress: ProgressListener) -> PoseResult:
        with progress.stage("pose"):
            posed = pose_model(self._binding, edit_.handles, self._make_posing(edit_))
        report_layer_notes(posed.layers, edit_.handles.path, progress)
        with progress.stage("write"):
            rest, cage = self._binding.rest, self._binding.cage
            write_mesh(output, rest, posed.mesh, self._own.may_replace(output))
            self._own.record(output)
            path = self.settings.cage_output
            if path is not None:
                write_mesh(path, cage, posed.cage, self._own.may_replace(path))
                self._own.record(path)
        return posed.result


def open_session(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    """Read what is viewed; the handles and the outputs are checked before any work.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the weights cannot be trusted, or no cage can be built.
    """
    check_no_overlap(settings.outputs(), settings.inputs())
    handles = None if settings.handles is None else read_first_handles(settings.handles)
    session = _open_target(settings, progress)
    if handles is not None:
        session.begin_with(handles)
    return session


def _open_target(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    target = settings.target
    check_target_kind(target, "to view an animation")
    is_hdf5 = target.suffix.lower() in HDF5_SUFFIXES
    if is_hdf5 and not is_binding(target):
        return _open_result(settings, progress)
    for path in (settings.output, settings.cage_output):
        if path is not None:
            check_mesh_output(path, settings.overwrite)
    _check_handles_output(settings)
    binding = read_binding(target).binding if is_hdf5 else _load_model(settings, progress)
    clip = make_single_pose(binding, _list_target_words(settings))
    return _ModelSession(settings, clip, binding)


def _open_result(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    if settings.output is not None:
        check_writable(settings.output, settings.overwrite)
        check_hdf5_suffix(settings.output)
    _check_handles_output(settings)
    watched = WatchedInput(settings.target)
    with progress.stage("open"):
        result = read_result(settings.target)
        clip = load_player_clip(result)
    if clip is None:
        raise SettingError(
            f"{settings.target}: has no weights, which a view needs; extract it again without "
            "--no-weights"
        )
    return _ResultSession(settings, clip, result.edited_from, watched)


def _check_handles_output(settings: ViewSettings) -> None:
    path = settings.handles_output
    if path is None:
        return
    if path.suffix.lower() != ".json":
        raise OutputError(f"{path}: handles are written as .json; name a .json file")
    check_writable(path, settings.overwrite)


def _load_model(settings: ViewSettings, progress: ProgressListener) -> Binding:
    """Read a rest model, and its weights: of a binding file, or of a cage, given or built."""
    with progress.stage("open"):
        rest = load_mesh(settings.target)
        cage = None if settings.cage is None else load_mesh(settings.cage)
        if settings.binding is not None:
            return load_matching_binding(settings.binding, rest, cage).binding
    if cage is None:
        with progress.stage("cage"), error_context(settings.target):
            cage = build_cached(rest.mesh, settings.build, settings.weights.cache, progress)
    with (
        progress.stage("bind"),
        error_context(settings.cage or cage.source["name"]),
        suggest_repair(settings.cage, settings.target),
    ):
        return bind_model(rest, cage, settings.weights, progress)


def _list_target_words(settings: ViewSettings) -> list[str]:
    """List what `cageik pose` is told to pose: a model in its cage, or a binding file."""
    if settings.binding is not None:
        return [settings.binding.name]
    if settings.target.suffix.lower() in HDF5_SUFFIXES:
        return [settings.target.name]
    cage = UNNAMED_CAGE if settings.cage is None else settings.cage.name
    words = [settings.target.name, "--cage", cage]
    usual = BindSettings()
    for name in ("coordinates", "accuracy", "outside"):
        if (value := getattr(settings.weights.bind, name)) != getattr(usual, name):
            words += [f"--{name}", value]
    return words
