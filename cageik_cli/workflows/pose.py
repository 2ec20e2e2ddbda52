"""From a model in its cage and a file of handles to the pose that they mean."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cageik_cli.coordinates.binding import Binding
from cageik_cli.formats.base.file_names import kind_of
from cageik_cli.formats.base.hdf5 import SUFFIXES as HDF5_SUFFIXES
from cageik_cli.formats.mesh_file import MESH_SUFFIXES, load_mesh, prepare_mesh, write_mesh
from cageik_cli.formats.open import clip_suffixes
from cageik_cli.formats.scene import Scene
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
from cageik_cli.store.binding_file import read_binding
from cageik_cli.util.errors import InputError, located
from cageik_cli.util.outputs import keep_apart
from cageik_cli.util.progress import Observer
from cageik_cli.util.threads import blas_threads
from cageik_cli.workflows.bind import WeightSettings, made


@dataclass(frozen=True, slots=True)
class PoseSettings:
    """What to pose, and where to write it.

    Attributes
    ----------
    target : Path
        A rest model, or a binding file.
    handles : Path
    output : Path
        The posed model: .obj or .ply.
    cage : Path, optional
        Needed for a rest model.
    cage_output : Path, optional
        The posed cage: .obj or .ply.
    posing : PosingSettings
    weights : WeightSettings
    overwrite : bool
    """

    target: Path
    handles: Path
    output: Path
    cage: Path | None = None
    cage_output: Path | None = None
    posing: PosingSettings = field(default_factory=PosingSettings)
    weights: WeightSettings = field(default_factory=WeightSettings)
    overwrite: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Bound:
    """A model in its cage, and what their files say beside.

    Attributes
    ----------
    binding : Binding
    text, cage_text : bytes
        The OBJ files of the model and of the cage, as `Animation` has them.
    """

    binding: Binding
    text: bytes = b""
    cage_text: bytes = b""


def pose(settings: PoseSettings, observer: Observer | None = None) -> Posed:
    """Pose a model by handles, and write it.

    Raises
    ------
    InputError
        Naming the file at fault and what to do.
    NumericalError
        When the weights cannot be trusted, or hard handles cannot all be met.
    """
    watch = observer or Observer()
    _prepare(settings)
    with watch.stage("open"):
        handles = read_handles(settings.handles)
    with watch.stage("bind"):
        bound = _bound(settings, watch)
    binding = bound.binding
    cage = binding.cage.vertices
    clip = Clip(binding, Skin.at_rest(binding), lambda _: cage, None)
    # One thread: the last digits depend on how many.
    with watch.stage("pose"), located(settings.handles), blas_threads(1):
        layers = layers_of(handles, clip, settings.posing)
        block = edited_block(layers, clip, np.zeros(1, np.int64), cage[None])
    remark_layers(layers, settings.handles, watch)
    with watch.stage("write"):
        _write(settings, bound, block)
    ledger = PoseLedger(layers, binding.rest.diagonal)
    ledger.take(block)
    return Posed(ledger.figures([]), Snapshot("", layers, block, clip), Scene().up_axis)


def remark_layers(layers: Sequence[Layer], handles: Path, watch: Observer) -> None:
    """Say what there is to know of how handles were taken."""
    for layer in layers:
        for note in layer.drag.notes:
            watch.remark("note", f"{handles.name}: {note}")


def _prepare(settings: PoseSettings) -> None:
    _refuse_animation(settings.target)
    outputs = [settings.output, settings.cage_output]
    keep_apart(outputs, [settings.target, settings.cage, settings.handles])
    for path in outputs:
        if path is not None:
            prepare_mesh(path, settings.overwrite)


def _refuse_animation(target: Path) -> None:
    """Refuse frames whose cages are not known yet."""
    of_models = {*MESH_SUFFIXES, *HDF5_SUFFIXES}
    if target.is_dir() or kind_of(target) in {*clip_suffixes()} - of_models:
        what = "a folder" if target.is_dir() else f"a clip (`{kind_of(target)}`)"
        raise InputError(
            f"{target}: is {what}, expected a model, a binding or a result; to edit an animation, "
            "extract its cages first (cageik extract) and pose that result"
        )


def _bound(settings: PoseSettings, watch: Observer) -> _Bound:
    """The weights of the binding file that was named, or of the model in the cage."""
    if settings.target.suffix.lower() in HDF5_SUFFIXES:
        return _Bound(read_binding(settings.target).binding)
    if settings.cage is None:
        raise InputError(f"{settings.target}: is a model without a cage; name one with --cage")
    rest, cage = load_mesh(settings.target), load_mesh(settings.cage)
    with located(settings.cage):
        binding = made(rest, cage, settings.weights, watch).binding
    for mesh, notes in ((rest, rest.notes), (cage, binding.notes)):
        for note in notes:
            watch.remark("note", f"{mesh.source['name']}: {note}")
    return _Bound(binding, rest.text, cage.text)


def _write(settings: PoseSettings, bound: _Bound, block: EditedBlock) -> None:
    """Write the posed model, and the cage if it is asked for."""
    rest, cage, overwrite = bound.binding.rest, bound.binding.cage, settings.overwrite
    write_mesh(settings.output, rest, block.edited[0], overwrite, bound.text)
    if settings.cage_output is not None:
        write_mesh(settings.cage_output, cage, block.edit.cages[0], overwrite, bound.cage_text)
