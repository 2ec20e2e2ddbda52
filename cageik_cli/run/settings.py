"""The settings of commands: what they read and write, and all that an extraction is told."""

from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Final

from cageik_cli.cages.settings import DEFAULT_SYMMETRY, BuildSettings
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.find_files import list_input_files, split_member
from cageik_cli.formats.settings import ClipSettings, RestFrame, SceneHints
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.arrays import DEFAULT_MEMORY
from cageik_cli.util.errors import SettingError

READ: Final = {"role": "read"}
"""Marks a field with a path that is read; a word in its place is no file."""

READ_CLIP: Final = {"role": "read as a clip"}
"""Marks a field with one or several arguments of `open_sequence`, whose files are read."""

WRITTEN: Final = {"role": "written"}
"""Marks a field with a path or an `Output` that is written."""


@dataclass(frozen=True, slots=True)
class CommandSettings:
    """Settings of a command; the marks of its fields say what is read and written.

    A field is marked by its metadata, as in `field(metadata=READ)`, and may be None.
    """

    def inputs(self) -> list[Path]:
        """Return the files that are read."""
        named = [
            path
            for value in self._list_marked(READ)
            for path in (value if isinstance(value, tuple) else (value,))
        ]
        files = [split_member(path)[0] for path in named if isinstance(path, Path)]
        for clip in self._list_marked(READ_CLIP):
            arguments = (clip,) if isinstance(clip, str) else clip
            files += [path for one in arguments for path in list_input_files([one])]
        return files

    def outputs(self) -> list[Path]:
        """Return the files and folders that are written."""
        files: list[Path] = []
        for output in self._list_marked(WRITTEN):
            files += [output] if isinstance(output, Path) else output.list_paths()
        return files

    def _list_marked(self, mark: dict[str, str]) -> list[Any]:
        """List the values of the fields with a mark that are given."""
        values = [getattr(self, one.name) for one in fields(self) if one.metadata == mark]
        return [value for value in values if value is not None]


