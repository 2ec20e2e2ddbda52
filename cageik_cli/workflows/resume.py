"""Runs that are interrupted: what they leave is kept, found again, and gone on from."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cageik_cli import __version__
from cageik_cli.formats.base.hdf5 import refuse_other_suffix
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.store.checkpoint import PartialResult, Plan, progress_of
from cageik_cli.store.result import Result, has_weights, partial_name, read_result
from cageik_cli.util.errors import InputError
from cageik_cli.util.outputs import prepare
from cageik_cli.util.progress import Observer
from cageik_cli.workflows.extract_inputs import ExtractSettings, Inputs, scene_of


def prepare_result(output: Path, overwrite: bool, resume: bool) -> None:
    """Refuse, before any work, to write over a result or over what an interrupted run left.

    Raises
    ------
    InputError
        Naming the file and what to do.
    """
    prepare(output, overwrite or resume)
    refuse_other_suffix(output)
    log = partial_name(output)
    if log.exists() and not (overwrite or resume):
        done, count = progress_of(log)
        raise InputError(
            f"{log}: an interrupted run has left {done} of {count} frames there; go on with "
            "--resume, or begin again with --overwrite"
        )


def whole_already(
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
        _refuse_other(result, settings, inputs, recorded)
    except InputError:
        if settings.overwrite:
            return None
        raise
    return result


def _refuse_other(
    result: Result, settings: ExtractSettings, inputs: Inputs, recorded: dict[str, Any]
) -> None:
    sequence = inputs.sequence
    differences = (
        ("another version of cageik", result.version != __version__),
        ("other settings", result.settings != recorded),
        ("other settings", has_weights(result) != settings.keep_weights),
        ("other frames", result.frames != sequence.names),
        ("another scene", result.scene != scene_of(settings, inputs)),
        ("other files", result.sources != inputs.sources | {"frames": sequence.source()}),
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
def going_on(log: Path, plan: Plan, resume: bool, overwrite: bool) -> Iterator[PartialResult]:
    """The log of this run: what is there of it, or a new one. An error tells how to go on."""
    partial = PartialResult.opened(log, plan, resume, overwrite)
    try:
        yield partial
    except BaseException as error:
        if partial.done:
            error.add_note(
                f"{partial.done} of {len(plan.frames)} frames are kept in {log}; go on with "
                "--resume"
            )
            partial.close()
        else:
            partial.discard()
        raise
    partial.discard()


def take_up(
    partial: PartialResult, sequence: MeshSequence, keep_gaps: bool, jobs: int, watch: Observer
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
        for block in partial.blocks():
            stamps = pool.map(sequence.stamp, range(block.start, block.stop))
            pairs = enumerate(zip(stamps, block.digests, strict=True), block.start)
            stale = [k for k, (now, then) in pairs if now != then]
            if not keep_gaps:
                stale += block.faults
                for k in sorted(stale):
                    sequence.frame(k)  # the run would end at it, and what is cut be lost
            if stale:
                partial.cut(block.start)
                reason = f", for {sequence.names[min(stale)]} is not what it was"
                break
    count = len(partial.plan.frames)
    if partial.done or reason:
        watch.remark("resumed", f"from frame {partial.done} of {count}{reason}")
        watch.advance(partial.done, count)
