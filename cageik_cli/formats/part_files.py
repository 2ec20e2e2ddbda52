"""One file for each part of a model, by `{part}` in the name of the output."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cageik_cli.formats.base.writers import Animation, AnimationWriter, choose_short_names
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import Part, join_meshes, split_parts
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError, SettingError, join_truncated
from cageik_cli.util.text import make_file_name, number_names

if TYPE_CHECKING:
    from cageik_cli.formats.write import Output

PLACEHOLDER = "{part}"
"""Stands for the name of a part."""


def names_parts(path: Path) -> bool:
    """Return whether the name of an output has a place for that of a part."""
    return PLACEHOLDER in str(path)


def split_output(output: "Output", mesh: TriMesh, name: str) -> "list[Output]":
    """Return the output of each part of a mesh; the output alone if its name has no `{part}`.

    A mesh that came as one has a `name`.

    Raises
    ------
    InputError
        When the parts have no files or folders of their own.
    """
    if not names_parts(output.path):
        return [output]
    names = name_part_files([part.name or name for part in split_parts(mesh)])
    typed = str(output.path)
    outputs = [
        replace(output, path=Path(typed.replace(PLACEHOLDER, each)), makes_folder=True)
        for each in names
    ]
    if len({each.target_path for each in outputs}) < len(outputs):
        raise OutputError(
            f"{output.path}: each part needs a folder of its own; put {PLACEHOLDER} into its name, "
            f"as in {_suggest_name(output)}"
        )
    if output.recentre and output.find_writer().is_in_part_space:
        raise SettingError(
            f"{output.path}: positions of a part are in its own space, which `recentre=True` "
            "cannot move; leave one of them out"
        )
    return outputs


def name_part_files(names: list[str]) -> list[str]:
    """Return a name for the file of each part: short, safe on all systems, and all different."""
    plain = [make_file_name(name.replace("/", "_")) for name in choose_short_names(names)]
    folded = [name.casefold() for name in plain]
    unique = zip(plain, folded, number_names(folded), strict=True)
    return [name + numbered[len(fold) :] for name, fold, numbered in unique]


@contextmanager
def open_part_writers(outputs: "list[Output]", animation: Animation) -> Iterator[AnimationWriter]:
    """Open a writer of all parts, each to its output; these get their names at the end."""
    with ExitStack() as stack:
        writers = []
        for part, output in zip(animation.split(), outputs, strict=True):
            own = replace(
                animation,
                rest=join_meshes([part.mesh], [part.name], [part.transform]),
                guide=animation.guide if part.name == animation.guide else "",
            )
            writers.append((part, stack.enter_context(output.open_writer(own))))
        together = _PartsWriter(writers)
        yield together
    together.gather_notes()


class _PartsWriter(AnimationWriter):
    """Hands each part of the frames to its writer, which its output completes."""

    def __init__(self, writers: list[tuple[Part, AnimationWriter]]) -> None:
        self._writers = writers
        self.is_single = writers[0][1].is_single

    def append(self, frames: Floats) -> None:
        """Write the next frames of each part."""
        for part, writer in self._writers:
            own = part.select(frames) if writer.is_in_part_space else frames[:, part.vertices]
            writer.append(np.ascontiguousarray(own))

    def complete(self) -> None:
        """Do nothing: outputs complete their writers."""

    def gather_notes(self) -> None:
        """Take the notes of the writers, which are known when they are complete."""
        self.notes = tuple(dict.fromkeys(note for _, one in self._writers for note in one.notes))


def list_part_notes(outputs: "list[Output]", output: "Output", animation: Animation) -> list[str]:
    """Return a note on how the parts of a model are written, unless the format knows parts."""
    parts, writer = split_parts(animation.rest), output.find_writer()
    if names_parts(output.path):
        names = join_truncated(each.path.name for each in outputs)
        return [f"a file of each part: {names}"] if len(outputs) > 1 else []
    if writer.keeps_parts:
        return []
    example = _suggest_name(output)
    if len(parts) > 1:
        names = join_truncated(choose_short_names([part.name for part in parts]))
        return [f"holds its {len(parts)} parts as one mesh: {names}; {example} writes one of each"]
    if writer.is_in_part_space and not np.array_equal(parts[0].transform, np.eye(4)):
        return [f"is in the space of the scene; {example} is in that of the mesh"]
    return []


def _suggest_name(output: "Output") -> str:
    """Return a name with a place for that of a part."""
    path = output.path
    if output.frame_names is None:
        return str(path.with_name(f"{path.stem}_{PLACEHOLDER}{path.suffix}"))
    folder = output.target_path
    typed = folder.with_name(f"{folder.name}_{PLACEHOLDER}")
    return str(typed if output.is_folder else typed / path.name)
