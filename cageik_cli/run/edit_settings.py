"""The settings of commands that pose a model or an animation. This module imports no numerics."""

from dataclasses import MISSING, dataclass
from pathlib import Path

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.formats.settings import ClipSettings, SceneHints
from cageik_cli.inputs.settings import (
    BUILD_OPTIONS,
    CommandSettings,
    WeightSettings,
    declare_given_in,
    declare_overwrite,
    declare_saved,
)
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.util.settings import declare_group, declare_setting, repeat_setting


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
        "The posed model (.obj, .ply), or the edited result (.h5).",
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
        "Edit the cage at rest, also one that is not fit; Apply writes it.",
        option="--edit-cage",
    )
    handles: Path | None = declare_setting(
        None, "A handles file that the page begins with.", role="read"
    )
    cage_edits: Path | None = declare_setting(
        None, "A cage edits file that the page begins with.", role="read"
    )
    output: Path | None = declare_setting(
        None,
        "The posed model (.obj, .ply), edited result (.h5) or cage (.obj, .ply) that Apply writes.",
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
