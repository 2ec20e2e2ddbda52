"""A cage animation as a USD skeleton: a joint a cage vertex, and our weights as skin weights."""

from pathlib import Path

from cageik_cli.export.animation import Animation, AnimationWriter
from cageik_cli.mesh import Floats, TriMesh


class SkeletonWriter(AnimationWriter):
    """Writes the rest mesh, bound to joints that only move, in whatever program can skin.

    A skin moves a rest vertex p to p + Σ_k w_k (c_k − rest c_k), which is `H c` as long as its
    weights are ours and `H` rebuilds the rest pose. Skin weights cannot be negative: see
    `skinning.skin_weights` for what is done about ours.

    Attributes
    ----------
    influences : int
        The most joints that move one vertex; known from the beginning.
    moved : float
        Largest distance of a skinned vertex from `H c` over the rest pose and the frames appended
        so far, file units; to be given in percent of the rest mesh's diagonal.
    """

    suffixes = (".usd", ".usda", ".usdc", ".usdz")
    influences: int
    moved: float

    def __init__(
        self,
        target: Path,
        animation: Animation,
        rest: TriMesh,
        weights: Floats,
        max_influences: int | None = None,
    ) -> None:
        """Begin to write to `target`, whose suffix is one of `suffixes`.

        Parameters
        ----------
        target : Path
        animation : Animation
            Of the cage: its `rest` is the rest cage.
        rest : TriMesh
            The mesh that is bound, m vertices.
        weights : (m, n) float64
            H, rows summing to one; read, never changed.
        max_influences : int, optional
            How many joints may move a vertex at most, 1 or more; all if absent.

        Raises
        ------
        InputError
            When usd-core is not installed, or the format cannot hold the animation.
        """
        raise NotImplementedError

    def append(self, frames: Floats) -> None:
        """Write the cages of the next k frames, (k, n, 3)."""

    def complete(self) -> None:
        """Save the file."""
