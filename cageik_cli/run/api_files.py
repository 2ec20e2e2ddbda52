"""The functions of the Python API that do what a command does, from files to a file.

Their keywords are the settings of the command.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, cast

from cageik_cli.editing.summary import PoseResult
from cageik_cli.formats.write import ExportSummary
from cageik_cli.run import deform as deform_run
from cageik_cli.run import edit as edit_run
from cageik_cli.run import export as export_run
from cageik_cli.run.keywords import make_settings, takes_settings
from cageik_cli.run.settings import DeformSettings, EditSettings, ExportSettings, PoseSettings
from cageik_cli.store.result import Edit, Result, read_animation
from cageik_cli.util.calls import FilePath, ReportProgress, check_call
from cageik_cli.util.messages import Note, Said
from cageik_cli.util.outputs import check_no_overlap
from cageik_cli.util.progress import ProgressListener


class _Listener(ProgressListener):
    """Calls a function of the user, and keeps the notes of a run."""

    def __init__(self, progress: ReportProgress | None) -> None:
        self._progress = progress
        self.notes: list[Note] = []

    def update(self, done: int, total: int) -> None:
        """Tell how much is done."""
        if self._progress is not None:
            self._progress(done, total)

    def note(self, topic: str, text: Said) -> None:
        """Keep a note."""
        self.notes.append(Note(text, "warning" if topic == "warning" else "note"))


@check_call
@takes_settings(ExportSettings)
def export(
    results: FilePath | Result | Edit | Sequence[FilePath | Result | Edit],
    output: FilePath,
    *,
    progress: ReportProgress | None = None,
    **settings: Any,
) -> ExportSummary:
    """Convert a cage animation to another format, as `cageik export` does.

    Parameters
    ----------
    results : path, Result or Edit, or a sequence of them
        The result whose cages are written; with `skeleton=True`, several of one rest pose, cage and
        weights are the animations of one model.
    output : path
        Its suffix is the format: a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a folder of frames,
        or numbered files in a folder, such as `cage/cage_####.obj`.
    progress : callable, optional
        Called with the number of frames done and the number of all frames.
    **settings
        As the options of `cageik export`; `help(cageik_cli.export)` lists them.

    Returns
    -------
    ExportSummary
        What was written, with the notes on it.

    Raises
    ------
    CageikError
        When the result is damaged, a setting is impossible, or the output cannot be written.

    Examples
    --------
    >>> from cageik_cli import export, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> written = export(result, "walker.glb", skeleton=True, influences=4)
    >>> written.frame_count, written.unit
    (48, 'joints that move 1 570 vertices')
    """
    listener = _Listener(progress)
    if isinstance(results, str | PathLike | Result | Edit):
        results = [results]
    named = tuple(map(_name_file, results))
    made = make_settings(ExportSettings, settings, results=named, output=output)
    check_no_overlap(made.outputs(), made.inputs())
    return replace(export_run.export(made, listener), notes=tuple(listener.notes))


@check_call
@takes_settings(DeformSettings, "source")
def deform(
    source: FilePath | Result | Edit,
    output: FilePath,
    *,
    progress: ReportProgress | None = None,
    **settings: Any,
) -> ExportSummary:
    """Move a mesh, points or splats by cages, as `cageik deform` does.

    Parameters
    ----------
    source : path, Result or Edit
        The result whose cages move its model at rest, or another mesh; with `cages`, it may also be
        a binding.
    output : path
        Its suffix is the format: a file (.npz, .pc2, .mdd, .glb, .usd*, .abc), a folder of frames,
        or numbered files in a folder. Points and splats are written as .ply, among others.
    progress : callable, optional
        Called with the number of frames done and the number of all frames.
    **settings
        As the options of `cageik deform`; `help(cageik_cli.deform)` lists them.

    Returns
    -------
    ExportSummary
        What was written, with the notes on it.

    Raises
    ------
    CageikError
        When an input is refused, a setting is impossible, or the output cannot be written.

    Examples
    --------
    >>> from cageik_cli import deform, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> written = deform(result, "mesh.npz", fps=30)
    >>> written.frame_count, written.vertex_count
    (48, 1570)
    """
    listener = _Listener(progress)
    made = make_settings(DeformSettings, settings, source=_name_file(source), output=output)
    return replace(deform_run.deform(made, listener), notes=tuple(listener.notes))


@check_call
@takes_settings(PoseSettings)
def pose_to_file(
    target: FilePath,
    handles: FilePath | None,
    output: FilePath,
    *,
    progress: ReportProgress | None = None,
    **settings: Any,
) -> PoseResult:
    """Pose a model by points or its cage, and write it, as `cageik pose` does.

    A `Poser` poses in memory.

    Parameters
    ----------
    target : path
        A model, with `cage`; or a binding.
    handles : path or None
        A JSON file that says which points move where; None with `cage_edits`.
    output : path
        The posed model (.obj, .ply).
    progress : callable, optional
        Called with how much of a stage is done, and how much there is.
    **settings
        As the options of `cageik pose`; `help(cageik_cli.pose_to_file)` lists them.

    Returns
    -------
    PoseResult
        How far the model and the anchors moved, the meshes before and after, and notes.

    Raises
    ------
    CageikError
        When an input is refused, handles conflict, or the output cannot be written.

    Examples
    --------
    >>> from cageik_cli import pose_to_file
    >>> walker = "data_fixtures/walker"
    >>> posed = pose_to_file(
    ...     f"{walker}/frames/walker_1.obj",
    ...     f"{walker}/handles.json",
    ...     "posed.obj",
    ...     cage=f"{walker}/cage.obj",
    ...     accuracy="preview",
    ... )
    >>> posed.snapshot.after.shape
    (1570, 3)
    """
    listener = _Listener(progress)
    made = make_settings(PoseSettings, settings, target=target, handles=handles, output=output)
    return replace(edit_run.pose(made, listener), notes=tuple(listener.notes))


@check_call
@takes_settings(EditSettings)
def edit_to_file(
    result: FilePath | Result | Edit,
    handles: FilePath | None,
    output: FilePath,
    *,
    progress: ReportProgress | None = None,
    **settings: Any,
) -> Edit:
    """Edit the cage animation of a result, and write the edit, as `cageik pose` does.

    Each frame keeps its own motion, and the edit is added.

    Parameters
    ----------
    result : path, Result or Edit
        What is edited; it is not changed.
    handles : path or None
        A JSON file that says which points move where; None with `cage_edits`.
    output : path
        The edit (.h5), which all functions and commands take that take a result.
    progress : callable, optional
        Called with the number of frames done and the number of all frames.
    **settings
        As the options of `cageik pose` for a result; `help(cageik_cli.edit_to_file)` lists them.

    Raises
    ------
    CageikError
        When an input is refused, handles conflict, or the output cannot be written.

    Examples
    --------
    >>> from cageik_cli import edit_to_file, extract_to_file
    >>> walker = "data_fixtures/walker"
    >>> result = extract_to_file(f"{walker}/frames", f"{walker}/cage.obj", "walker.h5")
    >>> edit_to_file(result, f"{walker}/handles.json", "edited.h5", rigidity=2)
    <Edit: edited.h5, 48 frames of 1570 vertices in a cage of 80>
    """
    made = make_settings(
        EditSettings, settings, result=_name_file(result), handles=handles, output=output
    )
    edit_run.edit(made, _Listener(progress))
    return cast(Edit, read_animation(made.output))


def _name_file(result: FilePath | Result | Edit) -> Path:
    """Return the file of a result."""
    return result.path if isinstance(result, Result | Edit) else Path(result)
