"""The one scene of a run: what is given beside a clip, or a result, is brought into it, or refused.

Where both sides state unit and up axis, meshes and clips are converted. Where one does not, they
are taken as they stand, and refused if they then fit another unit or up axis. Of several meshes
that are joined to one model, the one that does not fit is named.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import isclose
from pathlib import Path

from cageik_cli.cages.check.enclosure import OutsideError, check_enclosure
from cageik_cli.cages.transform import (
    Transform,
    find_pose_transform,
    find_small_unit,
    find_transform,
)
from cageik_cli.formats.base.choose_parts import drop_parts, list_unmatched
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.source import LoadedModel, load_models, load_rest, load_source
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import FormatError, InputError, SettingError, error_context
from cageik_cli.util.messages import Hint, Note, Said, join_texts, say
from cageik_cli.util.units import (
    PROGRAM_UNITS,
    SAME_UNIT_TOL,
    UNIT_LENGTHS,
    find_unit,
)

UNSTATED = SceneHints()
"""What a file states of its scene that states nothing."""


class CommonScene:
    """Unit and up axis of a run, as far as they are known, and what is brought into them.

    Parameters
    ----------
    stated : SceneHints
        What is known of the clip or the result: its file's statement, or the user's.
    given_in : SceneHints
        What the user says of what is given beside it.
    is_shared : bool
        Whether that is said of several files: what one states then comes before it. Of one file,
        it comes before what the file states.
    can_restate : bool
        Whether the user can state the unit and the axis of the clip or the result in this run.

    Attributes
    ----------
    hints : SceneHints
        Unit and up axis; where the clip states none, those of the first mesh that does.
    """

    def __init__(
        self,
        stated: SceneHints = UNSTATED,
        given_in: SceneHints = UNSTATED,
        *,
        is_shared: bool = False,
        can_restate: bool = False,
    ) -> None:
        self.hints = self._stated = _keep_space(stated)
        self._given_in, self._is_shared, self._can_restate = given_in, is_shared, can_restate

    @staticmethod
    def of_clip(
        stated: SceneHints, given_in: SceneHints, beside: Collection[Path | None]
    ) -> "CommonScene":
        """Return the scene of a clip, as far as the user says it.

        `beside` are the meshes that are given beside the clip; None for those that are not.
        """
        return CommonScene(stated, given_in, is_shared=None not in beside, can_restate=True)

    def state(self, hints: SceneHints) -> None:
        """Take what a clip states, where nothing is stated yet."""
        self._stated = self._stated.over(_keep_space(hints))
        self.hints = self.hints.over(_keep_space(hints))

    def open_rest(self, path: Path, exclude: Sequence[str] = ()) -> LoadedMesh:
        """Read a rest pose, whose scene rules; raises as `load_rest`."""
        rest = load_rest(path, exclude)
        self.state(rest.scene)
        return rest

    def open_cage(self, path: Path) -> LoadedMesh:
        """Read a cage, and bring it into this scene; raises as `load_source`."""
        return self.place(load_source(path, "cage"))

    def place(self, loaded: LoadedMesh) -> LoadedMesh:
        """Return a mesh in this scene, with a note if it was converted."""
        return self.find_conversion(loaded.scene).convert_loaded(loaded)

    def find_conversion(self, scene: SceneHints) -> SceneConversion:
        """Return the conversion of what has a scene; adopt what is not stated yet."""
        given, wanted = self._find_both(scene)
        self.hints = wanted.over(given)
        return SceneConversion.between(given, wanted)

    def _find_both(self, scene: SceneHints) -> tuple[SceneHints, SceneHints]:
        """Return what is known of a given mesh, and of the scene that it is to be in.

        If the user says what it is in, the scene is the usual one where none is known.
        """
        said, usual, stated = self._given_in, Scene(), _keep_space(scene)
        unit = None if said.metres_per_unit is None else usual.metres_per_unit
        axis = None if said.up_axis is None else usual.up_axis
        given = stated.over(said) if self._is_shared else said.over(stated)
        wanted = self.hints.over(SceneHints(up_axis=axis, metres_per_unit=unit))
        return given, wanted

    def place_rest(self, rest: LoadedMesh, clip: MeshSequence) -> LoadedMesh:
        """Return the rest pose of a clip in this scene; refuse one of another unit or other axes.

        It has a warning if it is likely turned, or of another size for no reason that is known.
        """
        rest = self.place(rest)
        pairs = ((rest.mesh.vertices, frame) for _, frame in read_some_frames(clip))
        transform = find_pose_transform(pairs, rest.mesh.edges.ends)
        beside = f"those of {clip.names[0]}"
        otherwise = "" if clip.needs_rest else say("leave out `rest=`, or ")
        warning = self._judge(transform, rest.scene, beside, "the clip", otherwise)
        return replace(rest, notes=(*rest.notes, *warning))

    def match_clip(
        self,
        clip: MeshSequence,
        name: str,
        mesh: TriMesh,
        *,
        beside: str,
        other: str,
        read_expected: Callable[[int], Floats] | None = None,
    ) -> MeshSequence:
        """Return a clip of a mesh in this scene; refuse one of another unit, or with other axes.

        Parameters
        ----------
        name : str
            Of the clip, for its notes.
        mesh : TriMesh
            In this scene.
        beside, other : str
            What messages call the edges of the mesh, and what it is of.
        read_expected : callable, optional
            Reads the positions (n, 3) that a frame of the clip is an edit of.
        """
        placed = self.find_conversion(clip.scene).convert_clip(clip, name)
        read = read_expected or (lambda _: mesh.vertices)
        pairs = ((given, read(index)) for index, given in read_some_frames(placed))
        is_paired = read_expected is not None
        transform = find_pose_transform(pairs, mesh.edges.ends, is_paired=is_paired)
        warnings = self._judge(transform, clip.scene, beside, other)
        placed.notes += tuple(warning.at(name) for warning in warnings)
        return placed

    def offer(self, transform: Transform | None, stated: SceneHints) -> Said:
        """Return the options in place of a transform, to end a sentence; empty if none do.

        `stated` is what the file states of the scene of what has to be transformed.
        """
        if transform is None or transform.is_fitted:
            return ""
        if transform.is_turned and transform.up_axes is None:
            return ""
        options = self._list_options(stated, transform)
        return ", or state it by " + options if options else ""

    def _judge(
        self,
        transform: Transform | None,
        stated: SceneHints,
        beside: str,
        other: str,
        otherwise: Said = "",
    ) -> tuple[Note, ...]:
        """Refuse poses that certainly need a transform; return a warning of those that may."""
        if transform is None:
            return ()
        name, seen = transform.scene_name, transform.describe_poses(beside)
        if not name:
            seen += ", which no unit explains; errors are percent of it"
            return (Note(seen, "warning"),)
        options = self._list_options(stated, transform)
        remedy = otherwise + f"export it as {other} was"
        if options:
            shared = " (if the cage is so, too)" * self._is_shared
            remedy = otherwise + "state it by " + options
            remedy += f"{shared}, or export it as {other} was"
        elif self._is_shared:
            remedy += say(
                "; `given_in=` is for files that do not state it, where there are several"
            )
        if not transform.is_certain:
            return (Note(f"is likely {name}; if so, " + remedy, "warning"),)
        if self._is_meant(stated, transform):
            why = f"looks as if it is {name}: {seen}; " + say("it is taken as `given_in=` says")
            return (Note(why, "warning"),)
        meant = self._describe_meant(stated, transform)
        raise FormatError(f"is {name}: {seen}; " + remedy + meant)

    def _is_meant(self, stated: SceneHints, transform: Transform) -> bool:
        """Return whether the user says what a mesh is in that looks as if it were in another scene.

        What it is brought into must be known, too.
        """
        said, known, given = self._given_in, self._stated, self._find_both(stated)[0]
        unit, axis = said.metres_per_unit, said.up_axis
        is_unit = None not in (unit, known.metres_per_unit) and unit == given.metres_per_unit
        is_axis = None not in (axis, known.up_axis) and axis == given.up_axis
        return (is_unit or transform.scale == 1) and (is_axis or not transform.is_turned)

    def _describe_meant(self, stated: SceneHints, transform: Transform) -> Said:
        """Return what says that a mesh is in the scene that it is taken to be in; "" if nothing."""
        known = self._stated
        if (transform.scale != 1 and known.metres_per_unit is None) or (
            transform.is_turned and known.up_axis is None
        ):
            return ""
        given, wanted = self._find_both(stated)
        taken = given.over(wanted).over(Scene().space)
        typed = (taken if transform.is_turned else replace(taken, up_axis=None)).option_text
        return "; if it is meant to be so, by " + Hint("given_in", typed)

    def _list_options(self, source: SceneHints, transform: Transform) -> Said:
        """Return what to type for a mesh whose file states `source`, and which was placed.

        The transform brings it to where it belongs: by the unit, and the up axes.
        """
        given, wanted = self._find_both(source)
        done, axes = SceneConversion.between(given, wanted), transform.up_axes
        stated, options = self._stated, list[Hint]()
        total = transform.scale * done.factor
        unit, own = None, total * (stated.metres_per_unit or Scene().metres_per_unit)
        if transform.scale != 1 and stated.metres_per_unit is None and self._can_restate:
            unit, own = _choose_units(given.metres_per_unit, total)
        if unit is not None:
            options.append(Hint("metres_per_unit", f"{unit:.6g}"))
        axis, own_axis = stated.up_axis or Scene().up_axis, given.up_axis
        if axes is not None:
            own_axis, asked = (axis, axis) if done.turns else axes
            if asked != axis:
                if not self._can_restate:
                    return ""
                options.append(Hint("up_axis", asked))
        needed = SceneHints(up_axis=None if axes is None else own_axis, metres_per_unit=own)
        if not options or not _is_stated(needed, given):
            if self._is_shared and not _is_stated(needed, source.over(needed)):
                return ""  # what the file states comes first
            options.append(Hint("given_in", needed.option_text))
        return join_texts(" and ", options)


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
        self._placed: list[LoadedMesh] = []

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
        self._placed.append(placed)
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
                raise self._explain(error, self._placed[0]) from error
            for mesh in self._placed:
                with error_context(mesh.source["name"]):
                    try:
                        check_enclosure(cage, mesh.mesh, outside)
                    except OutsideError as its_error:
                        raise self._explain(its_error, mesh) from its_error
            raise

    def _explain(self, error: OutsideError, mesh: LoadedMesh) -> OutsideError:
        """Return the error of a mesh that is outside, with what to do with it."""
        placement, misfit = error.placement, error.misfit
        if placement is None or misfit is None:
            return error
        remedy: Said = "move it into the rest cage"
        transform = misfit.transform
        if not placement.is_misplaced:
            remedy += say(", or take the nearest points of the cage with `outside=project`")
        if transform is not None and not transform.is_scaled:
            remedy = "it " + self._describe(transform.invert(), mesh)
        return OutsideError(f"{placement.describe_outside()}; " + remedy)

    def check_small(self, cage: TriMesh, model: TriMesh) -> None:
        """Refuse a mesh in the cage that is small because it is in a larger unit.

        It is in another unit if the cage holds it closely in that, or if it is about as large as
        the model of the cage in that, and in its place; a small thing at its own place is neither.
        """
        for mesh in self._placed:
            transform = find_transform(cage, mesh.mesh)
            found = find_small_unit(mesh.mesh, model) if transform is None else transform.invert()
            if found is None:
                continue
            why = self._describe(found, mesh)
            raise FormatError(why if len(self._placed) == 1 else f"{mesh.source['name']}: " + why)

    def _describe(self, transform: Transform, mesh: LoadedMesh) -> Said:
        """Say how a mesh that a transform brings into the cage is wrong, and what to type."""
        name = transform.describe(mesh.mesh.diagonal)
        options = self._common.offer(transform, mesh.scene)
        return f"is {name}, as the cage shows; export it as the result was" + options


def _choose_units(given: float | None, total: float) -> tuple[float | None, float]:
    """Return the metres per unit to state of a clip that states none, and of a given mesh.

    None stands for the usual one, which need not be stated. `total` is what the numbers of the
    mesh have to be multiplied by, and `given` the unit that its file states.
    """
    if given is not None:
        return given / total, given
    for name in PROGRAM_UNITS:
        own = total * UNIT_LENGTHS[name]
        if find_unit(own) in PROGRAM_UNITS:
            return None if name == "m" else UNIT_LENGTHS[name], own
    return None, total


def _is_stated(needed: SceneHints, hints: SceneHints) -> bool:
    """Return whether all that is needed of unit and up axis is stated, and the same."""
    unit, known = needed.metres_per_unit, hints.metres_per_unit
    is_unit = unit is None or (known is not None and isclose(unit, known, rel_tol=SAME_UNIT_TOL))
    return is_unit and needed.up_axis in (None, hints.up_axis)


def _keep_space(hints: SceneHints) -> SceneHints:
    """Return the unit and the up axis alone."""
    return SceneHints(up_axis=hints.up_axis, metres_per_unit=hints.metres_per_unit)


def read_some_frames(clip: MeshSequence) -> Iterator[tuple[int, Floats]]:
    """Yield the number and positions of the first frame, and of others that can be read."""
    yield 0, clip.first.vertices
    for index in spread_evenly(len(clip), 6)[1:].tolist():
        try:
            yield index, clip.read_frame(index)
        except InputError:
            continue
