"""The checkpoint of a run: opened, continued where an interrupted run ended, deleted at the end."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from cageik_cli.solver.blocks import SolvedBlock
from cageik_cli.store.checkpoint import Checkpoint, RunSpec
from cageik_cli.store.result import checkpoint_path
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.plan import ExtractionPlan
from cageik_cli.workflows.settings import ExtractSettings


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
            error.add_note(
                f"{kept} of {len(spec.frames)} frames are kept in {path}; continue with --resume"
            )
            checkpoint.close()
        else:
            checkpoint.discard()
        raise
    checkpoint.discard()


def resume_from_checkpoint(
    checkpoint: Checkpoint, plan: ExtractionPlan, progress: ProgressListener
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
    with ThreadPoolExecutor(plan.settings.jobs) as pool:

        def is_current(block: SolvedBlock) -> bool:
            changed[:] = _find_changed_frames(block, plan, pool)
            return not changed

        checkpoint.recover(is_current)
    count, done = len(plan.sequence), checkpoint.frames_done
    if done or changed or checkpoint.has_other_fit:
        reason = f" ({plan.sequence.names[min(changed)]} has changed)" if changed else ""
        if checkpoint.has_other_fit:
            reason = " (its weights were fitted to other frames)"
        progress.note("resumed", f"from frame {done} of {count}{reason}")
        progress.update(done, count)


def _find_changed_frames(
    block: SolvedBlock, plan: ExtractionPlan, pool: ThreadPoolExecutor
) -> list[int]:
    """Return the frames of a block that must be solved again."""
    sequence = plan.sequence
    digests = pool.map(sequence.digest_or_zeros, range(block.start, block.stop))
    pairs = enumerate(zip(digests, block.digests, strict=True), block.start)
    changed = [k for k, (now, then) in pairs if now != then]
    if not plan.settings.skips_bad_frames:
        changed += set(block.skipped) - sequence.missing
        for k in sorted(changed):
            # The run would stop at a frame that cannot be read, and lose the blocks after it.
            sequence.read_frame(k)
    return changed
