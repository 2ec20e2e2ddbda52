"""Export the cages of a result in another format."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.scene import SceneHints
from cageik_cli.formats.usd.skeleton import SkeletonWriter
from cageik_cli.formats.write import ExportSummary, Output, WriterFactory, write_animation
from cageik_cli.store.result import Result, read_cages, read_result, read_weights
from cageik_cli.util.arrays import fit_frames
from cageik_cli.util.errors import SettingError, join_truncated
from cageik_cli.util.progress import ProgressListener

MAX_BLOCK_BYTES = 1 << 26
"""Bytes of a block of cages, at most."""


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """Which cages to write, where and how.

    Attributes
    ----------
    result : Path
    output : Output
    scene : SceneHints
        Time and space, where they differ from those of the result.
    skeleton : bool
        Write the rest pose with the weights as skin weights, and one joint per cage vertex.
    max_influences : int, optional
        Joints per vertex, at most.
    """

    result: Path
    output: Output
    scene: SceneHints = field(default_factory=SceneHints)
    skeleton: bool = False
    max_influences: int | None = None

    def inputs(self) -> list[Path]:
        """Return the file that is read."""
        return [self.result]

    def outputs(self) -> list[Path]:
        """Return the file or folder that is written."""
        return [self.output.target_path]


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
    """Note which frames were skipped, and what is written instead."""
    if result.skipped:
        names = join_truncated((result.frames[k] for k in result.skipped), 5)
        progress.note(
            "note",
            f"{len(result.skipped)} of {len(result.frames)} frames skipped ({names}); their "
            "cages are interpolated, or the nearest at either end of the clip",
        )


def check_export(settings: ExportSettings) -> None:
    """Refuse, before any work, an export that is impossible.

    Raises
    ------
    InputError
        Naming the output and what to do.
    """
    path = settings.output.path
    if settings.skeleton and path.suffix.lower() not in SkeletonWriter.suffixes:
        raise SettingError(
            f"{path}: --skeleton works with USD only, expected {', '.join(SkeletonWriter.suffixes)}"
        )
    settings.output.check_writable()


def _make_skeleton_factory(result: Result, max_influences: int | None) -> WriterFactory:
    """Make the factory of the writer of the skeleton, which needs the weights."""
    weights = read_weights(result)
    if weights is None:
        raise SettingError(
            f"{result.path}: has no weights, which a skeleton needs; extract it again without "
            "--no-weights"
        )
    if result.has_offsets:
        raise SettingError(
            f"{result.path}: its weights have few influences, and joints that only translate do "
            "not turn their rest pose with the frames; extract it without --influences"
        )
    return partial(SkeletonWriter, rest=result.rest, weights=weights, max_influences=max_influences)
