"""The meshes that a cage moves in place of its own model: brought into its scene, or refused.

Of several, which are joined to one model, the one that does not fit is named.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from cageik_cli.cages.check.enclosure import OutsideError, check_enclosure
from cageik_cli.cages.check.misfit import MAX_SIZE_RATIO, UNIT_SCALES, Transform, find_transform
from cageik_cli.formats.base.choose_parts import drop_parts, list_unmatched
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.settings import SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.model_file import LoadedModel, load_models
from cageik_cli.inputs.pose_difference import MIN_CLEAR_RATIO
from cageik_cli.inputs.scene import CommonScene
from cageik_cli.util.errors import FormatError, SettingError, error_context
from cageik_cli.util.messages import Note, Said, say

MAX_BOX_SLACK = 0.1
"""A mesh that is where a model is leaves its bounding box by at most this, in diagonals."""


class MovedMeshes:
    """Meshes in files, which the cage of a result or a binding moves.

    Parameters
    ----------
    common : CommonScene
        That of the cage.
    exclude : sequence of str
        Patterns of parts of meshes that are left out.

    Attributes
    ----------
    unmatched : sequence of str
        The patterns that match no part of the meshes that were read.
    """

    def __init__(self, common: CommonScene, exclude: Sequence[str] = ()) -> None:
        self.unmatched = self._exclude = exclude
        self._common = common
        self._placed: list[tuple[LoadedMesh, SceneHints]] = []

    def load(self, paths: Sequence[Path]) -> LoadedModel:
        """Read the meshes as one model, in the scene of the cage; raises as `load_models`."""
        return load_models(paths, self._place)

    def _leave_out(self, given: LoadedModel) -> LoadedModel:
        if given.points is not None or not self._exclude:
            return given
        self.unmatched = list_unmatched(given.mesh.mesh, self.unmatched)
        with error_context(given.name):
            mesh, notes = drop_parts(given.mesh.mesh, self._exclude)
        return LoadedModel(
            replace(given.mesh, mesh=mesh, notes=(*given.mesh.notes, *map(Note, notes)))
        )

    def _place(self, given: LoadedModel) -> LoadedModel:
        given = self._leave_out(given)
        placed = self._common.place(given.mesh)
        self._placed.append((placed, given.mesh.scene))
        if given.points is None or placed is given.mesh:
            return LoadedModel(placed, given.points, given.splats)
        raise SettingError(
            f"{given.name}: is {given.kind}, which cannot be converted; "
            + say("leave out `given_in=`, and export it as the result was")
        )

    @contextmanager
    def explain_outside(self, cage: TriMesh, outside: str) -> Iterator[None]:
        """Say which mesh is outside the cage, which is not made for it, and what to do with it."""
        try:
            yield
        except OutsideError as error:
            if len(self._placed) == 1:
                raise self._explain(error, *self._placed[0]) from error
            for mesh, source in self._placed:
                self._check_one(cage, outside, mesh, source)
            raise

    def _check_one(self, cage: TriMesh, outside: str, mesh: LoadedMesh, source: SceneHints) -> None:
        """Refuse one of several meshes that is outside the cage."""
        with error_context(mesh.source["name"]):
            try:
                check_enclosure(cage, mesh.mesh, outside)
            except OutsideError as error:
                raise self._explain(error, mesh, source) from error

    def _explain(self, error: OutsideError, mesh: LoadedMesh, source: SceneHints) -> OutsideError:
        """Return the error of a mesh that is outside, with what to do with it."""
        placement, misfit = error.placement, error.misfit
        if placement is None or misfit is None:
            return error
        remedy: Said = "move it into the rest cage"
        transform = misfit.transform
        if not placement.is_misplaced:
            remedy += say(", or take the nearest points of the cage with `outside=project`")
        if transform is not None and not transform.is_scaled:
            remedy = "it " + self._describe(transform.invert(), source, mesh.mesh.diagonal)
        return OutsideError(f"{placement.describe_outside()}; " + remedy)

    def check_small(self, cage: TriMesh, model: TriMesh) -> None:
        """Refuse a mesh in the cage that is small because it is in a larger unit.

        It is in another unit if the cage holds it closely in that, or if it is about as large as
        the model of the cage in that, and in its place; a small thing at its own place is neither.
        """
        for mesh, source in self._placed:
            transform = find_transform(cage, mesh.mesh)
            found = _find_unit_by_box(mesh.mesh, model) if transform is None else transform.invert()
            if found is None:
                continue
            why = self._describe(found, source, mesh.mesh.diagonal)
            raise FormatError(why if len(self._placed) == 1 else f"{mesh.source['name']}: " + why)

    def _describe(self, transform: Transform, source: SceneHints, diagonal: float) -> Said:
        """Say how a mesh that a transform brings into the cage is wrong, and what to type."""
        name, options = transform.describe(diagonal), self._common.offer(transform, source)
        return f"is {name}, as the cage shows; export it as the result was" + options


def _find_unit_by_box(mesh: TriMesh, model: TriMesh) -> Transform | None:
    """Return the unit in which a mesh that is much smaller than a model is where the model is."""
    if mesh.diagonal > model.diagonal / MAX_SIZE_RATIO:
        return None
    slack = MAX_BOX_SLACK * model.diagonal
    low, high = model.vertices.min(axis=0) - slack, model.vertices.max(axis=0) + slack
    for scale in UNIT_SCALES:
        points = scale * mesh.vertices
        is_within = (points >= low).all() and (points <= high).all()
        if scale >= MIN_CLEAR_RATIO and is_within and scale * mesh.diagonal > model.diagonal / 2:
            return Transform(np.eye(3), scale, np.zeros(3))
    return None
