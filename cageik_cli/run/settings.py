"""The settings of all commands that read and write files. This module imports no numerics."""

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import (
    ROOT_MOTIONS,
    TEXTURES,
    ClipSettings,
    MorphSettings,
    RestFrame,
    SceneHints,
)
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
    declare_saved,
    declare_to,
    declare_vertex_weights,
)
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.solve.settings import LEAST_SQUARES, SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.errors import SettingError
from cageik_cli.util.messages import Hint, Text, say
from cageik_cli.util.settings import (
    HelpGroup,
    declare_group,
    declare_setting,
    describe_settings,
    repeat_setting,
)

if TYPE_CHECKING:
    from cageik_cli.formats.write import Output


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
        if self.is_captured:
            self.check_norm()

    def check_norm(self) -> None:
        """Refuse a norm above that of least squares: for data that may be noisy or missing."""
        if self.solve.lowers_deviations:
            raise SettingError(
                f"norm is {self.solve.norm:g}, but the data may be noisy or missing, and a norm "
                f"above {LEAST_SQUARES:g} follows outliers; " + say("leave out `norm=`")
            )

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


@dataclass(frozen=True, slots=True)
class CageSettings(CommandSettings):
    """The model to build a cage around, and the file to write it to.

    Attributes
    ----------
    rest_frame : int or str, optional
        Which frame then: its index, or as text its number; or "auto", the one in which the
        least of the surface touches; the first if absent.
    """

    model: str = declare_setting(
        MISSING, "", option="MODEL", is_required=False, role="read as a clip"
    )
    output: Path = declare_setting(
        MISSING, "The cage, an .obj file.", option="-o/--output", role="written"
    )
    build: BuildSettings = declare_group(BuildSettings())
    rest: Path | None = declare_rest()
    rest_frame: RestFrame | None = declare_rest_frame(None)
    animation: tuple[str, ...] = declare_setting(
        (),
        "Choose the cage with the smallest error on these frames; may be repeated.",
        option="--for",
        metavar="FRAMES",
        role="read as a clip",
    )
    clip: ClipSettings = declare_group(ClipSettings(gaps="close"), CLIP | {"fps": {}})
    given_in: SceneHints = declare_given_in("--repair, --for, and --rest of a clip", "the model")
    overwrite: bool = declare_overwrite()
    jobs: int = 1


@dataclass(frozen=True, slots=True)
class RepairCageSettings(CommandSettings):
    """Which cage to repair, for which model, and where to write it."""

    cage: Path = declare_setting(
        MISSING,
        "Make this cage fit for the model instead, with as little change as possible.",
        option="--repair",
        metavar="CAGE",
        is_required=False,
        role="read",
    )
    model: Path = repeat_setting(CageSettings, "model", role="read")
    output: Path = repeat_setting(CageSettings, "output")
    given_in: SceneHints = repeat_setting(CageSettings, "given_in")
    overwrite: bool = declare_overwrite()


@dataclass(frozen=True, slots=True)
class CheckSettings(CommandSettings):
    """What to check.

    Attributes
    ----------
    rest_frame : int or str
        Which frame then: its index, or as text its number; or "auto", the one in which the
        least of the surface touches.
    """

    cage: Path = declare_setting(
        MISSING, "The cage to diagnose.  [required]", is_required=False, role="read"
    )
    frames: tuple[str, ...] = declare_setting((), "", option="FRAMES", role="read as a clip")
    rest: Path | None = declare_rest()
    rest_frame: RestFrame = declare_rest_frame(
        0, needs="frames", needs_message="{} needs {}; name them, or leave it out"
    )
    clip: ClipSettings = declare_group(ClipSettings(gaps="close"), CLIP | {"fps": {}})
    given_in: SceneHints = declare_given_in(
        "--cage and --rest", "the clip, or of --rest without one"
    )
    jobs: int = 1


