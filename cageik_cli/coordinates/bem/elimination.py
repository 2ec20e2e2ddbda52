"""Solution of the boundary equations by elimination of blocks, in single precision."""

import numpy as np
from numpy.typing import NDArray

BLOCK_SIZE = 256
"""Unknowns that are eliminated together; the inverses of their blocks take little time."""

ROWS_AT_ONCE = 1024
"""Rows that are changed together, so that no second matrix is held."""

Float32s = NDArray[np.float32]


def solve_in_place(matrix: Float32s, rhs: Float32s) -> None:
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
    count = len(matrix)
    blocks = [slice(k, min(k + BLOCK_SIZE, count)) for k in range(0, count, BLOCK_SIZE)]
    for block in blocks:
        after = slice(block.stop, count)
        inverse = np.linalg.inv(matrix[block, block].astype(np.float64))
        rhs[block] = inverse @ rhs[block]
        matrix[block, after] = inverse @ matrix[block, after]
        for start in range(block.stop, count, ROWS_AT_ONCE):
            rows = slice(start, start + ROWS_AT_ONCE)
            matrix[rows, after] -= matrix[rows, block] @ matrix[block, after]
            rhs[rows] -= matrix[rows, block] @ rhs[block]
    for block in reversed(blocks):
        rhs[block] -= matrix[block, block.stop :] @ rhs[block.stop :]
