"""What a run is given: its settings, and what it reads before the first frame is solved."""

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.coordinates.binding import BindSettings
from cageik_cli.formats.base.sequence import ClipSettings, MeshSequence
from cageik_cli.formats.mesh_file import LoadedMesh, load_mesh
from cageik_cli.formats.open import open_clip_and_rest
from cageik_cli.formats.scene import Scene, SceneHints
from cageik_cli.formats.vertex_weights import load_vertex_weights
from cageik_cli.solver.dual_laplacian import SolveSettings, normalize_weights
from cageik_cli.store.binding_file import StoredBinding
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import InputError, error_context
from cageik_cli.util.progress import ProgressListener
from cageik_cli.workflows.bind import WeightSettings, bind_cached, load_matching_binding


@dataclass(frozen=True, slots=True)
class ExtractSettings:
    """What to extract, from what, to where.

    Attributes
    ----------
    frames : tuple of str
        Files, folders and globs, or one file that holds a clip.
    cage : Path, optional
        Needed unless there is a binding.
    output : Path
    binding : Path, optional
        A binding file of this rest pose, and of `cage` if that is given; `bind` then says nothing.
    cache : Path, optional
        The folder of the cache of weights; none is used if absent.
    rest : Path, optional
        The rest pose; a frame of the clip if absent.
    rest_frame : int
        Which frame then, from 0.
    vertex_weights : Path, optional
        One number a vertex of the model.
    bind : BindSettings
    solve : SolveSettings
    clip : ClipSettings
        Which frames of what was named, and how they are to be taken.
    overwrite, keep_weights : bool
    resume : bool
        Go on where an interrupted run of the same plan ended; begin if there is none.
    on_bad_frame : str
        "stop", or "skip": leave a gap for a frame that cannot be read, and say so.
    scene : SceneHints
        Time and space, where they are not to be as the clip's files say.
    memory : int
        Bytes that the weights and blocks of frames may take.
    jobs : int
        Threads.
    """

    frames: tuple[str, ...]
    cage: Path | None
    output: Path
    binding: Path | None = None
    cache: Path | None = None
    rest: Path | None = None
    rest_frame: int = 0
    vertex_weights: Path | None = None
    bind: BindSettings = field(default_factory=BindSettings)
    solve: SolveSettings = field(default_factory=SolveSettings)
    clip: ClipSettings = field(default_factory=ClipSettings)
    overwrite: bool = False
    resume: bool = False
    on_bad_frame: str = "stop"
    keep_weights: bool = True
    scene: SceneHints = field(default_factory=SceneHints)
    memory: int = 1 << 30
    jobs: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """What was read before the first frame is solved.

    Attributes
    ----------
    sequence : MeshSequence
    rest : LoadedMesh
    cage : LoadedMesh, optional
        None when it comes with a binding.
    stored_binding : StoredBinding, optional
        That of the binding file, if one is named.
    vertex_weights : (m,) float64, optional
        Of mean one.
    sources : dict
        Name and digest of each file that was read, all but the frames.
    """

    sequence: MeshSequence
    rest: LoadedMesh
    cage: LoadedMesh | None
    stored_binding: StoredBinding | None
    vertex_weights: Floats | None
    sources: dict[str, Any]

    def choose_bind_settings(self, settings: ExtractSettings) -> BindSettings:
        """Those of the binding file, or those asked for."""
        return (
            settings.bind if self.stored_binding is None else self.stored_binding.binding.settings
        )

    def compute_weights_key(self, settings: ExtractSettings) -> str:
        """A digest of what the weights come from: runs of one key may share a `StoredBinding`.

        The name of the rest pose's file is not of it, for the frames of two clips have different
        names; nor are the threads.
        """
        shared = {name: self.sources[name] for name in ("cage", "binding") if name in self.sources}
        recorded = asdict(self.choose_bind_settings(settings)) | shared
        digest = hashlib.sha256(json.dumps(recorded, sort_keys=True).encode())
        for array in (self.rest.mesh.vertices, self.rest.mesh.faces):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()


def open_inputs(settings: ExtractSettings, stored_binding: StoredBinding | None = None) -> Inputs:
    """Open the clip, and read what is named beside it; not the binding file again if it is known.

    Raises
    ------
    InputError
        Naming the file at fault.
    """
    sequence, rest = open_clip_and_rest(
        settings.frames, settings.clip, settings.rest, settings.rest_frame
    )
    cage = load_mesh(settings.cage) if settings.cage is not None else None
    if settings.binding is not None:
        stored_binding = stored_binding or load_matching_binding(settings.binding, rest, cage)
        sources = stored_binding.sources | {"rest": rest.source}
    else:
        stored_binding, sources = None, {"rest": rest.source}
        if cage is not None:
            sources["cage"] = cage.source
    weights = None
    if settings.vertex_weights is not None:
        loaded, sources["vertex_weights"] = load_vertex_weights(settings.vertex_weights)
        with error_context(settings.vertex_weights):
            weights = normalize_weights(loaded, len(rest.mesh.vertices))
    return Inputs(sequence, rest, cage, stored_binding, weights, sources)


def resolve_scene(settings: ExtractSettings, inputs: Inputs) -> Scene:
    """Time and space: as asked, else as the clip says, else as usual."""
    return settings.scene.override(inputs.sequence.scene.override(Scene()))


def load_or_compute_binding(
    inputs: Inputs, settings: ExtractSettings, progress: ProgressListener
) -> StoredBinding:
    """The weights: of the file that was named, out of the cache, or computed."""
    rest = inputs.rest
    if inputs.stored_binding is not None:
        progress.update(len(rest.mesh.vertices), len(rest.mesh.vertices))
        return inputs.stored_binding
    if inputs.cage is None:
        raise InputError("neither a cage nor a binding is given, expected one of them")
    with error_context(settings.cage):
        weight_settings = WeightSettings(settings.bind, settings.cache, settings.jobs)
        return bind_cached(rest, inputs.cage, weight_settings, progress)
