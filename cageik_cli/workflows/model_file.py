"""A model that is to be moved: a mesh, points, or Gaussian splats."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cageik_cli.formats.base.files import decompress, describe_source, file_suffix
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.open import load_mesh
from cageik_cli.formats.ply import Reader as PlyReader
from cageik_cli.formats.ply_points import (
    MOVED,
    PointFile,
    PointWriter,
    SplatWriter,
    holds_splats,
    parse_points,
    read_splats,
)
from cageik_cli.formats.usd.library import USD_SUFFIXES
from cageik_cli.formats.write import Output, WriterFactory
from cageik_cli.geometry.oriented import Oriented, Splats
from cageik_cli.geometry.points import PointCloud
from cageik_cli.util.errors import OutputError, SettingError, error_context
from cageik_cli.util.files import read_input
from cageik_cli.util.progress import ProgressListener, label_note

POINT_SUFFIXES = (".ply", ".npz", ".pc2", ".mdd")
"""What points without faces can be written as."""

SPLAT_SUFFIXES = (".ply", *USD_SUFFIXES)


@dataclass(frozen=True, slots=True, eq=False)
class LoadedModel:
    """A model and where it came from.

    Attributes
    ----------
    mesh : LoadedMesh
        Its vertices; of points and splats a `PointCloud`.
    points : PointFile, optional
        The properties of points.
    splats : Splats, optional
        If the points are Gaussian splats.
    """

    mesh: LoadedMesh
    points: PointFile | None = None
    splats: Splats | None = None

    def choose_output(self, output: Output) -> Output:
        """Return the output with the format of points, where it names none.

        Raises
        ------
        SettingError
            When the model cannot be moved to the origin, as is asked for.
        OutputError
            When its format cannot hold the model.
        """
        if self.points is None:
            return output
        if not output.has_format:
            output = replace(output, file_format="ply")
        known = POINT_SUFFIXES if self.splats is None else SPLAT_SUFFIXES
        if self.splats is not None and output.recentre:
            raise SettingError(
                f"{self.mesh.source['name']}: is {self.kind}, which --recentre cannot move; leave "
                "it out"
            )
        if output.suffix not in known:
            raise OutputError(
                f"{output.path}: a `{output.suffix}` cannot hold {self.mesh.source['name']}, which "
                f"is {self.kind}; write {', '.join(known)}"
            )
        return output

    def check_posed_output(self, path: Path) -> None:
        """Refuse a file of one pose that cannot hold points; raises OutputError."""
        if self.points is not None and path.suffix.lower() != ".ply":
            raise OutputError(
                f"{path}: a `{path.suffix}` cannot hold {self.mesh.source['name']}, which is "
                f"{self.kind}; write a .ply"
            )

    @property
    def oriented(self) -> Oriented | None:
        """What turns with its points; None if nothing does."""
        normals = None if self.points is None else self.points.normals
        if normals is None and self.splats is None:
            return None
        return Oriented(normals, self.splats)

    @property
    def kind(self) -> str:
        """What it is, in words."""
        if self.points is None:
            return "a mesh"
        return "a cloud of points" if self.splats is None else "a file of Gaussian splats"

    @property
    def parts(self) -> str:
        """What it consists of, in words."""
        if self.points is None:
            return "vertices"
        return "points" if self.splats is None else "splats"

    def note(self, progress: ProgressListener) -> Callable[[str], None]:
        """Return what takes notes on the model."""

        def take(text: str) -> None:
            label, text = label_note(text)
            progress.note(label, f"{self.mesh.source['name']}: {text}")

        return take

    def make_rest_rows(self) -> NDArray[Any]:
        """Return rows of the points at rest, which frames are made from; of splats, whole ones."""
        assert self.points is not None
        rows = self.points.rows
        return rows if self.splats is not None else np.zeros(len(rows), MOVED)

    def choose_writer(self, output: Output) -> WriterFactory | None:
        """Return what makes the writer of the model; None for the usual one of the format."""
        if self.points is None or (self.splats is None and output.suffix != ".ply"):
            return None
        if self.splats is None:
            return partial(PointWriter, points=self.points)
        if output.suffix != ".ply":
            from cageik_cli.formats.usd.splats import UsdSplatWriter

            return partial(UsdSplatWriter, points=self.points)
        return partial(SplatWriter, points=self.points)


def load_model(path: Path) -> LoadedModel:
    """Read a mesh, points without faces (.ply), or Gaussian splats (.ply).

    Raises
    ------
    FileAccessError, FormatError
        Naming the file, when it is missing, damaged, or of an unknown format.
    """
    suffix = file_suffix(path)
    if suffix not in PlyReader.suffixes or path.is_dir():
        return LoadedModel(load_mesh(path))
    with error_context(path):
        data = read_input(path)
        points = parse_points(decompress(data, suffix))
    if points is None:
        return LoadedModel(load_mesh(path))
    with error_context(path):
        splats = read_splats(points) if holds_splats(points) else None
        cloud = PointCloud.from_points(points.positions)
        mesh = LoadedMesh(cloud, describe_source(path, data), points.notes)
        return LoadedModel(mesh, points, splats)
