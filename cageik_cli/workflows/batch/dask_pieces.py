"""A long clip on a cluster: one worker keeps its log, and others solve pieces of it."""

import io
import pickle
import time
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.open import clip_and_rest
from cageik_cli.solver.blocks import BlockSolver, Budget, SolvedBlock, Threads
from cageik_cli.solver.dual_laplacian import DualLaplacianSolver
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.util.errors import InputError
from cageik_cli.util.progress import Observer
from cageik_cli.workflows.batch.clip_task import bound_for
from cageik_cli.workflows.batch.dask_worker import make_fit
from cageik_cli.workflows.batch.jobs import ClipJob
from cageik_cli.workflows.extract_inputs import ExtractSettings

PIECE_SECONDS = 0.5
"""Work of a piece at least; what a scheduler spends on a task is a hundredth of it."""

FEWEST_PIECES = 3
"""What makes fewer is done where it is."""

URGENT = 1
"""Priority of pieces: a clip that is begun is brought to its end before others are begun."""


@dataclass(frozen=True, slots=True)
class WeightsTask:
    """The task whose result a clip's weights are; whoever asks for its key again gets that result.

    Attributes
    ----------
    key : str
    job : ClipJob
        Any of those that share the weights.
    """

    key: str
    job: ClipJob

    def asked_of(self, client: Any) -> Any:
        """The future of the weights."""
        return client.submit(made_weights, self.job, key=self.key)


def made_weights(job: ClipJob) -> StoredBinding | None:
    """A task: the weights of a job, and of all that share them."""
    make_fit()
    return bound_for(job)


@dataclass(frozen=True, slots=True)
class Pieces:
    """A crew for a task of a cluster: does short clips itself, and gives pieces of long ones out.

    The first `seconds` of work are done here, and what they solve is the size of a piece.

    Attributes
    ----------
    settings : ExtractSettings
        Of the clip; its files are at the same paths for all workers.
    weights : WeightsTask
    seconds : float
    """

    settings: ExtractSettings
    weights: WeightsTask
    seconds: float = PIECE_SECONDS

    def solving(
        self, work: BlockSolver, starts: range, budget: Budget
    ) -> AbstractContextManager[Iterator[SolvedBlock]]:
        """The blocks that begin at `starts`, in order."""
        return closing(self._blocks(work, starts, replace(budget, solvers=1, queue=starts.step)))

    def _blocks(self, work: BlockSolver, starts: range, budget: Budget) -> Generator[SolvedBlock]:
        begun, done = time.monotonic(), 0
        with Threads(1).solving(work, starts, budget) as here:
            for block in here:
                yield block
                done += 1
                is_long = len(starts) - done >= FEWEST_PIECES * done
                if is_long and time.monotonic() - begun >= self.seconds:
                    break
        if done < len(starts):
            pieces = cut(range(starts[done], starts.stop, starts.step), done)
            with closing(self._elsewhere(work, pieces, budget)) as blocks:
                yield from blocks

    def _elsewhere(
        self, work: BlockSolver, pieces: Iterator[range], budget: Budget
    ) -> Generator[SolvedBlock]:
        """Solve pieces as tasks of their own, no more at once than keep all workers busy."""
        from distributed import KilledWorker, worker_client

        pending: deque[Any] = deque()
        with worker_client() as client:
            weights = self.weights.asked_of(client)
            common = client.scatter(Common.of(self.settings, work, budget), hash=False)
            try:
                while True:
                    refuse_unwanted(client)
                    for _ in range(2 * len(client.nthreads()) - len(pending)):
                        if (piece := next(pieces, None)) is not None:
                            pending.append(
                                client.submit(
                                    solved_piece,
                                    common,
                                    weights,
                                    piece,
                                    priority=URGENT,
                                    pure=False,
                                )
                            )
                    if not pending:
                        return
                    for block in pending.popleft().result():
                        work.sequence.recall(block.start, block.digests)
                        yield block
            except KilledWorker as error:
                raise InputError(sentence_of_killed(error)) from error
            finally:
                client.cancel(list(pending))