@dataclass(frozen=True, slots=True)
class ExtractSettings(CommandSettings):
    """What to extract, from what, to where.

    Attributes
    ----------
    frames : tuple of str
        Files, folders and globs, or one file that holds a clip.
    cage : Path, optional
        Without it, and without a binding, a cage is built around the rest pose.
    binding : Path, optional
        A binding file of this rest pose, and of `cage` if that is given; `bind` is then ignored.
    rest : Path, optional
        The rest pose; a frame of the clip if absent.
    rest_frame : int or str
        Which frame then: its index, or as text its number; or "auto", the one in which the
        least of the surface touches. An index counts in the whole clip if a cage or a binding is
        given, else among the frames that are taken; so the first is the default.
    vertex_weights : Path or "area", optional
        A file with one number per vertex of the model, or an array (F, m) with one per frame and
        vertex; or each vertex counts by its area.
    resume : bool
        Continue an interrupted run of the same plan; start if there is none.
    on_bad_frame : str
        "stop", or "skip": leave a gap for a frame that cannot be read, and report it.
    scene : SceneHints
        Time and space, where they differ from what the files of the clip say.
    given_in : SceneHints
        Unit and up axis of `rest` and `cage`, see `CommonScene`.
    cage_output : Path, optional
        An OBJ file to which the cage that is built is written.
    fit : FitSettings or bool, optional
        Fit the weights to the clip, or do not; by default as `choose_fit` says.
    """

    frames: tuple[str, ...] = field(metadata=READ_CLIP)
    cage: Path | None = field(metadata=READ)
    output: Path = field(metadata=WRITTEN)
    binding: Path | None = field(default=None, metadata=READ)
    cache: Path | None = None
    rest: Path | None = field(default=None, metadata=READ)
    rest_frame: RestFrame = 0
    vertex_weights: Path | str | None = field(default=None, metadata=READ)
    bind: BindSettings = field(default_factory=BindSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    clip: ClipSettings = field(default_factory=ClipSettings)
    overwrite: bool = False
    resume: bool = False
    on_bad_frame: str = "stop"
    keep_weights: bool = True
    scene: SceneHints = field(default_factory=SceneHints)
    given_in: SceneHints = field(default_factory=SceneHints)
    memory: int = DEFAULT_MEMORY
    jobs: int = 1
    build: BuildSettings = field(default_factory=BuildSettings)
    cage_output: Path | None = field(default=None, metadata=WRITTEN)
    fit: FitSettings | bool | None = None
    capture: CaptureSettings = field(default_factory=CaptureSettings)

    def __post_init__(self) -> None:
        if self.cage_output is not None and not self.builds_cage:
            raise SettingError(
                f"{self.cage_output}: is for a cage that is built, but a cage is given; leave out "
                "one of them"
            )
        if self.fit is True:
            object.__setattr__(self, "fit", FitSettings())
        self._check_fit()

    def _check_fit(self) -> None:
        """Refuse a fit of weights that are given, or that would be lost."""
        if not isinstance(self.fit, FitSettings):
            return
        if self.binding is not None:
            raise SettingError(
                f"{self.binding}: brings its weights, which `fit=` would replace; leave out one of "
                "them, or fit the binding by cageik bind `fit=`"
            )
        if self.clip.missing:
            raise SettingError(
                "`fit=` needs frames without missing vertices; fit a clean clip of the same model "
                "by cageik bind `fit=`, and extract by `binding=`; or leave out `missing=True`"
            )
        if not self.keep_weights and self.fit.rank is None:
            raise SettingError(
                "fitted weights cannot be computed again; extract with them "
                "(`keep_weights=True`), or store few numbers by `fit_rank=`"
            )

    def record(
        self, known: BindSettings | None, fit: FitSettings | None, rest_index: int | None
    ) -> dict[str, Any]:
        """Return the settings on which the numbers depend, as a result file records them.

        Parameters
        ----------
        known : BindSettings, optional
            Of weights that come from a binding file: how they were computed counts.
        fit : FitSettings, optional
            How weights are fitted to the clip, or were fitted.
        rest_index : int, optional
            Which of the frames that are taken the rest pose is, if it is one of them.
        """
        weights = self.vertex_weights
        built: dict[str, Any] = {
            "cage_vertices": self.build.vertices,
            "cage_clearance": self.build.clearance,
        }
        if self.build.symmetric != DEFAULT_SYMMETRY:  # so that earlier results are those of it
            built["cage_symmetric"] = self.build.symmetric
        captured = asdict(self.capture) | {"missing": self.clip.missing}
        return {
            "alpha": self.solve.alpha,
            "beta": self.solve.beta,
            "align": self.solve.align,
            **asdict(known or self.bind),
            "rest_frame": rest_index,
            "vertex_weights": weights if isinstance(weights, str) else weights is not None,
            **(built if self.builds_cage else {}),
            **({} if fit is None else fit.describe()),
            **({"given_in": self.given_in.typed} if self.given_in.typed else {}),
            **{name: value for name, value in captured.items() if value},
            **({"exclude": list(self.clip.exclude)} if self.clip.exclude else {}),
        }

    @property
    def builds_cage(self) -> bool:
        """Whether a cage is built, as none is given."""
        return self.cage is None and self.binding is None

    @property
    def is_captured(self) -> bool:
        """Whether the frames are taken as noisy, or as those of which some data are missing."""
        return self.capture != CaptureSettings() or self.clip.missing

    @property
    def accepts_gaps(self) -> bool:
        """Whether a frame of too few data becomes a gap, which may be filled."""
        return self.skips_bad_frames or self.capture.fill_gaps

    @property
    def skips_bad_frames(self) -> bool:
        """Whether a frame that cannot be read becomes a gap."""
        return self.on_bad_frame == "skip"
