"""What the settings of commands share: the files that they name, and fields that several have.

This module imports no numerics.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cageik_cli.formats.settings import AUTO, RestFrame, SceneHints
from cageik_cli.method.solve.settings import AREA
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.settings import (
    DEFAULT_MEMORY,
    HelpGroup,
    Role,
    check_settings,
    declare_group,
    declare_setting,
    list_settings,
)


@dataclass(frozen=True, slots=True)
class CommandSettings:
    """Settings of a command; the roles of its fields say what is read and written."""

    def __post_init__(self) -> None:
        check_settings(self)

    def inputs(self) -> list[Path]:
        """Return the files that are read."""
        from cageik_cli.formats.find_files import Source, list_input_files

        named = [
            path
            for value in self._list_values("read")
            for path in (value if isinstance(value, tuple) else (value,))
        ]
        files = [Source.parse(path).file for path in named if isinstance(path, Path)]
        for clip in self._list_values("read as a clip"):
            arguments = (clip,) if isinstance(clip, str) else clip
            files += [path for one in arguments for path in list_input_files([one])]
        return files

    def outputs(self) -> list[Path]:
        """Return the files and folders that are written."""
        files: list[Path] = []
        for output in self._list_values("written"):
            files += [output] if isinstance(output, Path) else output.list_paths()
        return files

    def _list_values(self, role: Role) -> list[Any]:
        """List the values of the fields of a role that are given."""
        named = [one.name for one, setting in list_settings(self) if setting.role == role]
        return [value for value in map(self.__getattribute__, named) if value is not None]


def declare_rest() -> Any:
    """Return the field of a mesh that is the rest pose."""
    return declare_setting(
        None,
        "Mesh of the rest pose.",
        unset="the first frame",
        role="read",
        may_be_frame=True,
        excludes=(
            ("rest_frame", "`rest=` and `rest_frame=` both give the rest pose; leave one out"),
        ),
    )


def declare_rest_frame(default: RestFrame | None, **said: Any) -> Any:
    """Return the field of the frame that is the rest pose."""
    return declare_setting(
        default,
        "Number of the frame that is the rest pose, or auto: the frame in which the fewest parts "
        "touch.",
        kind="frame number",
        typed=None if default is None else "",
        unset="the first; with --cage, of the whole clip, whatever --frames takes",
        metavar=f"N|{AUTO}",
        group=HelpGroup.CLIP,
        **said,
    )


def declare_given_in(what: str, over: str) -> Any:
    """Return the field of unit and axis of the options `what` beside `over`."""
    return declare_setting(
        SceneHints(),
        f"Unit (mm, cm, dm, m, km, in, ft) and up axis of {what}, such as cm or m,z, which "
        f"are converted to those of {over}. Of several files, it is for those that state nothing.",
        option="--from",
        kind="unit and axis",
        unset="what the files state",
        group=HelpGroup.CLIP,
    )


def declare_overwrite() -> Any:
    """Return the field of whether outputs may be replaced."""
    return declare_setting(False, "Replace existing outputs.", is_per_clip=False)


def declare_memory() -> Any:
    """Return the field of the memory limit."""
    return declare_setting(
        DEFAULT_MEMORY,
        "Memory limit for weights and frame buffers; one block of frames is always held.",
        kind="size",
        typed="1GiB",
        group=HelpGroup.RUNNING,
    )


def declare_vertex_weights() -> Any:
    """Return the field of the weights of vertices."""
    return declare_setting(
        None,
        "Weights of the vertices: a file with one per vertex (text or .npy), or in extract one "
        f"per frame and vertex (.npy), where 0 marks missing data; or {AREA}: each vertex counts "
        "by its area.",
        word=AREA,
        metavar=f"FILE|{AREA}",
        role="read",
        group=HelpGroup.SOLVE,
    )


BUILD_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    "vertices": {
        "option": "--cage-vertices",
        "help": "Vertices of the cage that is built, at most.",
    },
    "symmetric": {"group": HelpGroup.SOLVE},
}
"""The settings that a command has of a cage that it builds where none is given."""


def declare_to() -> Any:
    """Return the field of the unit and the axis of what is written."""
    return declare_setting(
        SceneHints(),
        "Convert what is written to this unit (mm, cm, dm, m, km, in, ft) and up axis, such as "
        "m or cm,z.",
        kind="unit and axis",
        unset="as the source",
        group=HelpGroup.CLIP,
    )


def declare_saved(text: str, option: str) -> Any:
    """Return the field of a file that a view writes with its output."""
    return declare_setting(
        None,
        text,
        option=option,
        role="written",
        needs="output",
        needs_message="{}: it is written with the output, which -o names; leave it out",
    )


CLIP: dict[str, Mapping[str, Any]] = {"selection": {}, "layout": {}, "exclude": {}, "gaps": {}}
"""The settings of a clip that every command has which reads one."""


@dataclass(frozen=True, slots=True)
class WeightSettings:
    """How the weights of a run are obtained.

    Attributes
    ----------
    cache : Path, optional
        The folder of the weight cache; none is used if absent.
    """

    bind: BindSettings = declare_group(BindSettings())
    cache: Path | None = None
    jobs: int = 1