@dataclass(frozen=True, slots=True)
class DeformSettings(CommandSettings):
    """Which mesh to deform by which cages, and where to write it.

    Attributes
    ----------
    clip : ClipSettings
        How it is read. Patterns to exclude that match parts of `mesh` leave out those instead.
    compares : bool
        Note the error of other numbers of influences, too.
    """

    source: Path = declare_setting(MISSING, "", option="RESULT", role="read")
    output: "Output" = declare_setting(MISSING, "", role="written")
    mesh: tuple[Path, ...] = declare_setting(
        (),
        "Another mesh in the rest cage, or points or Gaussian splats (.ply); meshes may be "
        "repeated, and are parts of what is written.",
        unset="the rest model",
        role="read",
    )
    cages: str | None = declare_setting(
        None,
        "Cages from elsewhere, such as edited ones: a folder, a quoted glob, or one file.",
        unset="those of the result",
        role="read as a clip",
    )
    clip: ClipSettings = declare_group(ClipSettings(), CLIP)
    scene: SceneHints = declare_group(SceneHints())
    to: SceneHints = declare_to()
    given_in: SceneHints = declare_given_in("--mesh and --cages", "RESULT")
    coordinates: str | None = repeat_setting(
        BindSettings, "coordinates", None, unset="that of the result"
    )
    accuracy: str | None = repeat_setting(
        BindSettings, "accuracy", None, unset="that of the result"
    )
    outside: str | None = repeat_setting(BindSettings, "outside", None, unset="that of the result")
    cache: Path | None = None
    influences: int | None = declare_setting(
        None,
        "Fit the weights again to the motion of the mesh, with at most this number of cage "
        "vertices per vertex, as export --skeleton does.",
        unset="the weights of the mesh",
        minimum=1,
        group=HelpGroup.WRITTEN,
    )
    joints: str | int = declare_setting(
        "turn",
        "With --influences: move the mesh by joints that turn, by joints that only translate, "
        "or by as many that turn as export --skeleton --joints N writes.",
        kind="joints",
        metavar="turn|translate|N",
        needs="influences",
        group=HelpGroup.WRITTEN,
    )
    morphs: MorphSettings = declare_group(MorphSettings(has_normals=True))
    texture: str = declare_setting(
        "png",
        "Format of the textures of a folder OUT.vat: 16 bits of .png, or 32 of .exr, for Godot "
        "and web pages.",
        choices=TEXTURES,
        group=HelpGroup.WRITTEN,
    )
    memory: int = declare_memory()
    jobs: int = 1
    compares: bool = False

    def __post_init__(self) -> None:
        CommandSettings.__post_init__(self)
        if self.cages is None:
            self._check_no_clip()
        words = say("`morphs=`, `tolerance=` and `has_normals=`")
        _check_morphs(words, self.morphs != MorphSettings(has_normals=True), self.output)
        if self.texture != "png" and self.output.path.suffix.lower() != ".vat":
            raise SettingError(
                say("`texture=`")
                + " applies to a folder of textures, and the output is "
                + f"{self.output.path}; leave it out, or write .vat"
            )

    def _check_no_clip(self) -> None:
        """Refuse settings of a clip where none is read."""
        clip, usual = self.clip, ClipSettings()
        given = {
            Hint("selection"): clip.selection != usual.selection,
            Hint("layout"): clip.layout is not None,
            Hint("allow_gaps", True): clip.gaps == "keep",
            Hint("close_gaps", True): clip.gaps == "close",
        }
        for hint in (hint for hint, is_given in given.items() if is_given):
            message = " is for the clip of `cages=`; leave it out, or give `cages=`"
            raise SettingError(hint + say(message))
        if clip.exclude and not self.mesh:
            message = " is for `mesh=` and `cages=`; leave it out, or give one of them"
            raise SettingError(Hint("exclude") + say(message))


