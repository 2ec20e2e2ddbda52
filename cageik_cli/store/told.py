"""What the solved blocks of a clip tell of all its frames together."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cageik_cli.store.solved_block import SolvedBlock
from cageik_cli.util.arrays import Floats, Integers


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """What a log of F frames tells of them together.

    Attributes
    ----------
    skipped : dict
        By number in the clip, why a frame was.
    digests : list of bytes
        SHA-256 of the file of each frame.
    vertex_rms : (m,) float64
        sqrt(mean |v̂ − v|²) over the frames that were not skipped; nan for missing data.
    posed : (3,) int64
        Numbers of the worst, the median and the best frame, by rms.
    """

    skipped: dict[int, str]
    digests: list[bytes]
    vertex_rms: Floats
    posed: Integers


def told_of(blocks: Iterable[SolvedBlock]) -> Told:
    """Gather what all blocks of a clip tell."""
    skipped: dict[int, str] = {}
    digests: list[bytes] = []
    squares, rms = np.zeros(()), []
    for block in blocks:
        skipped |= block.faults
        digests += block.digests
        squares = squares + block.squares
        rms.append(block.figures.rms)
    ranked = np.argsort(np.concatenate(rms), kind="stable")[: len(digests) - len(skipped)]
    posed = ranked[[-1, (len(ranked) - 1) // 2, 0]] if len(ranked) else ranked
    return Told(skipped, digests, np.sqrt(squares / max(1, len(ranked))), posed)
