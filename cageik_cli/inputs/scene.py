"""The one scene of a run: what is given beside a clip, or a result, is brought into it, or refused.

Where both sides state unit and up axis, meshes and clips are converted. Where one does not, they
are taken as they stand, and refused if they then fit another unit or up axis.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from math import isclose
from pathlib import Path

import numpy as np

from cageik_cli.cages.check.misfit import Transform
from cageik_cli.formats.base.mesh_data import LoadedMesh
from cageik_cli.formats.base.sequence import MeshSequence
from cageik_cli.formats.scene_conversion import SceneConversion
from cageik_cli.formats.settings import Scene, SceneHints
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.inputs.pose_difference import PoseDifference, find_pose_difference
from cageik_cli.util.arrays import Floats, spread_evenly
from cageik_cli.util.errors import FormatError, InputError
from cageik_cli.util.messages import Hint, Note, Said, join_texts, say
from cageik_cli.util.units import (
    PROGRAM_UNITS,
    SAME_UNIT_TOL,
    UNIT_LENGTHS,
    find_unit,
)

UNSTATED = SceneHints()
"""What a file states of its scene that states nothing."""

Offer = Callable[[Transform | None], Said]
"""Returns the options in place of a transform, see `CommonScene.offer`."""


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

    def place(self, loaded: LoadedMesh) -> LoadedMesh:
        """Return a mesh in this scene, with a note if it was converted."""
        return self.find_conversion(loaded.scene).convert_loaded(loaded)

    def place_cage(self, loaded: LoadedMesh) -> tuple[LoadedMesh, Offer]:
        """Return a cage in this scene, and the options that an error of its place offers."""
        return self.place(loaded), partial(self.offer, source=loaded.scene)

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

    def check_rest(self, rest: LoadedMesh, source: SceneHints, clip: MeshSequence) -> LoadedMesh:
        """Refuse a rest pose of a clip that is in another unit, or has other axes.

        Parameters
        ----------
        rest : LoadedMesh
            As it was placed.
        source : SceneHints
            What its file states.

        Returns
        -------
        rest : LoadedMesh
            With a warning if it is likely turned, or of another size for no reason that is known.
        """
        pairs = ((rest.mesh.vertices, frame) for _, frame in read_some_frames(clip))
        difference = find_pose_difference(pairs, rest.mesh.edges.ends)
        beside = f"those of {clip.names[0]}"
        otherwise = "" if clip.needs_rest else say("leave out `rest=`, or ")
        warning = self._judge(difference, source, beside, "the clip", otherwise)
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
        difference = find_pose_difference(pairs, mesh.edges.ends, is_paired=is_paired)
        warnings = self._judge(difference, clip.scene, beside, other)
        placed.notes += tuple(warning.at(name) for warning in warnings)
        return placed

    def offer(self, transform: Transform | None, source: SceneHints) -> Said:
        """Return the options in place of a transform, to end a sentence; empty if none do."""
        if transform is None or transform.is_fitted:
            return ""
        if (transform.rotation != np.eye(3)).any() and transform.up_axes is None:
            return ""
        options = self._list_options(source, transform.scale, transform.up_axes)
        return ", or state it by " + options if options else ""

    def _judge(
        self,
        difference: PoseDifference | None,
        source: SceneHints,
        beside: str,
        other: str,
        otherwise: Said = "",
    ) -> tuple[Note, ...]:
        """Refuse a difference that is certain; return a warning of one that is not."""
        if difference is None:
            return ()
        name, seen = difference.name, difference.describe(beside)
        if not name:
            seen += ", which no unit explains; errors are percent of it"
            return (Note(seen, "warning"),)
        options = self._list_options(source, difference.factor, difference.axes)
        remedy = otherwise + f"export it as {other} was"
        if options:
            shared = " (if the cage is so, too)" * self._is_shared
            remedy = otherwise + "state it by " + options
            remedy += f"{shared}, or export it as {other} was"
        elif self._is_shared:
            remedy += say(
                "; `given_in=` is for files that do not state it, where there are several"
            )
        if not difference.is_certain:
            return (Note(f"is likely {name}; if so, " + remedy, "warning"),)
        has_unit, has_axis = difference.factor != 1, difference.axes is not None
        if self._is_meant(source, has_unit=has_unit, has_axis=has_axis):
            why = f"looks as if it is {name}: {seen}; " + say("it is taken as `given_in=` says")
            return (Note(why, "warning"),)
        meant = self._list_meant(source, has_unit=has_unit, has_axis=has_axis)
        raise FormatError(f"is {name}: {seen}; " + remedy + meant)

    def _is_meant(self, source: SceneHints, *, has_unit: bool, has_axis: bool) -> bool:
        """Return whether the user says what a mesh is in that looks as if it were in another scene.

        What it is brought into must be known, too.
        """
        said, known, given = self._given_in, self._stated, self._find_both(source)[0]
        unit, axis = said.metres_per_unit, said.up_axis
        is_unit = None not in (unit, known.metres_per_unit) and unit == given.metres_per_unit
        is_axis = None not in (axis, known.up_axis) and axis == given.up_axis
        return (is_unit or not has_unit) and (is_axis or not has_axis)

    def _list_meant(self, source: SceneHints, *, has_unit: bool, has_axis: bool) -> Said:
        """Return what says that a mesh is in the scene that it is taken to be in; "" if nothing."""
        known = self._stated
        if (has_unit and known.metres_per_unit is None) or (has_axis and known.up_axis is None):
            return ""
        given, wanted = self._find_both(source)
        taken = given.over(wanted).over(Scene().space)
        typed = taken.option_text if has_axis else replace(taken, up_axis=None).option_text
        return "; if it is meant to be so, by " + Hint("given_in", typed)

    def _list_options(
        self, source: SceneHints, factor: float, axes: tuple[str, str] | None
    ) -> Said:
        """Return what to type for a mesh that has to be multiplied by a factor, and turned.

        Parameters
        ----------
        factor, axes
            What is wrong of the mesh as it was placed: its unit in that of the scene, and the up
            axes of both.
        """
        given, _ = self._find_both(source)
        done = SceneConversion.between(given, self._find_both(source)[1])
        stated, options = self._stated, list[Hint]()
        total = factor * done.factor
        unit, own = None, total * (stated.metres_per_unit or Scene().metres_per_unit)
        if factor != 1 and stated.metres_per_unit is None and self._can_restate:
            unit, own = _choose_units(given.metres_per_unit, total)
        if unit is not None:
            options.append(Hint("metres_per_unit", f"{unit:.6g}"))
        axis, own_axis = stated.up_axis or Scene().up_axis, given.up_axis
        if axes is not None:
            own_axis, wanted = (axis, axis) if done.turns else axes
            if wanted != axis:
                if not self._can_restate:
                    return ""
                options.append(Hint("up_axis", wanted))
        needed = SceneHints(up_axis=None if axes is None else own_axis, metres_per_unit=own)
        if not options or not _is_stated(needed, given):
            if self._is_shared and not _is_stated(needed, source.over(needed)):
                return ""  # what the file states comes first
            options.append(Hint("given_in", needed.option_text))
        return join_texts(" and ", options)


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
