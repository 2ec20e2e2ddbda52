"""The settings of commands that write an animation. This module imports no numerics."""

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cageik_cli.formats.settings import ROOT_MOTIONS, ClipSettings, MorphSettings, SceneHints
from cageik_cli.inputs.settings import (
    CLIP,
    CommandSettings,
    declare_given_in,
    declare_memory,
    declare_to,
)
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.settings import HelpGroup, declare_group, declare_setting, repeat_setting

if TYPE_CHECKING:
    from cageik_cli.formats.write import Output


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
        "or by N that turn.",
        kind="joints",
        metavar="turn|translate|N",
        needs="influences",
        group=HelpGroup.WRITTEN,
    )
    morphs: MorphSettings = declare_group(MorphSettings(has_normals=True))
    memory: int = declare_memory()
    jobs: int = 1
    compares: bool = False


@dataclass(frozen=True, slots=True)
class ExportSettings(CommandSettings):
    """Which cages to write, where and how.

    Attributes
    ----------
    compares : bool
        Note the error of other numbers of influences, too.
    morphs : MorphSettings
        How morph targets follow the cages, in a format that has them. The tolerance is that of the
        keys of a skeleton, too.
    """

    result: Path = declare_setting(MISSING, "", option="RESULT", role="read")
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
        unset="the weights of the result",
        minimum=1,
        needs="skeleton",
    )
    joints: str | int = declare_setting(
        "turn",
        "Joints that turn, which programs shade rightly, or that only translate: one per cage "
        "vertex. Or N that turn, into which those are merged; with 4 influences if none are given.",
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
    morphs: MorphSettings = declare_group(MorphSettings(), {"count": {}, "tolerance": {}})
    compares: bool = False

    def outputs(self) -> list[Path]:
        """Return what is written; one file of a format of frames is that of the rest cage."""
        return [self.output.path] if self.is_rest_cage else CommandSettings.outputs(self)

    @property
    def is_rest_cage(self) -> bool:
        """Whether one file of a format of one mesh per file is named: it holds the rest cage."""
        from cageik_cli.formats.write import frame_formats, names_parts

        output = self.output
        is_frame = output.path.suffix.lower()[1:] in frame_formats() and output.frame_names is None
        return is_frame and not names_parts(output.path)
