"""The settings of a bind and of an extraction. This module imports no numerics."""

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import ClipSettings, RestFrame, SceneHints
from cageik_cli.inputs.settings import (
    BUILD_OPTIONS,
    CLIP,
    CommandSettings,
    WeightSettings,
    declare_given_in,
    declare_memory,
    declare_overwrite,
    declare_rest,
    declare_rest_frame,
    declare_vertex_weights,
)
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import say
from cageik_cli.util.settings import (
    HelpGroup,
    declare_group,
    declare_setting,
    describe_settings,
    repeat_setting,
)


@dataclass(frozen=True, slots=True)
class ExtractSettings(CommandSettings):
    """What to extract, from what, to where.

    Attributes
    ----------
    binding : Path, optional
        A binding file of this rest pose, and of `cage` if that is given; `bind` is then ignored.
    rest_frame : int or str
        Which frame then: its index, or as text its number; or "auto", the one in which the
        least of the surface touches. An index counts in the whole clip if a cage or a binding is
        given, else among the frames that are taken; so the first is the default.
    fit : FitSettings or bool, optional
        Fit the weights to the clip, or do not; by default as `choose_fit` says.
    """

    frames: tuple[str, ...] = declare_setting(MISSING, "", option="FRAMES", role="read as a clip")
    cage: Path | None = declare_setting(
        MISSING,
        "The cage around the rest pose.",
        unset="one is built, as by cageik cage",
        role="read",
    )
    build: BuildSettings = declare_group(BuildSettings(), BUILD_OPTIONS, kw_only=True)
    output: Path = declare_setting(
        MISSING,
        "The result file.",
        option="-o/--output",
        typed="cages.h5",
        role="written",
        is_per_clip=False,
    )
    binding: Path | None = declare_setting(
        None,
        "Take the weights and the cage from this file of cageik bind.",
        role="read",
        group=HelpGroup.SOLVE,
    )
    cache: Path | None = None
    rest: Path | None = declare_rest()
    rest_frame: RestFrame = declare_rest_frame(0)
    bind: BindSettings = declare_group(BindSettings())
    solve: SolveSettings = declare_group(SolveSettings())
    fit: FitSettings | bool | None = None
    vertex_weights: Path | str | None = declare_vertex_weights()
    capture: CaptureSettings = declare_group(CaptureSettings())
    scene: SceneHints = declare_group(SceneHints())
    given_in: SceneHints = declare_given_in("--rest and --cage", "the clip")
    clip: ClipSettings = declare_group(ClipSettings(), CLIP | {"missing": {}})
    on_bad_frame: str = declare_setting(
        "stop",
        "If a frame cannot be read: stop, or leave a gap and report it.",
        choices=("stop", "skip"),
        group=HelpGroup.CAPTURED,
    )
    cage_output: Path | None = declare_setting(
        None,
        "Write the cage that is built to this .obj file.",
        option="--cage-out",
        role="written",
        group=HelpGroup.WRITTEN,
        is_per_clip=False,
    )
    keep_weights: bool = declare_setting(
        True,
        "Do not store the weights in the result (smaller file).",
        option="--no-weights",
        is_off=True,
        group=HelpGroup.WRITTEN,
    )
    resume: bool = declare_setting(
        False,
        "Continue an interrupted run from its checkpoint; start if there is none.",
        group=HelpGroup.RUNNING,
        is_per_clip=False,
    )
    overwrite: bool = declare_overwrite()
    memory: int = declare_memory()
    jobs: int = 1

    def __post_init__(self) -> None:
        CommandSettings.__post_init__(self)
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
                f"{self.binding}: "
                + say(
                    "brings its weights, which `fit=` would replace; leave out one of them, "
                    "or fit the binding by cageik bind `fit=`"
                )
            )
        if self.clip.missing:
            raise SettingError(
                say(
                    "`fit=` needs frames without missing vertices; fit a clean clip of the "
                    "same model by cageik bind `fit=`, and extract by `binding=`; or leave "
                    "out `missing=True`"
                )
            )
        if not self.keep_weights and self.fit.rank is None:
            raise SettingError(
                say(
                    "fitted weights cannot be computed again; extract with them "
                    "(`keep_weights=True`), or store few numbers by `fit_rank=`"
                )
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
        return {
            **describe_settings(self.solve),
            **describe_settings(known or self.bind),
            "rest_frame": rest_index,
            "vertex_weights": weights if isinstance(weights, str) else weights is not None,
            **(describe_settings(self.build) if self.builds_cage else {}),
            **({} if fit is None else describe_settings(fit)),
            **({"given_in": self.given_in.option_text} if self.given_in.option_text else {}),
            **describe_settings(self.capture),
            **describe_settings(self.clip),
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


@dataclass(frozen=True, slots=True)
class BindRunSettings(CommandSettings):
    """What to bind to what, and where to write it."""

    cage: Path = declare_setting(MISSING, "The cage around the rest pose.", role="read")
    rest: Path = declare_setting(MISSING, "Mesh of the rest pose.", role="read")
    output: Path = declare_setting(
        MISSING,
        "The binding file.",
        option="-o/--output",
        typed="binding.h5",
        role="written",
    )
    weights: WeightSettings = declare_group(WeightSettings())
    clips: tuple[str, ...] = declare_setting(
        (),
        "Fit the weights to this clip: a folder, a glob or a file; may be repeated.",
        option="--fit",
        metavar="CLIP",
        role="read as a clip",
    )
    fit: FitSettings = declare_group(FitSettings())
    solve: SolveSettings = declare_group(SolveSettings())
    vertex_weights: Path | str | None = declare_vertex_weights()
    exclude: tuple[str, ...] = repeat_setting(ClipSettings, "exclude")
    fps: float | None = repeat_setting(ClipSettings, "fps")
    given_in: SceneHints = declare_given_in("--cage and --fit", "--rest")
    memory: int = declare_memory()
    overwrite: bool = declare_overwrite()
