"""Runs that are interrupted: what they leave is kept, found again, and gone on from."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cageik_cli import __version__
from cageik_cli.formats.base.hdf5 import check_hdf5_suffix
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.store.checkpoint import Checkpoint, RunSpec, checkpoint_progress
from cageik_cli.store.result import Result, checkpoint_path, has_weights, read_result
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import check_writable
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.extract_inputs import ExtractSettings, Inputs, resolve_scene


def check_output_path(output: Path, overwrite: bool, resume: bool) -> None:
    """Refuse, before any work, to write over a result or over what an interrupted run left.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    check_writable(output, overwrite or resume)
    check_hdf5_suffix(output)
    checkpoint_file = checkpoint_path(output)
    if checkpoint_file.exists() and not (overwrite or resume):
        done, count = checkpoint_progress(checkpoint_file)
        raise InputError(
            f"{checkpoint_file}: an interrupted run has left {done} of {count} frames there; go "
            f"on with "
            "--resume, or begin again with --overwrite"
        )


def find_existing_result(
    settings: ExtractSettings, inputs: Inputs, recorded: dict[str, Any]
) -> Result | None:
    """The result that is there if it is what this run would make of the same files, else None.

    Raises
    ------
    InputError
        When there is another result, or no result, or one with gaps that are not to be; unless it
        may be overwritten.
    """
    output = settings.output
    if not output.exists():
        return None
    try:
        result = read_result(output)
        _check_same_run(result, settings, inputs, recorded)
    except InputError:
        if settings.overwrite:
            return None
        raise
    return result


def _check_same_run(
    result: Result, settings: ExtractSettings, inputs: Inputs, recorded: dict[str, Any]
) -> None:
    sequence = inputs.sequence
    differences = (
        ("another version of cageik", result.version != __version__),
        ("other settings", result.settings != recorded),
        ("other settings", has_weights(result) != settings.keep_weights),
        ("other frames", result.frames != sequence.names),
        ("another scene", result.scene != resolve_scene(settings, inputs)),
        ("other files", result.sources != inputs.sources | {"frames": sequence.describe_source()}),
    )
    for what, differs in differences:
        if differs:
            raise InputError(
                f"{result.path}: is the result of {what}; choose another name, or replace it with "
                "--overwrite"
            )
    if result.skipped and settings.on_bad_frame != "skip":
        raise InputError(
            f"{result.path}: {len(result.skipped)} frames were skipped in it, the first: "
            f"{next(iter(result.skipped.values()))}; mend them and replace it with --overwrite, "
            "or take it as it is with --on-bad-frame skip"
        )


@contextmanager
def open_checkpoint(
    path: Path, spec: RunSpec, resume: bool, overwrite: bool
) -> Iterator[Checkpoint]:
    """The log of this run: what is there of it, or a new one. An error tells how to go on."""
    checkpoint = Checkpoint.open(path, spec, resume, overwrite)
    try:
        yield checkpoint
    except BaseException as error:
        if checkpoint.frames_done:
            error.add_note(
                f"{checkpoint.frames_done} of {len(spec.frames)} frames are kept in {path}; go "
                f"on with "
                "--resume"
            )
            checkpoint.close()
        else:
            checkpoint.discard()
        raise
    checkpoint.discard()


def resume_from_checkpoint(
    checkpoint: Checkpoint,
    sequence: MeshSequence,
    keep_gaps: bool,
    jobs: int,
    progress: ProgressListener,
) -> None:
    """Say where the run goes on: at the first block of which a frame's file is another by now.

    Or at the first block with a gap, unless gaps are kept.

    Raises
    ------
    InputError
        When a frame of that block cannot be read, and gaps are not kept; nothing is lost of what
        was solved behind it.
    """
    reason = ""
    with ThreadPoolExecutor(jobs) as pool:
        for block in checkpoint.blocks():
            digests = pool.map(sequence.digest_or_zeros, range(block.start, block.stop))
            pairs = enumerate(zip(digests, block.digests, strict=True), block.start)
            stale = [k for k, (now, then) in pairs if now != then]
            if not keep_gaps:
                stale += block.skipped
                for k in sorted(stale):
                    sequence.read_frame(k)  # the run would end at it, and what is cut be lost
            if stale:
                checkpoint.truncate(block.start)
                reason = f", for {sequence.names[min(stale)]} is not what it was"
                break
    count = len(checkpoint.spec.frames)
    if checkpoint.frames_done or reason:
        progress.note("resumed", f"from frame {checkpoint.frames_done} of {count}{reason}")
        progress.update(checkpoint.frames_done, count)
