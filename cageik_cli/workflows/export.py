"""From a result file to its cages in another format."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.scene import SceneHints
from cageik_cli.formats.usd.skeleton import SkeletonWriter
from cageik_cli.formats.write import ExportSummary, Output, WriterFactory, write_animation
from cageik_cli.store.result import Result, read_cages, read_result, read_weights
from cageik_cli.util.arrays import fit_frames
from cageik_cli.util.errors import InputError, join_truncated
from cageik_cli.util.progress import ProgressListener

MAX_BLOCK_BYTES = 1 << 26
"""Most that a block of cages takes."""


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """Which cages to write, where and how.

    Attributes
    ----------
    result : Path
    output : Output
    scene : SceneHints
        Time and space, where they are not to be the result's.
    skeleton : bool
        Write the rest pose with our weights as skin weights, moved by a joint a cage vertex.
    max_influences : int, optional
        How many joints may move a vertex at most.
    """

    result: Path
    output: Output
    scene: SceneHints = field(default_factory=SceneHints)
    skeleton: bool = False
    max_influences: int | None = None


def export(settings: ExportSettings, progress: ProgressListener | None = None) -> ExportSummary:
    """Write the cage animation of a result.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    """
    progress = progress or ProgressListener()
    check_export(settings)
    result = read_result(settings.result)
    animation = Animation(
        rest=result.cage,
        frame_count=len(result.frames),
        scene=settings.scene.override(result.scene),
        name="cage",
    )
    report_skipped_frames(result, progress)
    blocks = read_cages(result, fit_frames(MAX_BLOCK_BYTES, len(result.cage.vertices)))
    if not settings.skeleton:
        return write_animation(settings.output, animation, blocks, progress)
    make_writer = _make_skeleton_factory(result, settings.max_influences)
    return write_animation(settings.output, animation, blocks, progress, make_writer)


def report_skipped_frames(result: Result, progress: ProgressListener) -> None:
    """Say which frames were skipped, and what is written in their stead."""
    if result.skipped:
        names = join_truncated((result.frames[k] for k in result.skipped), 5)
        progress.note(
            "note",
            f"{len(result.skipped)} of {len(result.frames)} frames skipped ({names}); their "
            "cages are put between those before and after, or are the nearest at either end",
        )


def check_export(settings: ExportSettings) -> None:
    """Refuse, before any work, an export that cannot be.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    path = settings.output.path
    if settings.skeleton and path.suffix.lower() not in SkeletonWriter.suffixes:
        raise InputError(
            f"{path}: `{path.suffix}` holds no skeleton here, expected "
            f"{', '.join(SkeletonWriter.suffixes)}"
        )
    settings.output.check_writable()


def _make_skeleton_factory(result: Result, max_influences: int | None) -> WriterFactory:
    """What makes the writer of the result's skeleton."""
    weights = read_weights(result)
    if weights is None:
        raise InputError(
            f"{result.path}: holds no weights, which a skeleton needs; extract it again without "
            "--no-weights"
        )
    return partial(SkeletonWriter, rest=result.rest, weights=weights, max_influences=max_influences)
