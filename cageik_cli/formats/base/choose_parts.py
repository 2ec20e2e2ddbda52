"""Which meshes of a file are read: those below a path, but for patterns and what is hidden."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from types import MappingProxyType

import numpy as np

from cageik_cli.formats.base.writers import choose_short_names
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.parts import Part, join_meshes, list_part_names, split_parts
from cageik_cli.util.arrays import Integers
from cageik_cli.util.errors import (
    MAX_LISTED,
    ConnectivityError,
    FormatError,
    SettingError,
    join_truncated,
)
from cageik_cli.util.messages import Hint, Said, say


def choose_parts(
    paths: Sequence[str],
    member: str | None,
    exclude: Sequence[str],
    hidden: Mapping[str, str] = MappingProxyType({}),
) -> tuple[list[str], list[Said]]:
    """Return the paths of the meshes that are read, and notes on those that are left out.

    Parameters
    ----------
    member : str, optional
        A mesh, or what they are below: its path, or the end of the path if only one ends so. All
        that are seen if absent.
    exclude : sequence of str
        Patterns of paths and of names in them: what is at or below one is left out.
    hidden : mapping
        Why some meshes are not seen, by path: "invisible". They are read if they are all there
        are, or named by `member`.

    Raises
    ------
    InputError
        Listing the meshes to choose from, or those that a text may mean.
    """
    if not paths:
        raise FormatError("holds no mesh; export an animated mesh")
    top = None if member is None else _find_top(paths, member)
    chosen = [path for path in paths if top is None or _is_below(path, top)]
    reasons: dict[str, Said] = {}
    for pattern in exclude:
        matching = [path for path in chosen if _matches(path, pattern)]
        if not matching:
            raise SettingError(
                Hint("exclude", pattern)
                + f" matches none of its meshes: {join_truncated(chosen, MAX_LISTED)}"
            )
        reasons |= dict.fromkeys(matching, Hint("exclude", pattern))
    if len(reasons) == len(chosen):
        raise SettingError(say("`exclude=` leaves none of its meshes; give fewer patterns"))
    seen = [path for path in chosen if path not in reasons]
    shown = [path for path in seen if path not in hidden or path == top]
    unseen = {path: hidden[path] for path in seen if path in hidden and path != top}
    if shown:
        return shown, _describe("left out", reasons | unseen)
    return seen, [*_describe("left out", reasons), *_describe("no other mesh than", unseen)]


def _describe(what: str, reasons: Mapping[str, Said]) -> list[Said]:
    """Return a sentence for each reason, with the paths that have it."""
    paths: dict[Said, list[str]] = {}
    for path, reason in reasons.items():
        paths.setdefault(reason, []).append(path)
    return [f"{what} {join_truncated(each)} (" + reason + ")" for reason, each in paths.items()]


def _find_top(paths: Sequence[str], member: str) -> str:
    """Return the path that a text names: as it is, or the only one that ends with it."""
    if any(_is_below(path, member) for path in paths):
        return member
    places = {place: None for path in paths for place in _list_places(path)}
    ending = [place for place in places if place.endswith(f"/{member.rstrip('/')}")]
    tops = [
        place
        for place in ending
        if not any(_is_below(place, other) for other in ending if other != place)
    ]
    if len(tops) == 1:
        return tops[0]
    if tops:
        raise SettingError(
            f"holds {len(tops)} meshes or groups `{member}`: {join_truncated(tops, MAX_LISTED)}; "
            "give more of "
            f"the path, as in ::{tops[0]}"
        )
    raise SettingError(
        f"holds no mesh `{member}`; choose one of {join_truncated(paths, MAX_LISTED)}"
    )


def _list_places(path: str) -> list[str]:
    """Return a path and those above it, from the top."""
    names = path.strip("/").split("/")
    root = "/" if path.startswith("/") else ""
    return [root + "/".join(names[: k + 1]) for k in range(len(names))]


def _is_below(path: str, top: str) -> bool:
    return path == top or path.startswith(f"{top.rstrip('/')}/")


def _matches(path: str, pattern: str) -> bool:
    """Return whether a pattern is that of a path, of one above it, or of a name in it."""
    names = path.strip("/").split("/")
    return any(fnmatchcase(each, pattern) for each in (*_list_places(path), *names))


def select_parts(
    mesh: TriMesh, member: str | None, exclude: Sequence[str]
) -> tuple[TriMesh, Integers | None, list[Said]]:
    """Return the parts of a mesh that are asked for, the numbers of their vertices, and notes.

    Nothing is asked for without a `member` and patterns; the numbers are None then.

    Raises
    ------
    InputError
        When there is no such part, or the mesh has none.
    """
    if member is None and not exclude:
        return mesh, None, []
    parts = {part.name: part for part in split_parts(mesh)}
    if "" in parts:
        raise SettingError(
            "has no objects to choose from: each `o` line (in STL, each solid) must be followed by "
            "faces whose vertices no other object has; export it again, or take all of it"
        )
    names, notes = choose_parts(list(parts), member, exclude)
    chosen = [parts[name] for name in names]
    kept = np.concatenate([np.arange(part.vertices.start, part.vertices.stop) for part in chosen])
    return _join_parts(chosen), kept, notes


def drop_parts(mesh: TriMesh, exclude: Sequence[str]) -> tuple[TriMesh, list[Said]]:
    """Return a mesh without its parts that match a pattern, and a note; itself if none does.

    Unlike a clip, its rest pose may lack what the patterns leave out.
    """
    parts = split_parts(mesh)
    kept = [part for part in parts if not any(_matches(part.name, one) for one in exclude)]
    if len(kept) == len(parts):
        return mesh, []
    if not kept:
        raise SettingError(say("`exclude=` leaves none of its meshes; give fewer patterns"))
    names = join_truncated(part.name for part in parts if part not in kept)
    return _join_parts(kept), [f"left out {names} " + say("(`exclude=`)")]


def order_parts(mesh: TriMesh, expected: TriMesh, name: str) -> tuple[TriMesh, list[Said]]:
    """Return a mesh with its parts in the order of another one, and a note if it was another.

    Parts are identified by their names, or by the last ones in their paths. Those of other names
    are taken in the order of the mesh.

    Raises
    ------
    ConnectivityError
        When some parts alone are in both, and in other places.
    """
    own, wanted = _list_common_names(mesh, expected)
    if own == wanted or set(own) != set(wanted):
        check_part_order(mesh, expected, name)
        return mesh, []
    parts = dict(zip(own, split_parts(mesh), strict=True))
    return _join_parts([parts[each] for each in wanted]), [f"parts taken in the order of {name}"]


def check_part_order(mesh: TriMesh, expected: TriMesh, expected_name: str) -> None:
    """Refuse a mesh that has a part in another place; meshes of as many vertices may hide it."""
    own, wanted = _list_common_names(mesh, expected)
    places = {name: k for k, name in enumerate(wanted)}
    for k, name in enumerate(own):
        if places.get(name, k) != k:
            raise ConnectivityError(
                f"part {name} is number {k + 1} of its parts, and number {places[name] + 1} of "
                f"{expected_name}; give both their parts in one order"
            )


def _list_common_names(mesh: TriMesh, other: TriMesh) -> tuple[Sequence[str], Sequence[str]]:
    """Return names by which the parts of two meshes can be compared; none if one has no parts."""
    own, others = list_part_names(mesh), list_part_names(other)
    if not own or not others:
        return (), ()
    if set(own) & set(others):
        return own, others
    return choose_short_names(own), choose_short_names(others)


def list_unmatched(mesh: TriMesh, exclude: Sequence[str]) -> list[str]:
    """Return the patterns that match no part of a mesh."""
    names = [part.name for part in split_parts(mesh)]
    return [one for one in exclude if not any(_matches(name, one) for name in names)]


def _join_parts(parts: Sequence[Part]) -> TriMesh:
    names, transforms = [part.name for part in parts], [part.transform for part in parts]
    return join_meshes([part.mesh for part in parts], names, transforms)
