"""What is at the output of a run already: its result, or the checkpoint of an interrupted run."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.obj.frames import encode_exact_obj
from cageik_cli.formats.settings import Scene
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.weights import check_cage_output
from cageik_cli.method.solve.blocks import SolvedBlock
from cageik_cli.run.settings import ExtractSettings
from cageik_cli.store.checkpoint import (
    Checkpoint,
    RunSpec,
    check_checkpoint_path,
    checkpoint_progress,
)
from cageik_cli.store.result import Result, checkpoint_path, has_weights, read_animation
from cageik_cli.util.errors import CheckpointError, InputError, add_remark
from cageik_cli.util.files import read_input
from cageik_cli.util.messages import Hint, say
from cageik_cli.util.outputs import check_writable, write_bytes
from cageik_cli.util.progress import ProgressListener
from cageik_cli.util.text import group_digits
from cageik_cli.util.version import __version__


def check_output(settings: ExtractSettings) -> None:
    """Refuse, before any work, to write over a result or a checkpoint."""
    may_replace = settings.overwrite or settings.resume
    check_writable(settings.output, may_replace)
    other = settings.output
    check_hdf5_suffix(other, "write the cages to it, too, by " + Hint("exports", other))
    path = checkpoint_path(settings.output)
    check_checkpoint_path(path)
    if path.exists() and not may_replace:
        done, count = checkpoint_progress(path)
        raise CheckpointError(
            f"{path}: checkpoint found ({group_digits(done)} of {group_digits(count)} frames): "
            + say("continue with `resume=True` or start over with `overwrite=True`")
        )
    if settings.cage_output is not None:
        check_cage_output(settings.cage_output, may_replace)


def find_existing(
    settings: ExtractSettings,
    sequence: MeshSequence,
    scene: Scene,
    *,
    recorded: dict[str, Any],
    sources: dict[str, Any],
) -> tuple[Result | None, str]:
    """Find the result that is at the output, if the run would make the same.

    Parameters
    ----------
    recorded : dict
        The settings as the result of the run records them.

    Returns
    -------
    result : Result or None
    reason : str
        Of what a result is that is there and is replaced: "other settings"; "" if none is.

    Raises
    ------
    InputError
        When there is another result, or something else, or a result with gaps where the run
        allows none; unless it may be overwritten.
    """
    if not settings.output.exists():
        return None, ""
    try:
        result = read_animation(settings.output)
        if not isinstance(result, Result):
            if settings.overwrite:
                return None, "an edit"
            raise CheckpointError(
                f"{result.path}: is an edit by cageik pose; "
                + say("choose another name, or replace it with `overwrite=True`")
            )
        sources = sources | {"frames": sequence.describe_source()}
        if settings.builds_cage and "cage" in result.sources:
            sources["cage"] = result.sources["cage"]  # it follows from the other files
        is_same = {
            "another version of cageik": result.version == __version__,
            "other settings": result.settings == recorded
            and has_weights(result) == settings.keep_weights,
            "other frames": result.frames == sequence.names,
            "another scene": result.scene == scene,
            "other files": result.sources == sources,
        }
        differing = next((what for what, holds in is_same.items() if not holds), "")
        if differing and not settings.overwrite:
            raise CheckpointError(
                f"{result.path}: is the result of {differing}; "
                + say("choose another name, or replace it with `overwrite=True`")
            )
        if not differing and not settings.accepts_gaps:
            _check_no_gaps(result, sequence)
    except InputError:
        if settings.overwrite:
            return None, "a run that left gaps, or was damaged"
        raise
    return (None, differing) if differing else (result, "")


def _check_no_gaps(result: Result, sequence: MeshSequence) -> None:
    """Refuse a result in which frames were skipped, other than those without files."""
    skipped = [why for k, why in result.skipped.items() if k not in sequence.missing]
    if skipped:
        raise CheckpointError(
            f"{result.path}: {len(skipped)} frames are skipped in it, the first: "
            + skipped[0]
            + say(
                "; repair them and use `overwrite=True`, or accept the gaps with "
                "`on_bad_frame=skip`"
            )
        )


@contextmanager
def open_checkpoint(settings: ExtractSettings, spec: RunSpec) -> Iterator[Checkpoint]:
    """Open the checkpoint of this run, or start one; an error says how to continue.

    It is deleted when the block ends, unless there was an error and it holds frames.
    """
    path = checkpoint_path(settings.output)
    checkpoint = Checkpoint.open(path, spec, settings.resume, settings.overwrite)
    try:
        yield checkpoint
    except BaseException as error:
        kept = checkpoint.count_frames()
        if kept:
            add_remark(
                error,
                f"{kept} of {len(spec.frames)} frames are kept in {path}; "
                + say("continue with `resume=True`, or start over with `overwrite=True`"),
            )
            checkpoint.close()
        else:
            checkpoint.discard()
        raise
    checkpoint.discard()


def recover_blocks(
    checkpoint: Checkpoint,
    sequence: MeshSequence,
    settings: ExtractSettings,
    progress: ProgressListener,
) -> None:
    """Take over what an interrupted run has solved, and say from where this run continues.

    That is the first block with a frame whose file has changed since, or with a gap, unless gaps
    are kept. If the weights are fitted to the frames, it is then the first block of all.

    Raises
    ------
    InputError
        When a frame of that block cannot be read, and gaps are not kept; the checkpoint then keeps
        all that it holds.
    """
    changed: list[int] = []
    with ThreadPoolExecutor(settings.jobs) as pool:

        def is_current(block: SolvedBlock) -> bool:
            digests = pool.map(sequence.digest_or_zeros, range(block.start, block.stop))
            pairs = enumerate(zip(digests, block.digests, strict=True), block.start)
            changed[:] = [k for k, (now, then) in pairs if now != then]
            if not settings.skips_bad_frames:
                changed.extend(set(block.skipped) - sequence.missing)
                for k in sorted(changed):
                    # The run would stop at a frame that cannot be read, and lose blocks after it.
                    sequence.read_frame(k)
            return not changed

        checkpoint.recover(is_current)
    count, done = len(sequence), checkpoint.frames_done
    if done or changed or checkpoint.has_other_fit:
        reason = f" ({sequence.names[min(changed)]} has changed)" if changed else ""
        if checkpoint.has_other_fit:
            reason = " (its weights were fitted to other frames)"
        progress.note("resumed", f"after {done} of {count} frames{reason}")
        progress.update(done, count)


def write_built_cage(settings: ExtractSettings, cage: TriMesh) -> None:
    """Write the cage that was built, if that is asked for.

    The file that an interrupted run wrote is kept; another one is replaced only with `overwrite`.
    """
    path = settings.cage_output
    if path is None:
        return
    data = encode_exact_obj(cage.vertices, cage.faces)
    is_kept = settings.resume and path.is_file() and read_input(path, may_be_empty=True) == data
    if not is_kept:
        write_bytes(path, data, settings.overwrite)
