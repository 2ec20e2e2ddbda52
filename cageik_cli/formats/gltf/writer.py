"""A mesh animation as glTF: the rest pose, few morph targets, and a track of their weights."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from cageik_cli.formats.base.writer import Animation, AnimationWriter, to_float32
from cageik_cli.formats.gltf.glb_file import (
    MAX_FILE_BYTES,
    GlbFile,
    describe_excess,
    require_pygltflib,
)
from cageik_cli.formats.gltf.morphs import (
    EXACT_TOL,
    Modes,
    MorphError,
    choose_modes,
    compute_modes,
)
from cageik_cli.formats.gltf.placement import check_start, compute_times, make_node_transform
from cageik_cli.formats.gltf.surface import Part, cut_surface
from cageik_cli.formats.gltf.vector_spool import VectorSpool
from cageik_cli.util.arrays import Floats
from cageik_cli.util.errors import OutputError
from cageik_cli.util.text import format_count
from cageik_cli.util.threads import limit_blas_threads


class Writer(AnimationWriter):
    """The rest pose plus weights times morph targets is each frame, to an error that is noted.

    The targets are the singular vectors of the displacements from the rest pose, in float32. The
    track has their weights at each frame's number / fps seconds, linear between. Normals are those
    of the rest pose, and targets of normals that are fitted to the frames' by least squares.
    """

    suffixes = (".glb",)
    is_single = True

    @classmethod
    def require_libraries(cls) -> None:
        """Raise MissingLibraryError without pygltflib."""
        require_pygltflib()

    def __init__(self, target: Path, animation: Animation) -> None:
        self._animation, self._settings = animation, animation.morphs
        self.notes = check_start(animation.scene)
        self._surface = cut_surface(animation.rest, self._settings.has_normals)
        self._check_size()
        self._rest = to_float32(animation.rest.vertices).astype(np.float64)
        self._rest_normals = self._surface.compute_normals(self._rest)
        with ExitStack() as stack:
            self._file = GlbFile(target)
            stack.callback(self._file.close)
            count = len(self._surface.origins)
            self._moves = VectorSpool(target.parent, count)
            stack.callback(self._moves.close)
            self._turns = VectorSpool(target.parent, count)
            stack.callback(self._turns.close)
            self._open = stack.pop_all()

    def append(self, frames: Floats) -> None:
        """Keep the next frames."""
        origins = self._surface.origins
        for positions in frames:
            self._moves.append(to_float32(positions - self._rest)[origins])
            if self._settings.has_normals:
                turns = self._surface.compute_normals(positions) - self._rest_normals
                self._turns.append(turns.astype(np.float32))

    def complete(self) -> None:
        """Compute the targets, and compose the file."""
        with limit_blas_threads(1):  # the last digits depend on how many
            modes, error = self._choose_modes()
            parts = [self._write_part(part, modes) for part in self._surface.parts]
        track = self._write_track(modes)
        self._compose(parts, track, modes, error)
        self._open.close()

    def abandon(self) -> None:
        """Close the temporary files."""
        self._open.close()

    def _check_size(self) -> None:
        """Refuse what is too large with as many targets as are allowed, if that is known."""
        settings = self._settings
        least = 1 if settings.tolerance is not None else settings.limit
        count = 1 + min(least, self._animation.frame_count)
        size = 12 * count * len(self._surface.origins) * (2 if settings.has_normals else 1)
        if size > MAX_FILE_BYTES:
            raise OutputError(describe_excess(size))

    def _choose_modes(self) -> tuple[Modes, MorphError]:
        """Return the targets, note their error, and refuse one above the tolerance."""
        settings, unit = self._settings, self._animation.rest.diagonal / 100
        wanted = 100 * EXACT_TOL if settings.tolerance is None else settings.tolerance
        modes = compute_modes(self._moves, settings.limit)
        modes, found = choose_modes(self._moves, modes, wanted * unit)
        error = MorphError(found.rms / unit, found.largest / unit)
        text = format_count(modes.count, "morph target")
        if settings.tolerance is not None and error.largest > settings.tolerance:
            raise OutputError(
                f"{text} leave a largest error of {error.largest:.2g} % of the diagonal, above the "
                f"tolerance of {settings.tolerance:g} %; give a higher --tolerance"
                + ("" if settings.count is None else " or more --morphs")
                + ", or write .usdc, .abc or .pc2"
            )
        self.notes += (f"{text}; {_describe_error(error)}",)
        return modes, error

    def _write_part(self, part: Part, modes: Modes) -> Any:
        """Write the vertices, targets and triangles of one material; return its primitive."""
        import pygltflib as gltf

        count = part.stop - part.start
        places = self._rest[self._surface.origins]
        kinds = {"POSITION": (self._moves, places, modes.compute_targets)}
        if self._settings.has_normals:
            kinds["NORMAL"] = (self._turns, self._rest_normals, modes.fit_targets)
        attributes, targets = {}, []
        for name, (spool, base, compute) in kinds.items():
            is_place = name == "POSITION"
            rows = base[part.start : part.stop].astype(np.float32)
            attributes[name] = self._file.add_array(rows, gltf.ARRAY_BUFFER, bounds=is_place)
            written = self._file.reserve_targets(modes.count, count)
            for first, block in spool.read_blocks(part.start, part.stop):
                self._file.write_targets(written, first - part.start, compute(block))
            targets.append(self._file.add_targets(written, bounds=is_place))
        primitive = self._surface.make_primitive(self._file, part, attributes)
        primitive.targets = [
            gltf.Attributes(**dict(zip(kinds, numbers, strict=True)))
            for numbers in zip(*targets, strict=True)
        ]
        return primitive

    def _write_track(self, modes: Modes) -> Any:
        """Write the weights of all frames, and return their animation."""
        import pygltflib as gltf

        times = self._file.add_array(compute_times(self._animation), bounds=True)
        weights = self._file.add_array(modes.weights.ravel())
        channel = gltf.AnimationChannel(
            sampler=0, target=gltf.AnimationChannelTarget(node=0, path="weights")
        )
        sampler = gltf.AnimationSampler(input=times, output=weights)
        return gltf.Animation(name=self._animation.name, channels=[channel], samplers=[sampler])

    def _compose(self, parts: list[Any], track: Any, modes: Modes, error: MorphError) -> None:
        import pygltflib as gltf

        name, count = self._animation.name, modes.count
        extras = {
            "targetNames": [f"morph_{k:03d}" for k in range(count)],
            "cageik": {
                "morphs": count,
                "rms_percent": float(f"{error.rms:.3g}"),
                "largest_percent": float(f"{error.largest:.3g}"),
            },
        }
        transform = make_node_transform(self._animation.scene)
        self._file.complete(
            scene=0,
            scenes=[gltf.Scene(nodes=[0])],
            nodes=[gltf.Node(name=name, mesh=0, **transform)],
            meshes=[gltf.Mesh(name=name, primitives=parts, weights=[0.0] * count, extras=extras)],
            materials=self._surface.make_materials(),
            animations=[track],
        )


def _describe_error(error: MorphError) -> str:
    """Return the error, in percent of the diagonal, for a note."""
    if error.largest <= 100 * EXACT_TOL:
        return "exact to single precision"
    return f"error: rms {error.rms:.2g}, largest {error.largest:.2g} % of the diagonal"
