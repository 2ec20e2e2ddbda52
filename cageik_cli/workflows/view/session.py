"""The model or the result of a page, and the edits that are applied to it."""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.coordinates.binding import Binding
from cageik_cli.coordinates.settings import BindSettings
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.find_files import split_member
from cageik_cli.formats.settings import SceneHints
from cageik_cli.formats.write import check_mesh_output, write_mesh
from cageik_cli.posing.edits import PosingSettings
from cageik_cli.posing.handles.model import Handle, Handles, PosedSurface
from cageik_cli.posing.handles.placement import place_handles
from cageik_cli.posing.handles.reader import parse_handles, read_handles
from cageik_cli.posing.summary import PoseResult
from cageik_cli.report.player.clip import UNNAMED_CAGE, PlayerClip, make_single_pose
from cageik_cli.store.result import Result
from cageik_cli.util.errors import (
    FileAccessError,
    HandlesError,
    OutputError,
    SettingError,
    error_context,
)
from cageik_cli.util.outputs import check_no_overlap, check_writable, write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.bind import WeightSettings
from cageik_cli.workflows.caged_model import CagedModel
from cageik_cli.workflows.edit import EditSettings, edit
from cageik_cli.workflows.mesh_source import name_source
from cageik_cli.workflows.model_file import load_surface
from cageik_cli.workflows.pose import check_target_kind, pose_model
from cageik_cli.workflows.settings import READ, WRITTEN, CommandSettings
from cageik_cli.workflows.view.show import load_clip

Mark = tuple[int, ...]
"""What changes when a file is written or replaced."""