class Common:
    """What all pieces of a clip need: it travels to a worker once, and opens the clip there once.

    Parameters
    ----------
    settings : ExtractSettings
    budget : Budget
    names : tuple of str
        Of the clip's frames.
    stamp : bytes
        Of its first.
    solver : bytes
        As `pickled_without` gives it.
    """

    def __init__(
        self,
        settings: ExtractSettings,
        budget: Budget,
        names: tuple[str, ...],
        stamp: bytes,
        solver: bytes,
    ) -> None:
        self._given = (settings, budget, names, stamp, solver)
        self.settings, self.budget = settings, budget
        self._names, self._stamp, self._solver = names, stamp, solver

    @staticmethod
    def of(settings: ExtractSettings, work: BlockSolver, budget: Budget) -> "Common":
        """What it takes to go on with some work elsewhere."""
        solver = pickled_without(work.solver.binding, work.solver)
        sequence = work.sequence
        return Common(settings, budget, sequence.names, sequence.stamp(0), solver)

    def __reduce__(self) -> tuple[Any, ...]:
        return Common, self._given

    @cached_property
    def sequence(self) -> MeshSequence:
        """The clip, which must have the frames it had when the work began."""
        s = self.settings
        sequence, _ = clip_and_rest(s.frames, s.clip, s.rest, s.rest_frame)
        if sequence.names != self._names:
            raise InputError(
                f"{s.frames[0]}: has {len(sequence)} frames, or others, where it had "
                f"{len(self._names)} when the work began; let all workers see the same files, and "
                "run again"
            )
        sequence.recall(0, (self._stamp,))
        return sequence

    def work_with(self, binding: Binding) -> BlockSolver:
        """The work, joined with the weights again."""
        solver = unpickled_with(binding, self._solver)
        return BlockSolver(self.sequence, solver, self.settings.on_bad_frame == "skip", Observer())


def solved_piece(common: Common, bound: StoredBinding, starts: range) -> list[SolvedBlock]:
    """A task: the blocks that begin at `starts`."""
    make_fit()
    with Threads(1).solving(common.work_with(bound.binding), starts, common.budget) as blocks:
        return list(blocks)


def cut(starts: range, size: int) -> Iterator[range]:
    """Cut the starts of blocks in pieces of `size` blocks; each ends where the next begins."""
    for first in range(starts.start, starts.stop, size * starts.step):
        yield range(first, min(first + size * starts.step, starts.stop), starts.step)


def refuse_unwanted(client: Any) -> None:
    """End a task that the cluster does not count as one of this worker's any more.

    Raises
    ------
    InputError
        When the batch was stopped, or another worker has been given the task.
    """
    from distributed import get_worker

    worker = get_worker()
    address, key = worker.address, worker.get_current_task()
    if key not in client.processing([address]).get(address, ()):
        raise InputError("the batch was stopped, or goes on with this clip elsewhere")


def sentence_of_killed(error: Any) -> str:
    """What to do about a task that ends every worker it is given to."""
    return (
        f"{error.allowed_failures + 1} workers ended while they worked on it, the last of them "
        f"{error.last_worker.address}; see in its log whether it ran out of memory, then give "
        "workers more, or use a coarser cage or a smaller --memory"
    )


def pickled_without(binding: Binding, solver: DualLaplacianSolver) -> bytes:
    """A solver pickled with its binding, and the weights in it, left out."""
    stream = io.BytesIO()
    _Leaving(stream, binding).dump(solver)
    return stream.getvalue()


def unpickled_with(binding: Binding, data: bytes) -> DualLaplacianSolver:
    """The solver of `pickled_without`, given the same binding again."""
    solver: DualLaplacianSolver = _Joining(io.BytesIO(data), binding).load()
    return solver


class _Leaving(pickle.Pickler):
    def __init__(self, stream: io.BytesIO, binding: Binding) -> None:
        super().__init__(stream, pickle.HIGHEST_PROTOCOL)
        self._names = {id(binding): "binding", id(binding.weights): "weights"}

    def persistent_id(self, thing: object) -> str | None:
        return self._names.get(id(thing))


class _Joining(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, binding: Binding) -> None:
        super().__init__(stream)
        self._things = {"binding": binding, "weights": binding.weights}

    def persistent_load(self, name: str) -> object:
        return self._things[name]
