"""Handles on the cage animation of a result: a result again, with the edit added."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.clip_file import digest_of
from cageik_cli.formats.base.hdf5 import refuse_other_suffix
from cageik_cli.posing.edits import (
    Clip,
    EditedBlock,
    Layer,
    PosingSettings,
    Skin,
    edited_block,
    layers_of,
)
from cageik_cli.posing.handles.reader import read_handles
from cageik_cli.posing.summary import Posed, PoseLedger, Snapshot
from cageik_cli.solver.blocks import Budget, SolvedBlock, told_of
from cageik_cli.solver.metrics import FIGURES, WHOLE_FIGURES, FrameFigures, refuse_unsound
from cageik_cli.store.result import Result, read_cages, read_result, read_weights
from cageik_cli.store.result_writer import Ending, Header, ResultWriter, create
from cageik_cli.util.arrays import Floats, Integers
from cageik_cli.util.errors import InputError, located
from cageik_cli.util.outputs import keep_apart, prepare
from cageik_cli.util.progress import Observer
from cageik_cli.util.text import printable, shown
from cageik_cli.util.threads import blas_threads
from cageik_cli.workflows.pose import remark_layers


@dataclass(frozen=True, slots=True)
class EditSettings:
    """Which animation to edit, and where to write it.

    Attributes
    ----------
    result, handles, output : Path
    posing : PosingSettings
    memory : int
        Bytes that the weights and blocks of frames may take.
    overwrite : bool
    """

    result: Path
    handles: Path
    output: Path
    posing: PosingSettings = field(default_factory=PosingSettings)
    memory: int = 1 << 30
    overwrite: bool = False


def edit(settings: EditSettings, observer: Observer | None = None) -> Posed:
    """Lay the sets of a file of handles over the cage animation of a result, and write a result.

    Frames that no set touches keep their cages bit for bit. The figures of the new result compare
    it with the old one: they tell how far the mesh was moved.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When hard handles cannot all be met.
    """
    watch = observer or Observer()
    keep_apart([settings.output], [settings.result, settings.handles])
    prepare(settings.output, settings.overwrite)
    refuse_other_suffix(settings.output)
    with watch.stage("open"):
        handles = read_handles(settings.handles)
        result = read_result(settings.result)
        clip = _clip(result)
    # One thread: the last digits depend on how many.
    with watch.stage("pose"), located(settings.handles), blas_threads(1):
        layers = layers_of(handles, clip, settings.posing)
    remark_layers(layers, settings.handles, watch)
    run = _Run(result, settings.handles, clip, layers, PoseLedger(layers, result.rest.diagonal))
    size = Budget.of(settings.memory, clip.binding, jobs=1).block
    header = _header(settings, result, clip.binding)
    with create(settings.output, header, settings.overwrite) as file, blas_threads(1):
        told = told_of(run.written(file, size, watch))
        posed = [run.at(frame) for frame in told.posed.tolist()]
        misses = np.concatenate([block.meshes - block.edited for block in posed])
        sources = _sources(settings, result)
        with watch.stage("write"):
            file.complete(Ending(sources, told.skipped, told.vertex_rms, told.posed, misses))
    snapshot = Snapshot(result.frames[told.posed[0]], layers, posed[0], clip)
    return Posed(run.ledger.figures(result.frames), snapshot, result.scene.up_axis)


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """An edit that goes on.

    Attributes
    ----------
    result : Result
        That is edited.
    handles : Path
        The file whose handles are at fault when a frame cannot be edited.
    clip : Clip
    layers : list of Layer
    ledger : PoseLedger
    """

    result: Result
    handles: Path
    clip: Clip
    layers: list[Layer]
    ledger: PoseLedger

    def written(self, file: ResultWriter, size: int, watch: Observer) -> Iterator[SolvedBlock]:
        """All frames in blocks of a size, each when it is written and its figures are taken."""
        start = 0
        for cages in read_cages(self.result, size):
            with watch.stage("edit"):
                block = self._solved(cages, start)
            with watch.stage("write"):
                file.append(block.cages, block.figures)
            yield block
            start += len(cages)
            watch.advance(start, len(self.result.frames))

    def at(self, frame: int) -> EditedBlock:
        """One frame before and after."""
        return self._edited(np.array([frame]), self.clip.cage(frame)[None])

    def _edited(self, frames: Integers, cages: Floats) -> EditedBlock:
        with located(self.handles):
            return edited_block(self.layers, self.clip, frames, cages)

    def _solved(self, cages: Floats, start: int) -> SolvedBlock:
        """Frames from `start` on with all layers; those that were skipped stay gaps."""
        frames = start + np.arange(len(cages))
        known = ~np.isin(frames, list(self.result.skipped))
        block = self._edited(frames[known], cages[known])
        refuse_unsound(start, block.edit.cages, block.figures)
        self.ledger.take(block)
        all_cages, columns = np.full_like(cages, np.nan), {}
        all_cages[known] = block.edit.cages
        for name in FIGURES:
            found = getattr(block.figures, name)
            gap = -1 if name in WHOLE_FIGURES else np.nan
            columns[name] = np.full(len(cages), gap, found.dtype)
            columns[name][known] = found
        return SolvedBlock(
            start=start,
            cages=all_cages,
            figures=FrameFigures(**columns),
            squares=block.squares.sum(axis=0),
            digests=(b"",) * len(cages),
            faults={k: self.result.skipped[k] for k in frames[~known].tolist()},
        )


def _clip(result: Result) -> Clip:
    """What a result's cages rebuild."""
    weights = read_weights(result)
    if weights is None:
        raise InputError(
            f"{result.path}: holds no weights, which handles on the mesh need; extract it again "
            "without --no-weights"
        )
    binding = Binding(result.rest, result.cage, weights)

    def cage(frame: int) -> Floats:
        return np.asarray(next(read_cages(result, 1, frame))[0])

    return Clip(binding, Skin.rebuilding(binding), cage, len(result.frames))


def _header(settings: EditSettings, result: Result, binding: Binding) -> Header:
    posing, place = settings.posing, settings.posing.place
    said = {
        "pose_alpha": posing.alpha,
        "pose_beta": posing.beta,
        "rigidity": posing.rigidity,
        "hard": place.hard,
        "snap": place.snap,
        "allow_conflicts": place.allow_conflicts,
    }
    editor, source = (shown(printable(path.name)) for path in (settings.handles, settings.result))
    note = (
        f"edited by {editor}: figures tell how far the mesh was moved from {source}, not how well "
        "frames were met"
    )
    return Header(
        binding=binding,
        quality=result.quality,
        frames=result.frames,
        scene=result.scene,
        settings=result.settings | said,
        notes=(*result.notes, note),
        keep_weights=True,
        edited_from=printable(settings.result.name),
    )


def _sources(settings: EditSettings, result: Result) -> dict[str, Any]:
    """Those of the result, and what edited it."""
    files = {"result": settings.result, "handles": settings.handles}
    return result.sources | {
        role: {"name": printable(path.name), "sha256": digest_of(path).hex()}
        for role, path in files.items()
    }
