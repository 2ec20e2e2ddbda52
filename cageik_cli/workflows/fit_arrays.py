"""Weights fitted to clips or to arrays of frames, without files."""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.geometry.mesh import validate_positions
from cageik_cli.solver.area_weights import make_vertex_weights
from cageik_cli.solver.fitting import fit as fitting
from cageik_cli.solver.fitting.fit import FitConditions, FittedWeights
from cageik_cli.solver.fitting.sample import FrameReader, SampleSettings
from cageik_cli.solver.settings import FitSettings, SolveSettings
from cageik_cli.util.arrays import DEFAULT_MEMORY, Floats
from cageik_cli.util.threads import count_processors


class ArrayFrames:
    """An array of frames, (F, m, 3), as a clip."""

    def __init__(self, frames: ArrayLike) -> None:
        self._frames = np.asarray(frames, np.float64)

    def __len__(self) -> int:
        return len(self._frames)

    def read_frame(self, index: int) -> Floats:
        """Return the vertices of a frame, (m, 3), which are finite."""
        return validate_positions(self._frames[index])


def as_frames(clip: MeshSequence | ArrayLike) -> FrameReader:
    """Return a clip, or an array as a clip."""
    return clip if isinstance(clip, MeshSequence) else ArrayFrames(clip)


def fit_weights(
    binding: Binding,
    clips: Sequence[MeshSequence | ArrayLike],
    settings: FitSettings | None = None,
    *,
    solve: SolveSettings | None = None,
    vertex_weights: ArrayLike | Literal["area"] | None = None,
    memory: int = DEFAULT_MEMORY,
    jobs: int | None = None,
) -> FittedWeights:
    """Fit the weights of a binding to one or several clips.

    The fitted binding reproduces the rest pose as the given one does, and the frames of the clips
    several times more closely. The report tells how close it is on frames that were held out.

    Parameters
    ----------
    binding : Binding
        Its weights, harmonic or not, are what the fitted ones are pulled to.
    clips : sequence of MeshSequence or (F, m, 3) arrays
        Frames with the vertices of `binding.rest`, in the same order.
    settings : FitSettings, optional
        How closely to fit, and with how many numbers.
    solve : SolveSettings, optional
        How the cages are solved; as `extract` does by default.
    vertex_weights : (m,) or "area", optional
        Weights of the vertices; 0 marks missing data. Or each vertex counts by its area.
    memory : int
        Limit in bytes for the weights and the frames that they are fitted to, at most 100.
    jobs : int, optional
        Threads; as many as there are processors by default. They do not change the weights.

    Raises
    ------
    CageikError
        When a frame cannot be read or does not fit the binding, the cage is flat, or the solve
        fails.

    Examples
    --------
    >>> from cageik_cli import bind, extract, fit_weights, load_clip, load_mesh
    >>> clip = load_clip("data_fixtures/walker/frames", selection=slice(0, 12))
    >>> binding = bind(clip.first, load_mesh("data_fixtures/walker/cage.obj"), accuracy="preview")
    >>> fitted = fit_weights(binding, [clip])
    >>> before, after = (extract(clip, one).rms_percent for one in (binding, fitted.binding))
    >>> after < 0.5 * before
    True
    """
    weights = make_vertex_weights(vertex_weights, binding.rest)
    sampling = SampleSettings(memory, jobs or count_processors())
    conditions = FitConditions(solve or SolveSettings(), weights, sampling)
    return fitting.fit_weights(binding, list(map(as_frames, clips)), settings, conditions)