@dataclass(frozen=True, slots=True)
class ExportSettings(CommandSettings):
    """Which cages to write, where and how.

    Attributes
    ----------
    results : tuple of Path
        Several are the animations of one skeleton.
    compares : bool
        Note the error of other numbers of influences, too.
    morphs : MorphSettings
        How morph targets follow the cages, in a format that has them. The tolerance is that of the
        keys of a skeleton, too.
    """

    results: tuple[Path, ...] = declare_setting(MISSING, "", option="RESULTS", role="read")
    output: "Output" = declare_setting(MISSING, "", role="written")
    scene: SceneHints = declare_group(SceneHints())
    to: SceneHints = declare_to()
    skeleton: bool = declare_setting(
        False,
        "Write the rest pose with one joint per cage vertex and the weights as skin weights "
        "(.usd*, .glb).",
    )
    influences: int | None = declare_setting(
        None,
        "Fit the weights again, with at most this number of joints per vertex.",
        unset="the weights of the result, or 4 where the file cannot hold them",
        minimum=1,
        needs="skeleton",
    )
    joints: str | int = declare_setting(
        "turn",
        "Joints that turn, which programs shade rightly, or that only translate: one per cage "
        "vertex. Or N joints in the file, which turn; with 4 influences if none are given.",
        kind="joints",
        metavar="turn|translate|N",
        needs="skeleton",
    )
    root_motion: str = declare_setting(
        "keep",
        "With --skeleton: the root moves as the whole body, or along the ground, and turns "
        "about the vertical only.",
        choices=ROOT_MOTIONS,
        needs="skeleton",
    )
    quantize: bool = declare_setting(
        False,
        "With --skeleton: write integers of 8 and 16 bits where they are enough (.glb).",
        needs="skeleton",
    )
    with_model: bool = declare_setting(
        False,
        "Write the cage and the model that it moves in one file (.usd*, .abc, .glb, .obj). "
        "With --skeleton, the model is skinned.",
    )
    guide: bool = declare_setting(
        False,
        "Give the cage of --with-model the purpose `guide`, which programs hide and do not "
        "render (.usd*).",
        needs="with_model",
    )
    blender: bool = declare_setting(
        False,
        "Write the model, the cage and the weights into the folder OUT, with a script by which "
        "the cage moves the model live in Blender.",
        excludes=(
            (
                "skeleton",
                "`blender=True` and `skeleton=True` write different rigs; give one of them",
            ),
            (
                "with_model",
                "`blender=True` writes the cage and the model; leave out `with_model=True`",
            ),
        ),
    )
    morphs: MorphSettings = declare_group(MorphSettings(), {"morphs": {}, "tolerance": {}})
    cache: Path | None = None
    compares: bool = False

    def __post_init__(self) -> None:
        CommandSettings.__post_init__(self)
        if not self.results:
            raise SettingError(say("`results=`") + " names no result; name at least one")
        if self.morphs.morphs is not None and self.skeleton:
            raise SettingError(
                say(
                    "`morphs=` does not go with `skeleton=True`, which has none; give `influences=`"
                )
            )
        has_morphs = self.morphs != MorphSettings()
        _check_morphs(say("`morphs=` and `tolerance=`"), has_morphs, self.output)

    def outputs(self) -> list[Path]:
        """Return what is written; one file of a format of frames is that of the rest cage."""
        is_own = self.is_rest_cage or self.blender
        return [self.output.path] if is_own else CommandSettings.outputs(self)

    @property
    def is_rest_cage(self) -> bool:
        """Whether one file of a format of one mesh per file is named: it holds the rest cage."""
        from cageik_cli.formats.write import frame_formats, names_parts

        output = self.output
        is_frame = output.path.suffix.lower()[1:] in frame_formats() and output.frame_names is None
        return is_frame and not names_parts(output.path)


def _check_morphs(words: Text, is_given: bool, output: "Output") -> None:
    """Refuse settings of morph targets for another format; `words` name them."""
    if is_given and output.path.suffix.lower() != ".glb":
        raise SettingError(
            words
            + f" apply to .glb files, and the output is {output.path}; leave them out, or write "
            ".glb"
        )