def mark_file(path: Path) -> Mark | None:
    """Return the mark of a file; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


class WatchedInput:
    """An input that has to stay as it was when it was read."""

    def __init__(self, path: Path) -> None:
        self._path, self._mark = path, mark_file(path)

    def check(self) -> None:
        """Refuse the file if it has changed."""
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

    def record(self, path: Path) -> None:
        """Take a file as one that this run has just written."""
        self._marks[path] = mark_file(path)


@dataclass(frozen=True, slots=True)
class ViewSettings(CommandSettings):
    """What is viewed, and where the edits of the page go.

    Attributes
    ----------
    target : Path
        A result, a binding file, or a rest model.
    cage : Path, optional
        The cage of a rest model; one is built if there is none, and no binding.
    given_in : SceneHints
        Unit and up axis of the cage, in place of what its file states.
    binding : Path, optional
        The binding file of a rest model.
    handles : Path, optional
        A handles file that the page begins with.
    output : Path, optional
        The edited result or posed model; without it nothing is written.
    cage_output : Path, optional
        The posed cage of a model.
    handles_output : Path, optional
        The handles that were applied.
    overwrite : bool
        Whether files that exist before the first edit may be replaced.
    exclude : tuple of str
        Patterns of parts of a rest model that are left out.
    """

    target: Path = field(metadata=READ)
    cage: Path | None = field(default=None, metadata=READ)
    binding: Path | None = field(default=None, metadata=READ)
    handles: Path | None = field(default=None, metadata=READ)
    output: Path | None = field(default=None, metadata=WRITTEN)
    cage_output: Path | None = field(default=None, metadata=WRITTEN)
    handles_output: Path | None = field(default=None, metadata=WRITTEN)
    build: BuildSettings = field(default_factory=BuildSettings)
    weights: WeightSettings = field(default_factory=WeightSettings)
    overwrite: bool = False
    given_in: SceneHints = field(default_factory=SceneHints)
    exclude: tuple[str, ...] = ()

    def inputs(self) -> list[Path]:
        """Return the files that are read, but handles that are saved where they were."""
        is_saved = self.overwrite and self.handles == self.handles_output
        saved = self.handles if is_saved else None
        return [path for path in CommandSettings.inputs(self) if path != saved]


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
        The JSON, in ASCII, of the handles that the page begins with; "" for none.
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

    def begin_with(self, handles: Handles) -> None:
        """Let the page begin with handles."""
        check_places(handles, self.clip)
        self.first_handles = json.dumps(json.loads(handles.data))

    def parse(self, data: bytes, rigidity: int) -> Callable[[ProgressListener], PoseResult]:
        """Return the edit of a handles file that was sent, with rounds of rigid rotations."""
        path = self.settings.handles_output or Path("handles of the page")
        handles = parse_handles(path, data)
        return partial(self._apply, handles, PosingSettings(rigidity=rigidity))

    def _apply(
        self, handles: Handles, posing: PosingSettings, progress: ProgressListener
    ) -> PoseResult:
        """Apply handles and write the outputs; the handles are written last."""
        if self.settings.output is None:
            raise SettingError("there is no file to write; start cageik view again with an output")
        for path in self.settings.outputs():
            check_writable(path, self._own.may_replace(path))
        result = self._solve(handles, posing, self.settings.output, progress)
        if self.settings.handles_output is not None:
            path = self.settings.handles_output
            write_bytes(path, handles.data, self._own.may_replace(path))
            self._own.record(path)
        return result

    @abstractmethod
    def _solve(
        self, handles: Handles, posing: PosingSettings, output: Path, progress: ProgressListener
    ) -> PoseResult:
        """Solve, and write all but the handles."""


class _ResultSession(ViewSession):
    """The animation of a result; edits are results."""

    def __init__(self, settings: ViewSettings, result: Result, watched: WatchedInput) -> None:
        super().__init__(settings, load_clip(result), result.edited_from)
        self._watched = watched

    def _solve(
        self, handles: Handles, posing: PosingSettings, output: Path, progress: ProgressListener
    ) -> PoseResult:
        self._watched.check()
        may_replace = self._own.may_replace(output)
        settings = EditSettings(self.settings.target, handles.path, output, posing, may_replace)
        result = edit(settings, progress, handles)
        self._own.record(output)
        return result


class _ModelSession(ViewSession):
    """A model in its cage; edits are poses of it."""

    def __init__(self, settings: ViewSettings, clip: PlayerClip, binding: Binding) -> None:
        super().__init__(settings, clip)
        self._binding = binding

    def _solve(
        self, handles: Handles, posing: PosingSettings, output: Path, progress: ProgressListener
    ) -> PoseResult:
        with progress.stage("pose"):
            posed = pose_model(self._binding, handles, posing, progress)
        with progress.stage("write"):
            rest, cage = self._binding.rest, self._binding.cage
            write_mesh(output, rest, posed.snapshot.after, self._own.may_replace(output))
            self._own.record(output)
            path = self.settings.cage_output
            if path is not None:
                write_mesh(path, cage, posed.snapshot.cage_after, self._own.may_replace(path))
                self._own.record(path)
        return posed


def open_session(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    """Read what is viewed; the handles and the outputs are checked before any work."""
    check_no_overlap(settings.outputs(), settings.inputs())
    handles = None if settings.handles is None else read_first_handles(settings.handles)
    session = _open_target(settings, progress)
    if handles is not None:
        session.begin_with(handles)
    return session


def _open_target(settings: ViewSettings, progress: ProgressListener) -> ViewSession:
    """Open a result, a binding, or a model with a cage that is given or built."""
    check_target_kind(settings.target, "to view an animation")
    watched = WatchedInput(split_member(settings.target)[0])
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
    binding = target.bind(settings.weights, progress)
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
    path = settings.handles_output
    if path is None:
        return
    if path.suffix.lower() != ".json":
        raise OutputError(f"{path}: handles are written as .json; name a .json file")
    check_writable(path, settings.overwrite)


def _list_target_words(settings: ViewSettings, target: CagedModel) -> list[str]:
    """List what `cageik pose` is told to pose: a model in its cage, or a binding file."""
    if target.stored is not None:
        return [(settings.binding or settings.target).name]
    cage = UNNAMED_CAGE if settings.cage is None else name_source(settings.cage)
    words = [name_source(settings.target), "--cage", cage]
    usual = BindSettings()
    for name in ("coordinates", "accuracy", "outside"):
        if (value := getattr(settings.weights.bind, name)) != getattr(usual, name):
            words += [f"--{name}", value]
    return words


def read_first_handles(path: Path) -> Handles:
    """Read handles that a page can show, if they fit its model."""
    handles = read_handles(path)
    with error_context(path):
        for handle_set in handles.sets:
            for handle in handle_set.handles:
                _check_shown(handle)
    return handles


def check_places(handles: Handles, clip: PlayerClip) -> None:
    """Refuse handles that are at no vertex or face of a model, or at no frame of its clip."""
    rest = clip.binding.rest
    surface = PosedSurface(rest, lambda _: rest.vertices, clip.timeline)
    for handle_set in handles.sets:
        with error_context(handles.path):
            place_handles(handle_set, surface, allow_conflicts=True)


def _check_shown(handle: Handle) -> None:
    """Refuse what the page has no means to show."""
    is_on_screen = handle.motion.camera is not None
    if is_on_screen or handle.place.kind in ("position", "screen.source"):
        raise HandlesError(
            f"handle {handle.name!r}: has a position or a screen, which the page does not show; "
            "pose it with cageik pose, or give a vertex or a face, and an offset or a target"
        )
    if handle.radius is not None:
        raise HandlesError(
            f"handle {handle.name!r}: has a radius, which the page does not show; pose it with "
            "cageik pose, or remove the radius"
        )
