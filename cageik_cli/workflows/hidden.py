"""What is hidden for long: placed by the surface around it, and these frames solved again.

The clip is read a second time, as its vertices tell how the surface around has moved. What is
placed is what no motion around it in time tells: see `MAX_BRIDGED_FRAMES`.
"""

from dataclasses import replace

import numpy as np

from cageik_cli.captured.fill import RigidFiller
from cageik_cli.formats.base.sequence import Block, MeshSequence
from cageik_cli.geometry.rotations import nearest_rotations_by_svd
from cageik_cli.method.solve.blocks import BlockSolver, SolvedBlock
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver, Solution
from cageik_cli.method.weights.binding import reconstruct_frames
from cageik_cli.solver.executor import choose_block_size
from cageik_cli.store.checkpoint import Checkpoint
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import FileAccessError, InputError


def place_hidden(
    block_solver: BlockSolver, checkpoint: Checkpoint, output: Checkpoint, jobs: int
) -> None:
    """Place what is hidden for long in the frames of a checkpoint, and append them to another.

    Frames are read again by `jobs` threads.
    """
    progress, sequence = block_solver.progress, block_solver.sequence
    absences = checkpoint.summary.absences
    assert absences is not None
    filler = RigidFiller(block_solver.solver.binding.rest)
    reads = sequence.blocks(choose_block_size(checkpoint.spec.vertices), jobs)
    for solved, block in zip(checkpoint.blocks(), reads, strict=True):
        places = [
            frame - solved.start
            for frame in range(solved.start, solved.stop)
            if frame not in solved.skipped and len(absences.find_long(frame))
        ]
        if places:
            with progress.stage("solve"):
                cages = _solve_placed(block_solver, filler, solved, block, places)
            with progress.stage("measure"):
                solved = measure_again(block_solver, solved, cages, block)
        output.append(solved)


def _solve_placed(
    block_solver: BlockSolver,
    filler: RigidFiller,
    solved: SolvedBlock,
    block: Block,
    places: list[int],
) -> Floats:
    """Return the cages of a block, in whose frames at `places` all that is hidden is placed."""
    assert solved.kept is not None
    solver, cages = block_solver.solver, solved.cages.copy()
    positions, _ = block_solver.complete(block)
    # What is missing for a shorter time, rejected, or never data tells nothing of the surface.
    shares = solved.kept.expand_weights(positions.shape[1]) * (solver.vertex_weights > 0)
    for place in places:
        one, share = slice(place, place + 1), shares[place]
        rebuilt = reconstruct_frames(solver.binding, cages[one], solved.rotations[one])[0]
        left, is_hidden = share[:, None] * (positions[place] - rebuilt), share == 0
        guess = filler.fill(rebuilt + filler.extend(left, is_hidden), is_hidden)
        # What the cage misses of the surface around the piece goes on into it.
        rebuilt = solver.solve(guess[None]).reconstructions[0].copy()
        guess = rebuilt + filler.extend(guess - rebuilt, is_hidden)
        cages[place] = solver.solve(guess[None]).cages[0]
    return cages


def find_rotations(solver: DualLaplacianSolver, cages: Floats) -> Floats:
    """Return the rotations (k, 3, 3) of the rest pose to the meshes of cages (k, n, 3)."""
    if not solver.is_aligned:
        return np.tile(np.eye(3), (len(cages), 1, 1))
    weighted = solver.vertex_weights[:, None] * solver.rest
    # The mesh relative to any point will do, as the weighted rest pose sums to zero.
    moments = (solver.binding.weights.T @ weighted).T
    turns = nearest_rotations_by_svd(moments @ np.concatenate([solver.rest_cage[None], cages]))
    # Weights with offsets turn the rest cage, too; without, this is the identity.
    return np.asarray(turns[0].T @ turns[1:])


def measure_again(
    block_solver: BlockSolver,
    solved: SolvedBlock,
    cages: Floats,
    block: Block | None,
) -> SolvedBlock:
    """Return a block with other cages, (k, n, 3), and what they leave of its residuals."""
    assert block is not None
    assert solved.kept is not None
    sequence, solver = block_solver.sequence, block_solver.solver
    binding = solver.binding
    _check_unchanged(sequence, solved)
    skipped = np.array(sorted(solved.skipped), np.int64) - solved.start
    cages = cages.copy()
    cages[skipped] = binding.cage.vertices
    rotations = find_rotations(solver, cages)
    rebuilt = reconstruct_frames(binding, cages, rotations)
    positions, given = block_solver.complete(block)
    weights = solved.kept.expand_weights(rebuilt.shape[1])
    solution = Solution(cages, rebuilt, rotations, solved.sampled, weights)
    errors: dict[int, InputError] = {
        k: FileAccessError(reason) for k, reason in solved.skipped.items()
    }
    again = replace(block, positions=positions, read_errors=errors)
    return block_solver.measure_block(again, given, solution, solved.digests)


def _check_unchanged(sequence: MeshSequence, solved: SolvedBlock) -> None:
    """Refuse frames that are not those that were solved.

    Raises
    ------
    InputError
        Naming the frame.
    """
    for k, digest in enumerate(solved.digests, solved.start):
        if sequence.digest_or_zeros(k) != digest:
            raise FileAccessError(
                f"{sequence.location(k)}: changed during the run; run again with `resume=True`"
            )
