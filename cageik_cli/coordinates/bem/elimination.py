"""The elimination of blocks of unknowns, shared out over threads.

Threads of the linear algebra wait for each other at every step, which takes long where other
programs run. So it has one, and the blocks of a step are shared out over threads of our own. The
blocks are fixed: the number of threads does not change the result.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cageik_cli.util.arrays import Floats

Float32s = NDArray[np.float32]

BLOCK_SIZE = 256
"""Unknowns that are eliminated together; the inverses of their blocks take little time."""

SUBSTITUTED_COLUMNS = 64
"""Right hand sides in which the unknowns are substituted together."""


def solve_in_place(
    matrix: Float32s, rhs: Float32s, pool: ThreadPoolExecutor, block_size: int = BLOCK_SIZE
) -> None:
    """Replace `rhs`, (u, n), by the solution of matrix (u, u) · x = rhs; the matrix is lost.

    Rows are not exchanged. This needs leading blocks that are well conditioned. Those of Galerkin's
    method are: they are the equations of fewer polynomials, and the single layer is positive
    definite. Rows are divided by their blocks in double precision: in cages whose sides nearly
    touch, blocks have condition numbers of 1e6 and more. So the error is about that of LAPACK's
    routine, which exchanges rows: not twice as large in a wedge of a tenth of a degree.

    Raises
    ------
    numpy.linalg.LinAlgError
        When a block is singular.
    """
    elimination = _Elimination(matrix, rhs)
    blocks = _split(len(matrix), block_size)
    elimination.invert(blocks[0])
    for place, block in enumerate(blocks, 1):
        rhs[block] = elimination.inverses[block.start] @ rhs[block]
        for work in (elimination.divide, elimination.eliminate):
            _run_all(pool, partial(work, block), blocks[place:])
    columns = _split(rhs.shape[1], SUBSTITUTED_COLUMNS)
    _run_all(pool, partial(elimination.substitute, blocks), columns)


def _split(count: int, size: int) -> list[slice]:
    return [slice(start, min(start + size, count)) for start in range(0, count, size)]


def _run_all(
    pool: ThreadPoolExecutor, work: Callable[[slice], None], parts: Iterable[slice]
) -> None:
    for _ in pool.map(work, parts):
        pass


class _Elimination:
    """Equations matrix (u, u) · x = rhs (u, n), changed in place.

    Attributes
    ----------
    inverses : dict
        The inverses of blocks on the diagonal, by their first unknown.
    """

    def __init__(self, matrix: Float32s, rhs: Float32s) -> None:
        self.matrix, self.rhs = matrix, rhs
        self.inverses: dict[int, Floats] = {}

    def invert(self, block: slice) -> None:
        """Invert a block of the diagonal."""
        self.inverses[block.start] = np.linalg.inv(self.matrix[block, block].astype(np.float64))

    def divide(self, block: slice, columns: slice) -> None:
        """Divide some columns of the rows of a block by the block."""
        self.matrix[block, columns] = self.inverses[block.start] @ self.matrix[block, columns]

    def eliminate(self, block: slice, rows: slice) -> None:
        """Eliminate the unknowns of a block from some rows; invert the block that is next."""
        after = slice(block.stop, len(self.matrix))
        self.matrix[rows, after] -= self.matrix[rows, block] @ self.matrix[block, after]
        self.rhs[rows] -= self.matrix[rows, block] @ self.rhs[block]
        if rows.start == block.stop:
            self.invert(rows)  # beside the other rows

    def substitute(self, blocks: list[slice], columns: slice) -> None:
        """Substitute the unknowns in some columns of `rhs`, the last first."""
        for block in reversed(blocks):
            later = slice(block.stop, len(self.matrix))
            self.rhs[block, columns] -= self.matrix[block, later] @ self.rhs[later, columns]
