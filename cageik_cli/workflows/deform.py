"""The cage animation of a result, applied to its rest model or to another mesh in the cage."""

import re
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cageik_cli.coordinates.binding import GROUP, Binding, BindSettings, rebuilt
from cageik_cli.formats.base.connectivity import refuse_other_order
from cageik_cli.formats.base.sequence import ClipSettings, MeshSequence
from cageik_cli.formats.base.writer import Animation
from cageik_cli.formats.mesh_file import LoadedMesh, load_mesh
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.scene import SceneHints
from cageik_cli.formats.write import Output, Written, write_animation
from cageik_cli.store.result import Result, read_cages, read_result, read_weights
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import located
from cageik_cli.util.progress import Observer
from cageik_cli.util.threads import blas_threads
from cageik_cli.workflows.bind import WeightSettings, made
from cageik_cli.workflows.export import remark_gaps

LARGEST_BLOCK = 16
"""Frames to a block at most, a few groups; nothing is gained from more."""

ARRAYS_PER_FRAME = 4
"""Arrays (m, 3) that a frame has at once: of its group, of its block, as the writer has it."""


@dataclass(frozen=True, slots=True)
class DeformSettings:
    """What to deform by which cages, and where to write it.

    Attributes
    ----------
    result : Path
    output : Output
    mesh : Path, optional
        Bound to the rest cage; the rest model if absent.
    coordinates, accuracy, outside : str, optional
        As in `BindSettings`; those of the result if absent.
    cages : str, optional
        A clip of cages to take instead of the result's own.
    clip : ClipSettings
        How that clip is taken.
    scene : SceneHints
        Time and space, where they are not to be the clip's or the result's.
    cache : Path, optional
        The folder of the cache of weights; none is used if absent.
    memory : int
        Bytes that the weights and blocks of frames may take.
    jobs : int
        Threads.
    """

    result: Path
    output: Output
    mesh: Path | None = None
    coordinates: str | None = None
    accuracy: str | None = None
    outside: str | None = None
    cages: str | None = None
    clip: ClipSettings = field(default_factory=ClipSettings)
    scene: SceneHints = field(default_factory=SceneHints)
    cache: Path | None = None
    memory: int = 1 << 30
    jobs: int = 1


def deform(settings: DeformSettings, observer: Observer | None = None) -> Written:
    """Write the animation of the mesh that the cages move.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the weights cannot be trusted.
    """
    watch = observer or Observer()
    settings.output.prepare()
    result = read_result(settings.result)
    clip = _clip(settings, result, watch)
    mesh = load_mesh(settings.mesh) if settings.mesh is not None else _rest_model(result)
    binding = _binding(settings, mesh, result, watch)
    scene = result.scene if clip is None else clip.scene.applied(result.scene)
    animation = Animation(
        rest=binding.rest,
        count=len(result.frames) if clip is None else len(clip),
        scene=settings.scene.applied(scene),
        name=_object_name(settings.mesh),
        text=mesh.text,
    )
    size = block_size(settings.memory - binding.weights.nbytes, len(binding.rest.vertices))
    if clip is None:
        remark_gaps(result, watch)
    cages = read_cages(result, size) if clip is None else _cages(clip, size, settings.jobs)
    frames = (rebuilt(binding.weights, block) for block in cages)
    # One thread: the last digits depend on how many, and the writer takes longer anyway.
    with blas_threads(1):
        return write_animation(settings.output, animation, frames, watch)


def block_size(memory: int, vertices: int) -> int:
    """Frames to a block of whole groups, such that it takes no more than `memory` bytes.

    One group at least.
    """
    groups = memory // (ARRAYS_PER_FRAME * 24 * vertices * GROUP)
    return GROUP * int(np.clip(groups, 1, LARGEST_BLOCK // GROUP))


def _clip(settings: DeformSettings, result: Result, watch: Observer) -> MeshSequence | None:
    """The cages that are not the result's own, of its connectivity."""
    if settings.cages is None:
        return None
    clip = open_sequence([settings.cages], settings.clip, _rest_cage(result))
    with located(settings.cages):
        refuse_other_order(clip, result.cage, "the result's cage")
    for note in clip.notes:
        watch.remark("note", note)
    return clip


def _cages(clip: MeshSequence, size: int, jobs: int) -> Iterator[Floats]:
    with closing(clip.blocks(size, jobs)) as blocks:
        for block in blocks:
            block.refuse_faults()
            yield block.positions


def _binding(
    settings: DeformSettings, mesh: LoadedMesh, result: Result, watch: Observer
) -> Binding:
    """What ties the mesh to the rest cage: the result's own weights where these are asked for."""
    own = _own_settings(result)
    asked = BindSettings(
        settings.coordinates or own.coordinates,
        settings.accuracy or own.accuracy,
        settings.outside or own.outside,
    )
    weights = read_weights(result) if settings.mesh is None and asked == own else None
    if weights is not None:
        return Binding(result.rest, result.cage, weights, own)
    how = WeightSettings(asked, settings.cache, settings.jobs)
    with watch.stage("bind"), located(settings.mesh or settings.result):
        binding = made(mesh, _rest_cage(result), how, watch).binding
    for note in mesh.notes + binding.notes:
        watch.remark("note", f"{mesh.source['name']}: {note}")
    return binding


def _own_settings(result: Result) -> BindSettings:
    with located(result.path):
        names = ("coordinates", "accuracy", "outside")
        return BindSettings(**{name: str(result.settings.get(name)) for name in names})


def _rest_cage(result: Result) -> LoadedMesh:
    return LoadedMesh(result.cage, result.cage, {"name": f"the cage of {result.path.name}"})


def _rest_model(result: Result) -> LoadedMesh:
    return LoadedMesh(result.rest, result.rest, {"name": f"the rest pose of {result.path.name}"})


def _object_name(mesh: Path | None) -> str:
    """What formats may call the object: the mesh's name, as far as they all take it."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", mesh.stem) if mesh is not None else "mesh"
    return f"_{name}" if name[0].isdigit() else name