@dataclass(frozen=True, slots=True)
class PoseSettings(CommandSettings):
    """Which model to pose, and where to write it.

    Attributes
    ----------
    handles, cage_edits : Path, optional
        One of them at least.
    """

    target: Path = declare_setting(MISSING, "", option="TARGET", role="read")
    handles: Path | None = declare_setting(
        MISSING, "", option="HANDLES", is_required=False, role="read"
    )
    output: Path = declare_setting(
        MISSING,
        "The posed model (.obj, .ply), or the edit (.h5).",
        option="-o/--output",
        role="written",
    )
    cage: Path | None = declare_setting(
        None,
        "The cage around TARGET, if that is a model; or a result or a binding (.h5) with the "
        "cage, whose fit is transferred to TARGET.",
        role="read",
    )
    given_in: SceneHints = declare_given_in("--cage", "TARGET")
    exclude: tuple[str, ...] = repeat_setting(ClipSettings, "exclude")
    cage_edits: Path | None = declare_setting(
        None,
        "A JSON file that says which cage vertices move where, before the handles act.",
        role="read",
    )
    cage_output: Path | None = declare_setting(
        None,
        "Also write the posed cage (.obj, .ply).",
        option="--cage-out",
        role="written",
    )
    posing: PosingSettings = declare_group(PosingSettings())
    weights: WeightSettings = declare_group(WeightSettings())
    overwrite: bool = declare_overwrite()


@dataclass(frozen=True, slots=True)
class EditSettings(CommandSettings):
    """Which animation to edit, by handles or cage edits or both, and where to write it."""

    result: Path = repeat_setting(PoseSettings, "target")
    handles: Path | None = repeat_setting(PoseSettings, "handles")
    output: Path = repeat_setting(PoseSettings, "output")
    posing: PosingSettings = declare_group(PosingSettings())
    overwrite: bool = declare_overwrite()
    cage_edits: Path | None = repeat_setting(PoseSettings, "cage_edits")


@dataclass(frozen=True, slots=True)
class ViewSettings(CommandSettings):
    """What is viewed, and where the edits of the page go.

    Attributes
    ----------
    overwrite : bool
        Whether files that exist before the first edit may be replaced.
    """

    target: Path = declare_setting(MISSING, "", option="TARGET", role="read")
    cage: Path | None = declare_setting(
        None,
        "The cage around a model, or a result or a binding with it (.h5).",
        unset="one is built",
        role="read",
    )
    given_in: SceneHints = declare_given_in("--cage", "TARGET")
    exclude: tuple[str, ...] = repeat_setting(ClipSettings, "exclude")
    binding: Path | None = declare_setting(None, "The binding file of a model.", role="read")
    build: BuildSettings = declare_group(BuildSettings(), BUILD_OPTIONS)
    edits_cage: bool = declare_setting(
        False,
        "Edit the cage at rest, also one that is not fit, or that of a result.",
        option="--edit-cage",
    )
    clip: str | None = declare_setting(
        None,
        "The clip of a result, for Extract again: a folder, a glob or a file.",
        unset="it is looked for beside the result",
        role="read as a clip",
        needs="edits_cage",
        needs_message="{} is for the cage of a result; add {}",
    )
    handles: Path | None = declare_setting(
        None, "A handles file that the page begins with.", role="read"
    )
    cage_edits: Path | None = declare_setting(
        None, "A cage edits file that the page begins with.", role="read"
    )
    output: Path | None = declare_setting(
        None,
        "The posed model (.obj, .ply), the edit (.h5) or the cage (.obj, .ply) that Apply writes.",
        option="-o/--output",
        role="written",
    )
    cage_output: Path | None = declare_saved(
        "Also write the posed cage (.obj, .ply).", "--cage-out"
    )
    handles_output: Path | None = declare_saved(
        "Also write the applied handles (.json).", "--handles-out"
    )
    cage_edits_output: Path | None = declare_saved(
        "Also write the applied cage edits (.json).", "--cage-edits-out"
    )
    weights: WeightSettings = declare_group(WeightSettings())
    overwrite: bool = declare_overwrite()

    def inputs(self) -> list[Path]:
        """Return the files that are read, but those that are saved where they were."""
        edits = (self.handles, self.handles_output), (self.cage_edits, self.cage_edits_output)
        saved = [path for path, output in edits if self.overwrite and path == output]
        return [path for path in CommandSettings.inputs(self) if path not in saved]
